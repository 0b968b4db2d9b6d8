"""Packet table: meaning of the nine numbers of a packet: commands, status bits, IDs, scales.

A command is declared here once: controller/README.md has this table for the other end
(`make docs`), and encoder and decoder of the gateway follow it.
"""

from enum import IntEnum, IntFlag
from math import pi
from typing import NamedTuple

from pydantic import Field

from forcemesh.connection import ConfigSection
from forcemesh.errors import LocalProtocolError, RemoteProtocolError
from forcemesh.messages import Mode

Six = tuple[int, int, int, int, int, int]

PROTOCOL_VERSION = 3
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
    """Number of a command (PC to controller, 1 to 15) or report (controller to PC, 101 to 104)."""

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
    SIGNAL = 15
    POSE = 101
    JOINTS = 102
    HEALTH = 103
    SIGNALS = 104


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
    SEGMENT = 4
    JOINT_SPEED = 5


class CentreParam(IntEnum):
    """Param of command 11: the TCP, or only the centre of rotation of force feedback."""

    TCP = 0
    CENTRE = 1


class SignalParam(IntEnum):
    """Param of command 15: switch one output, or choose the six groups that 104 reports."""

    SWITCH = 0
    GROUPS = 1


class FeedbackSwitch(IntEnum):
    """Param of command 7; POSITION and ORIENTATION add up to both, STOP stops both.

    The specification's ForceFeedBackPosition and ForceFeedBackOrientation.
    """

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


class Scales(ConfigSection):
    """Packet units per millimetre, degree, newton, newton metre, millimetre per second.

    Requested by hello. The upper bounds leave room for 180 degrees of O, A, T and 360 of a joint on
    the negative side (-99999), 1 m, 100 N, 10 N m and 250 mm/s; the positive side (499999) is five
    times as large. The lower bounds keep the resolution of one unit useful.
    """

    position_per_mm: int = Field(50, ge=10, le=99)
    oat_per_deg: int = Field(500, ge=100, le=555)
    joint_per_deg: int = Field(250, ge=50, le=277)
    force_per_N: int = Field(100, ge=1, le=999)
    torque_per_Nm: int = Field(1000, ge=10, le=9999)
    speed_per_mm_s: int = Field(10, ge=1, le=1000)

    @property
    def vec(self) -> Six:
        """The scales in the order of hello."""
        return (
            self.position_per_mm,
            self.oat_per_deg,
            self.joint_per_deg,
            self.force_per_N,
            self.torque_per_Nm,
            self.speed_per_mm_s,
        )


class Quantity(NamedTuple):
    """Unit of a number in a packet."""

    unit: str
    per_si: float  # units per SI unit
    scale: str | int = 1  # packet units per unit: a name in `Scales`, or fixed


class PacketValue(NamedTuple):
    """One of the six numbers of a vector."""

    name: str
    quantity: Quantity

    @property
    def label(self) -> str:
        """Name with its unit."""
        unit = self.quantity.unit
        return f"{self.name} [{unit}]" if unit else self.name

    def units(self, scales: Scales) -> int:
        """Return the packet units per unit."""
        scale = self.quantity.scale
        return int(getattr(scales, scale)) if isinstance(scale, str) else scale


PacketValues = tuple[PacketValue, ...]


class Row(NamedTuple):
    """One row of the packet table."""

    com: Com
    params: range
    vectors: tuple[PacketValues, ...]  # one for all Params, or one for each; the rest of six is 0
    meaning: str
    ring: range = range(0)  # Params that the robot program executes and 101 echoes

    def numbers(self, param: int) -> PacketValues:
        """Return the vector of a Param."""
        return self.vectors[param if len(self.vectors) > 1 else 0]


def _values(*groups: tuple[Quantity, str]) -> PacketValues:
    """Return the values named in groups of one quantity each; a comma ends a name."""
    return tuple(
        PacketValue(name, quantity) for quantity, names in groups for name in names.split(", ")
    )


_DEG_PER_RAD = 180.0 / pi
_PLAIN = Quantity("", 1.0)
_MS = Quantity("ms", 1e3)
_MM = Quantity("mm", 1e3, "position_per_mm")
_MM_S = Quantity("mm/s", 1e3, "speed_per_mm_s")
_DEG = Quantity("deg", _DEG_PER_RAD, "oat_per_deg")
_JOINT = Quantity("deg", _DEG_PER_RAD, "joint_per_deg")
_JOINT_S = Quantity("deg/s", _DEG_PER_RAD, "joint_per_deg")
_N = Quantity("N", 1.0, "force_per_N")
_NM = Quantity("N m", 1.0, "torque_per_Nm")
_PERCENT = Quantity("%", 1e2, PERCENT)
_P_FORCE = Quantity("mm/N", 1e3, GAIN_P)
_I_FORCE = Quantity("mm/(N s)", 1e3, GAIN_I)
_P_TORQUE = Quantity("deg/(N m)", _DEG_PER_RAD, GAIN_P)
_I_TORQUE = Quantity("deg/(N m s)", _DEG_PER_RAD, GAIN_I)

