"""Packet table: meaning of the nine numbers of a packet: commands, status bits, IDs, scales.

controller/README.md holds the same table for the other end; tests compare the two.
"""

from dataclasses import dataclass
from enum import IntEnum, IntFlag

from forcemesh.errors import LocalProtocolError, RemoteProtocolError

PROTOCOL_VERSION = 2
ARMS = 1000  # numbers of an arm: Param of hello is version * 1000 + number

# An ID is at least ID_FIRST and every other number of a packet is less: see `controller.packet`.
ID_FIRST = 500_000
ID_LAST = 999_999
ID_COUNT = ID_LAST - ID_FIRST + 1
NO_ID = 0  # "none yet"; never transmitted

STATUS_BITS = 11
STATUS_SPAN = 1 << STATUS_BITS
COUNTER_SPAN = 240  # 240 * 2048 - 1 = 491519 is less than any ID; a 103 is sent with every eighth

# Fixed scales, not set by hello.
PERCENT = 100  # per percent
GAIN_P = 500_000  # per mm/N and per deg/(N m)
GAIN_I = 5_000  # per mm/(N s) and per deg/(N m s)


class Com(IntEnum):
    """Number of a command (PC to controller, 1 to 14) or report (controller to PC, 101 to 103)."""

    MOVE_POSE = 1
    MOVE_JOINTS = 2
    MOVE_BY_JOINTS = 3
    WRENCH = 4
    SPEEDS = 5
    GAINS = 6
    FEEDBACK = 7
    HOLD = 8
    HELLO = 9
    LIMITS = 10
    TCP = 11
    HEARTBEAT = 12
    SET_POINT = 13
    FORCE_SET_POINT = 14
    POSE = 101
    JOINTS = 102
    HEALTH = 103


class GainKind(IntEnum):
    """Param of command 6."""

    PROPORTIONAL = 0
    INTEGRAL = 1


class Bank(IntEnum):
    """Param of command 10."""

    FEEDBACK = 0
    MOTION = 1
    LOWER_CORNER = 2
    UPPER_CORNER = 3


class CentreParam(IntEnum):
    """Param of command 11: the TCP, or only the centre of rotation of force feedback."""

    TCP = 0
    CENTRE = 1


class FeedbackSwitch(IntEnum):
    """Param of command 7; POSITION and ORIENTATION add up to both, STOP stops both."""

    POSITION = 0
    ORIENTATION = 1
    STOP = 2


class Status(IntFlag):
    """The low eleven bits of Param in reports 101 and 102."""

    MOTOR_POWER = 1
    REPEAT_MODE = 2
    TEACH_LOCK_OFF = 4
    PROGRAM_RUNNING = 8
    MOVING = 16
    POSITION_FEEDBACK = 32
    ORIENTATION_FEEDBACK = 64
    HELD = 128
    WATCHDOG_LATCHED = 256
    TARGET_REFUSED = 512
    ERROR = 1024


FEEDBACK_BITS = Status.POSITION_FEEDBACK | Status.ORIENTATION_FEEDBACK


Names = tuple[str, str, str, str, str, str]


@dataclass(frozen=True, slots=True)
class Row:
    """One row of the packet table: range of Param and content of the vector, with the scale."""

    com: Com
    params: range
    vec: Names
    meaning: str
    banks: tuple[Names, ...] = ()  # vectors of the other Params, where they differ


_NONE = ("0",) * 6
_POSE = ("X position", "Y position", "Z position", "O angle", "A angle", "T angle")
_JOINTS = ("JT1 joint", "JT2 joint", "JT3 joint", "JT4 joint", "JT5 joint", "JT6 joint")
_WRENCH = ("Fx force", "Fy force", "Fz force", "Mx torque", "My torque", "Mz torque")
_SPEEDS = ("accel percent", "decel percent", "modular percent", "mechanical speed", "0", "0")
_GAINS = ("x gain", "y gain", "z gain", "mx gain", "my gain", "mz gain")
_SCALES = ("position", "angle", "joint", "force", "torque", "speed")
_LIMITS = ("step position", "step angle", "speed", "travel position", "force", "watchdog ms")
_MOTION = (
    "turn angle", "torque", "set-point step position", "set-point step angle", "highest speed", "0",
)  # fmt: skip
_LOWER = ("lower X position", "lower Y position", "lower Z position", "0", "0", "0")
_UPPER = ("upper X position", "upper Y position", "upper Z position", "0", "0", "0")
_HEALTH = (
    "loops", "wrench age ms", "queue length", "monitor speed percent", "held ID - 500000",
    "any peer",
)  # fmt: skip
_COUNT = range(ID_FIRST)
_CODE = range(-99_999, ID_FIRST)  # AS error codes are negative

