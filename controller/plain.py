"""Protocol plain: the specification's packet to the letter, an alternative to `controller.packet`.

Nine numbers of six characters, 63 characters with a space after each or 54 without, IDs from 1,
commands 1 to 7, reports 101 and 102 with Param 0, no hello. `controller/plain.as` is its other end.
NOT_PROTECTED is the protection that it gives up; docs/decisions.md has the reasons for our packet.
"""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Literal, NamedTuple

from pydantic import Field

from controller.packet import FRAME_CHARS, FRAME_NAMES, FRAMES, Packet
from controller.packet_table import GAIN_I, GAIN_P, PERCENT, Com, PacketValue
from forcemesh.connection import ConfigSection
from forcemesh.errors import LocalProtocolError, RemoteProtocolError

PROGRAM = Path(__file__).with_name("plain.as")
START = "pl.main"
ID_LAST = 999_999  # then 1 again
VALUE_MIN, VALUE_MAX = -99_999, 999_999
COMMANDS = range(1, 8)  # a) to g) of the specification
REPORTS = (Com.POSE, Com.JOINTS)


class Protection(NamedTuple):
    """A protection of forcemesh.as, what plain.as does in its place, and the faults of 103."""

    ours: str
    plain: str
    faults: tuple[int, ...] = ()

    def __str__(self) -> str:
        return f"{self.ours}: {self.plain}"


# Every protection of forcemesh.as that plain.as does not have: the gateway writes them at its
# start, the doctor reports them, `make docs` makes the table of docs/controller.md.
NOT_PROTECTED = (
    Protection(
        "watchdog: silence of the PC, or of command 4, brakes and latches",
        "a motion in progress continues to its end, a press stays as it is", (1, 2),
    ),
    Protection(
        "HOLD, motor off and a stopped program latch",
        "RUN on the pendant resumes an interrupted motion", (3,),
    ),
    Protection(
        "hold at once, braked until the arm is at rest",
        "a joint rotation by zero, taken in its turn and braked once",
    ),
    Protection("nothing moves before all limits were received", "there are none", (13,)),
    Protection("box of the TCP, for a joint motion also on its way", "none", (14,)),
    Protection("turn since the first motion after a hold", "unlimited", (15,)),
    Protection("first target of force feedback near the arm", "anywhere", (16,)),
    Protection("travel of force feedback", "unlimited", (6,)),
    Protection("step of an iteration", "unlimited; its speed is that of command 5"),
    Protection("highest speed for command 5", "any that AS takes", (17,)),
    Protection("ceilings of force and torque", "none", (7,)),
    Protection(
        "reach and joint ranges before a motion, refusals reported",
        "a target out of reach is an error stop of AS", (9,),
    ),
    Protection(
        "TOOL and BASE NULL, tested after each hold", "set to NULL at the start only", (8,)
    ),
    Protection("hello: version, number of the arm, scales", "none of them is compared"),
    Protection("consecutive IDs that no other number can be", "lost frames are not detected"),
    Protection("gains below zero are refused", "any gain is taken"),
    Protection(
        "status: motor power, mode, teach lock, errors, monitor speed, holds, refusals",
        "unknown to the PC",
    ),
    Protection("address of the PC", "any client may connect", (18,)),
    Protection(
        "a program that an error has ended is started again, with the arm held",
        "it stays ended: without pl.recv nothing brakes at the end of a connection", (12, 19),
    ),
)  # fmt: skip
KEPT_FAULTS = (4, 5, 10, 11)  # invalid packet, full ring, pose that does not fit, port: as in ours


# Most of the cell file's limits, with their units. Below the usual 50 N and 250 mm/s: after a fault
# of the PC nothing in the controller stops a motion or a press, so a smaller speed and force are
# what remains of the protection.
MOST = {
    "limits.force_N": (30.0, "N"),
    "limits.torque_Nm": (5.0, "N m"),
    "limits.speed_m_s": (0.1, "m/s"),
    "force.speed_max_m_s": (0.02, "m/s"),
}
HOST = "controller"  # set points of a loop on the PC have no command in it


def terms_mistake(hosts: tuple[str, ...], limits: Mapping[str, float]) -> str:
    """Return why a cell with these hosts and limits may not use protocol plain; empty: it may.

    `limits` has the fields of MOST.
    """
    if hosts != (HOST,):
        return (
            "gateway.protocol is plain, which has no command for a stream of set points: "
            f"robot.hosts must be [{HOST}], found [{', '.join(hosts)}]"
        )
    for name, (most, unit) in MOST.items():
        if limits[name] > most:
            return (
                f"gateway.protocol is plain, with which the controller checks nothing: {name} is "
                f"{limits[name]:g} {unit}, at most {most:g} {unit} is allowed"
            )
    return ""


