"""Seeds of the fuzz targets; those of the packet targets are made from the table of commands."""

from collections.abc import Callable
from pathlib import Path

from controller.packet import Packet, encode
from controller.packet_table import ID_FIRST, ID_LAST, Com, greeting, next_id
from tests.fuzz.framer import ARM

FOLDER = Path(__file__).parent / "seeds"
SCALES = (50, 500, 250, 100, 1000, 10)
NUMBERS = (1000, -2000, 3000, -4000, 5000, 6000)
NEAR = (500, 23750, 18850, 0, 90000, 0)  # 10 mm beside home
MOVES = ((1, 0, NEAR), (2, 0, NUMBERS), (3, 0, (5, -5, 5, -5, 5, -5)))
# Required for motion: the banks of command 10, and command 11.
SET_UP = (
    (10, 0, (50, 250, 100, 1000, 5000, 250)), (10, 1, (70000, 10000, 1000, 3000, 2500, 0)),
    (10, 2, (-50000, 0, -10000, 0, 0, 0)), (10, 3, (50000, 60000, 60000, 0, 0, 0)),
    (11, 0, (0, 0, 8000, 0, 0, 0)),
)  # fmt: skip
SETTINGS = (
    (5, 0, (10000, 10000, 10000, 2500, 0, 0)), (6, 0, (100,) * 6), (6, 1, (100,) * 6),
    *SET_UP, (11, 1, NUMBERS),
)  # fmt: skip
FEEDBACK = (
    (7, 0, (0,) * 6), (14, 0, SCALES), (4, 0, NUMBERS), (4, 0, SCALES), (7, 2, (0,) * 6),
)  # fmt: skip
# The range of AS's SPEED is smaller than that of a packet.
SPEEDS = {
    "slow": ((5, 0, (100, 100, 100, 1, 0, 0)),),
    "fast": ((10, 0, (50, 250, 499_999, 1000, 5000, 250)),),
}
BEAT, HOLD = ((12, 0, (0,) * 6),), ((8, 0, (0,) * 6),)

CONVERSATIONS = {
    "beats": BEAT * 4,
    "settings": SETTINGS,
    "moves": (*SET_UP, *MOVES, *HOLD),
    "not-set-up": (*SET_UP[1:], *MOVES, *HOLD),
    "stream": (*SET_UP, *((13, 0, NEAR),) * 3),
    "feedback": (*SETTINGS, *FEEDBACK, *HOLD),
    "hold-first": (*HOLD, *SETTINGS, *BEAT),
    "both": ((7, 0, (0,) * 6), (7, 1, (0,) * 6), (4, 0, NUMBERS), *HOLD),
    "second-hello": (*BEAT, (9, 1, SCALES), *BEAT),
    "unknown": (*BEAT, (16, 0, (0,) * 6), *BEAT),
    "signals": (
        (15, 1, (1, 1001, 945, 1945, 0, 17)), (15, 0, (9, 0, 0, 0, 0, 0)), *BEAT,
        (15, 0, (-960, 0, 0, 0, 0, 0)), *HOLD,
    ),
    "no-output": (*BEAT, (15, 0, (1001, 0, 0, 0, 0, 0)), *BEAT),
    "no-group": (*BEAT, (15, 1, (1, 946, 0, 0, 0, 0)), *BEAT),
    "wrong-param": (*BEAT, (7, 3, (0,) * 6)),
    "not-zero": ((12, 0, (0, 0, 0, 0, 0, 1)), *BEAT),
}  # fmt: skip
REPORTS = (
    (101, 2079, NUMBERS), (102, 2079, NUMBERS), (103, -34024, (7, 12, 0, 100, 0, 0)),
    (104, 0, (0x8001, 0, 0xFFFF, 1, 0, 0)),
)  # fmt: skip


def conversation(
    packets: tuple[tuple[int, int, tuple[int, ...]], ...],
    *,
    first: int = ID_FIRST,
    hello: int = greeting(ARM),
) -> bytes:
    """Return hello and packets with consecutive IDs."""
    data, id_ = encode(Packet(first, Com.HELLO, hello, SCALES)), first
    for com, param, (a, b, c, d, e, f) in packets:
        id_ = next_id(id_)
        data += encode(Packet(id_, com, param, (a, b, c, d, e, f)))
    return data


def receiver_seeds() -> dict[str, bytes]:
    """Return streams for the receiver, by name; the first byte selects their segmentation."""
    seeds = {name: b"\x03" + conversation(each) for name, each in CONVERSATIONS.items()}
    good = conversation(CONVERSATIONS["feedback"])
    return seeds | {
        "wrap": b"\x01" + conversation(BEAT * 3, first=ID_LAST - 1),
        "hello-zero": b"\x01" + conversation(BEAT).replace(b"500000", b"000000", 1),
        "least-speeds": b"\x03"
        + conversation((*SET_UP, (5, 0, (1, 1, 10000, 2500, 0, 0)), *MOVES)),
        "other-version": b"\x02" + conversation(BEAT, hello=1),
        "other-arm": b"\x02" + conversation(BEAT, hello=greeting(ARM + 1)),
        "no-hello": b"\x04" + good[63:],
        "cut-short": b"\x05" + good[:-20],
        "byte-by-byte": b"\x00" + conversation((*SET_UP, *MOVES, *BEAT)),
        "space-moved": b"\x06" + good[:85] + b" " + good[86:],
        "power-of-ten": b"\x07" + good.replace(b"002500", b"25E002"),
        "id-in-vector": b"\x0e" + good.replace(b"001000", b"501000"),
        "frames-lost": b"\x0f" + good[: 63 + 28] + good[126:],
        "id-skipped": b"\x08" + good[:63] + good[126:],
        "high-digits": b"\x09" + good.replace(b"000100 ", b"0001\xb20 ", 1),
        "negative-hello": b"\x0a" + good.replace(b"000050", b"-00050", 1),
        "too-slow": b"\x0c" + conversation((*SET_UP, *SPEEDS["slow"], *MOVES[:1])),
        "too-fast": b"\x0d" + conversation((*SET_UP, *SPEEDS["fast"], *MOVES[:1])),
        "noise": b"\x0b" + bytes(range(256)),
    }


def gateway_seeds() -> dict[str, bytes]:
    """Return streams for the gateway's reader."""
    good = conversation(())
    good += b"".join(encode(Packet(ID_FIRST, com, param, vec)) for com, param, vec in REPORTS)
    return {
        "reports": b"\x03" + good,
        "byte-by-byte": b"\x00" + good,
        "other-scales": b"\x01" + good.replace(b"000500", b"000400", 1),
        "version": b"\x02" + conversation((), hello=1),
        "status": b"\x04" + good.replace(b"002079", b"491520"),
        "command": b"\x05" + good + encode(Packet(ID_FIRST + 1, Com.HOLD)),
        "frames-lost": b"\x08" + good[: 63 + 14] + good[126:],
        "cut": b"\x06" + good[:-7],
        "underscore": b"\x07" + good.replace(b"001000", b"1_0000"),
    }


MADE: dict[str, Callable[[], dict[str, bytes]]] = {
    "receiver": receiver_seeds,
    "gateway": gateway_seeds,
}


def seeds(target: str) -> dict[str, bytes]:
    """Return the seeds of a target by name: made here, or kept as files."""
    made = MADE[target]() if target in MADE else {}
    files = sorted((FOLDER / target).glob("*"))
    return made | {path.name: path.read_bytes() for path in files}