# fmt: off
TABLE = {row.com: row for row in (
    Row(Com.MOVE_POSE,      range(1), _POSE,   "a) move to a pose"),
    Row(Com.MOVE_JOINTS,    range(1), _JOINTS, "b) move to joint angles"),
    Row(Com.MOVE_BY_JOINTS, range(1), _JOINTS, "c) move by joint angles"),
    Row(Com.WRENCH,         range(1), _WRENCH, "d) wrench as it is read, base axes, at TCP"),
    Row(Com.SPEEDS,         range(1), _SPEEDS, "e) speeds and accelerations"),
    Row(Com.GAINS,          range(2), _GAINS,  "f) gains: 0 proportional, 1 integral"),
    Row(Com.FEEDBACK,       range(3), _NONE,   "g) feedback: 0 position, 1 orientation, 2 stop"),
    Row(Com.HOLD,           range(1), _NONE,   "hold now"),
    Row(Com.HELLO,          _COUNT,   _SCALES, "first packet, both ways; version * 1000 + arm"),
    Row(Com.LIMITS,         range(4), _LIMITS, "limits that the controller enforces itself",
        (_MOTION, _LOWER, _UPPER)),
    Row(Com.TCP,            range(2), _POSE,   "flange frame: 0 TCP, 1 centre of rotation"),
    Row(Com.HEARTBEAT,      range(1), _NONE,   "keep-alive, when nothing else is sent"),
    Row(Com.SET_POINT,      range(1), _POSE,   "one pose of a stream"),
    Row(Com.FORCE_SET_POINT, range(1), _WRENCH, "set point of the wrench, base axes"),
    Row(Com.POSE,           _COUNT,   _POSE,   "flange pose; ID = last command accepted"),
    Row(Com.JOINTS,         _COUNT,   _JOINTS, "joint angles; ID = last command framed"),
    Row(Com.HEALTH,         _CODE,    _HEALTH, "health; Param = error code"),
)}
# fmt: on

REPORTS = frozenset({Com.HELLO, Com.POSE, Com.JOINTS, Com.HEALTH})
COMMANDS = frozenset(set(Com) - {Com.POSE, Com.JOINTS, Com.HEALTH})


def next_id(id_: int) -> int:
    """Return the ID that follows: 500000 to 999999, then 500000 again; after NO_ID any of them."""
    return ID_FIRST + (id_ + 1 - ID_FIRST) % ID_COUNT


def ids_since(earlier: int, later: int) -> int:
    """Return the number of IDs after `earlier` up to and including `later`, modulo ID_COUNT."""
    return (later - earlier) % ID_COUNT


def pack_status(counter: int, status: Status) -> int:
    """Return Param of 101 and 102. The counter wraps at 240.

    Raises LocalProtocolError for status bits outside the eleven.
    """
    if not 0 <= status < STATUS_SPAN:
        raise LocalProtocolError(f"status {int(status)} has bits outside the {STATUS_BITS}")
    return counter % COUNTER_SPAN * STATUS_SPAN + int(status)


def unpack_status(param: int) -> tuple[int, Status]:
    """Return (counter, status) of Param in 101 and 102.

    Raises RemoteProtocolError when the number is not a counter and status.
    """
    if not 0 <= param < COUNTER_SPAN * STATUS_SPAN:
        raise RemoteProtocolError(
            f"Param {param} of a report is not counter * {STATUS_SPAN} + status, "
            f"0 to {COUNTER_SPAN * STATUS_SPAN - 1}"
        )
    counter, bits = divmod(param, STATUS_SPAN)
    return counter, Status(bits)


def greeting(arm: int) -> int:
    """Return Param of hello: this protocol version and the number of an arm."""
    return PROTOCOL_VERSION * ARMS + arm


def greeted(param: int) -> tuple[int, int]:
    """Return (version, number of the arm) of a hello; before version 2 arms had no numbers."""
    return (param, 0) if param < ARMS else divmod(param, ARMS)


def known(com: int, param: int) -> Com:
    """Return the command of a packet. Raise RemoteProtocolError when it is not in the table."""
    if com not in Com._value2member_map_:
        raise RemoteProtocolError(f"Com {com} is not a command of protocol {PROTOCOL_VERSION}")
    row = TABLE[Com(com)]
    if param not in row.params:
        raise RemoteProtocolError(
            f"Param {param} of command {com} ({row.com.name}) must be 0 to {row.params[-1]}"
        )
    return row.com