_POSE = (_values((_MM, "X, Y, Z"), (_DEG, "O, A, T")),)
_JOINTS = (_values((_JOINT, "JT1, JT2, JT3, JT4, JT5, JT6")),)
_WRENCH = (_values((_N, "Fx, Fy, Fz"), (_NM, "Mx, My, Mz")),)
_SPEEDS = (_values((_PERCENT, "acceleration, deceleration, modular speed"), (_MM_S, "speed")),)
_GAINS = (
    _values(
        (_P_FORCE, "P gain x, P gain y, P gain z"), (_P_TORQUE, "P gain mx, P gain my, P gain mz")
    ),
    _values(
        (_I_FORCE, "I gain x, I gain y, I gain z"), (_I_TORQUE, "I gain mx, I gain my, I gain mz")
    ),
)
_SCALES = (_values((_PLAIN, ", ".join(Scales.model_fields))),)
_LIMITS = (
    _values(
        (_MM, "step"), (_DEG, "step"), (_MM_S, "speed"), (_MM, "travel"), (_N, "force ceiling"),
        (_MS, "watchdog"),
    ),
    _values(
        (_DEG, "turn limit"), (_NM, "torque ceiling"), (_MM, "set-point step"),
        (_DEG, "set-point step"), (_MM_S, "highest speed"),
    ),
    _values((_MM, "lower X, lower Y, lower Z")),
    _values((_MM, "upper X, upper Y, upper Z")),
    _values((_MS, "least segment"), (_MM_S, "least speed")),
    _values((_JOINT_S, "JT1 speed, JT2 speed, JT3 speed, JT4 speed, JT5 speed, JT6 speed")),
)  # fmt: skip
_HEALTH = (
    _values(
        (_PLAIN, "loops"), (_MS, "wrench age"), (_PLAIN, "queue length"),
        (_PERCENT, "monitor speed"), (_PLAIN, f"held ID - {ID_FIRST}, any peer"),
    ),
)  # fmt: skip
_GROUPS = ", ".join(f"first of group {k}" for k in range(1, 7))
_SIGNAL = (
    _values((_PLAIN, "output (off: negative)")),
    _values((_PLAIN, _GROUPS)),
)
_SIGNALS = (_values((_PLAIN, ", ".join(f"group {k}" for k in range(1, 7)))),)
_NONE: tuple[PacketValues, ...] = ((),)
_COUNT = range(ID_FIRST)
_CODE = range(-99_999, ID_FIRST)  # AS error codes are negative

# fmt: off
TABLE: dict[int, Row] = {row.com: row for row in (
    Row(Com.MOVE_POSE,      range(1), _POSE,   "a) move to a pose", range(1)),
    Row(Com.MOVE_JOINTS,    range(1), _JOINTS, "b) move to joint angles", range(1)),
    Row(Com.MOVE_BY_JOINTS, range(1), _JOINTS, "c) move by joint angles", range(1)),
    Row(Com.WRENCH,         range(1), _WRENCH, "d) wrench as it is read, base axes, at TCP"),
    Row(Com.SPEEDS,         range(1), _SPEEDS, "e) speeds and accelerations", range(1)),
    Row(Com.GAINS,          range(2), _GAINS,
        "f) gains: 0 proportional, 1 integral", range(2)),
    Row(Com.FEEDBACK,       range(3), _NONE,
        "g) 0 ForceFeedBackPosition, 1 ForceFeedBackOrientation, 2 stop", range(2)),
    Row(Com.HOLD,           range(1), _NONE,   "hold now"),
    Row(Com.HELLO,          _COUNT,   _SCALES, "first packet, both ways; version * 1000 + arm"),
    Row(Com.LIMITS,         range(6), _LIMITS, "limits that the controller enforces itself",
        range(6)),
    Row(Com.TCP,            range(2), _POSE,   "flange frame: 0 TCP, 1 centre of rotation",
        range(2)),
    Row(Com.HEARTBEAT,      range(1), _NONE,   "keep-alive, when nothing else is sent"),
    Row(Com.SET_POINT,      range(1), _POSE,   "one pose of a stream", range(1)),
    Row(Com.FORCE_SET_POINT, range(1), _WRENCH, "set point of the wrench, base axes"),
    Row(Com.SIGNAL,         range(2), _SIGNAL,
        "signals: 0 switch an output, 1 groups of 16 that 104 reports, 0 for none"),
    Row(Com.POSE,           _COUNT,   _POSE,   "flange pose; ID = last command accepted"),
    Row(Com.JOINTS,         _COUNT,   _JOINTS, "joint angles; ID = last command framed"),
    Row(Com.HEALTH,         _CODE,    _HEALTH, "health; Param = error code"),
    Row(Com.SIGNALS,        range(1), _SIGNALS,
        "signals, the first of a group is bit 0; ID = last command framed"),
)}
# fmt: on

REPORTS = frozenset({Com.HELLO, Com.POSE, Com.JOINTS, Com.HEALTH, Com.SIGNALS})
COMMANDS = frozenset(set(Com) - REPORTS | {Com.HELLO})
MODES: dict[Mode, Status] = {
    "position": Status.POSITION_FEEDBACK,
    "orientation": Status.ORIENTATION_FEEDBACK,
    "both": FEEDBACK_BITS,
}


def next_id(id_: int) -> int:
    """Return the ID that follows: 500000 to 999999, then 500000 again; after NO_ID any of them."""
    return ID_FIRST + (id_ + 1 - ID_FIRST) % ID_COUNT


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
    if (row := TABLE.get(com)) is None:
        raise RemoteProtocolError(f"Com {com} is not a command of protocol {PROTOCOL_VERSION}")
    if param not in row.params:
        raise RemoteProtocolError(
            f"Param {param} of command {com} ({row.com.name}) must be 0 to {row.params[-1]}"
        )
    return row.com