class PlainSection(ConfigSection):
    """Packet of protocol plain: characters, and packet units per unit. No hello compares them.

    1 everywhere is the specification: whole mm, degrees, N, N m, mm/s and percent. pl.config of
    controller/plain.as has the same numbers: `python -m launch.controller_program CELL` writes it.
    """

    packet_chars: Literal[54, 63] = 63  # without and with a space after each number
    position_per_mm: int = Field(1, ge=1, le=99)
    oat_per_deg: int = Field(1, ge=1, le=555)
    joint_per_deg: int = Field(1, ge=1, le=277)
    force_per_N: int = Field(1, ge=1, le=999)
    torque_per_Nm: int = Field(1, ge=1, le=9999)
    speed_per_mm_s: int = Field(1, ge=1, le=1000)
    per_percent: int = Field(1, ge=1, le=100)
    gain_p: int = Field(1, ge=1, le=500_000)  # per mm/N and per deg/(N m)
    gain_i: int = Field(1, ge=1, le=500_000)  # per mm/(N s) and per deg/(N m s)

    def units(self, number: PacketValue) -> int:
        """Return the packet units per unit of a number in the packet table."""
        scale = number.quantity.scale
        name = scale if isinstance(scale, str) else _FIXED[scale]
        units: int = getattr(self, name)
        return units


_FIXED = {PERCENT: "per_percent", GAIN_P: "gain_p", GAIN_I: "gain_i"}
# Variables of pl.config by the field of PlainSection; `w` is the width of a number.
_VARIABLES = {
    "position_per_mm": "sp", "oat_per_deg": "so", "joint_per_deg": "sj", "force_per_N": "sf",
    "torque_per_Nm": "sm", "speed_per_mm_s": "sv", "per_percent": "sc", "gain_p": "sg",
    "gain_i": "si",
}  # fmt: skip


def encode(packet: Packet, packet_chars: int) -> bytes:
    """Return the characters of a packet.

    Raises LocalProtocolError when a number does not fit into six characters; none is clipped.
    """
    for name, value in zip(FRAME_NAMES, packet.frames, strict=True):
        low, high = (1, ID_LAST) if name == "ID" else (VALUE_MIN, VALUE_MAX)
        if not low <= value <= high:
            raise LocalProtocolError(f"{name} is {value}, it must be {low} to {high}")
    gap = " " * (packet_chars // FRAMES - FRAME_CHARS)
    return "".join(f"{value:06d}{gap}" for value in packet.frames).encode("ascii")


class PlainReader:
    """Parser of a stream of reports; after the first malformed packet every call fails."""

    def __init__(self, packet_chars: int) -> None:
        """Begin at the first character of a stream."""
        self._chars = packet_chars
        gap = b" " * (packet_chars // FRAMES - FRAME_CHARS)
        self._packet = re.compile(rb"(?:(?:-[0-9]{5}|[0-9]{6})%b){9}" % gap)
        self._rest = b""
        self._death = ""

    def feed(self, data: bytes) -> list[Packet]:
        """Return the reports that are now complete.

        Raises RemoteProtocolError at a malformed packet, one that is no report, and ever after.
        """
        if self._death:
            raise RemoteProtocolError(self._death)
        self._rest += data
        packets = []
        while len(self._rest) >= self._chars:
            chars, self._rest = self._rest[: self._chars], self._rest[self._chars :]
            packets.append(self._parse(chars))
        return packets

    def _parse(self, chars: bytes) -> Packet:
        width = self._chars // FRAMES
        if self._packet.fullmatch(chars):
            numbers = [int(chars[at : at + FRAME_CHARS]) for at in range(0, self._chars, width)]
            id_, com, param, a, b, c, d, e, f = numbers
            if com in REPORTS and param == 0 and id_ >= 0:
                return Packet(id_, com, param, (a, b, c, d, e, f))
        shown = chars.decode("ascii", "backslashreplace")
        self._death = (
            f"{shown!r} is not a report of protocol plain: nine numbers in {self._chars} "
            f"characters, Com 101 or 102, Param 0; is gateway.plain.packet_chars 9 times pl.w of "
            "pl.config, and does the controller run plain.as?"
        )
        raise RemoteProtocolError(self._death)


class Controller(NamedTuple):
    """Properties of the controller that pl.config has: those of the shipped file by default."""

    port: int = 49152
    centre_mm: tuple[float, ...] = (
        0.0,
        0.0,
        0.0,
    )  # turned about, flange frame
    least_segment_s: float = 0.03
    least_speed_mm_s: float = 1.2
    joint_speed_deg_s: tuple[float, ...] = (370, 310, 410, 550, 550, 1000)  # at 100 %


def program(settings: PlainSection, controller: Controller) -> str:
    """Return plain.as with the numbers of a cell in its pl.config."""
    values: dict[str, float] = {name: getattr(settings, f) for f, name in _VARIABLES.items()}
    values |= dict(zip(("tx", "ty", "tz"), controller.centre_mm, strict=True))
    values |= {"w": settings.packet_chars // FRAMES, "port": controller.port}
    values |= {"tmove": controller.least_segment_s, "vmin": controller.least_speed_mm_s}
    values |= {f"jmax[{k}]": v for k, v in enumerate(controller.joint_speed_deg_s, 1)}
    text = PROGRAM.read_text(encoding="ascii")
    for name, value in values.items():
        line = re.compile(rf"^(  pl\.{re.escape(name)}=)[0-9.]+", re.MULTILINE)
        text = line.sub(rf"\g<1>{value:g}", text, count=1)
    return text
