"""Conversion of SI to packets and back: commands to the controller, and its reports. Pure.

A command is a packet without its ID, which the dialogue assigns when it sends. The packet table
gives units and scales; O, A, T are used only here.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import isfinite

import numpy as np
import pinocchio as pin

from common.motion.frames import Oat, R_from_oat, is_finite_pose, oat_from_R
from controller.packet import VALUE_MAX, VALUE_MIN, ZERO_VEC, Packet, VecInt
from controller.packet_table import (
    ID_FIRST,
    PROTOCOL_VERSION,
    REPORTS,
    TABLE,
    Bank,
    CentreParam,
    Com,
    FeedbackSwitch,
    GainKind,
    PacketValue,
    Scales,
    Six,
    Status,
    greeted,
    greeting,
    known,
    unpack_status,
)
from forcemesh.errors import LocalProtocolError, RemoteProtocolError
from forcemesh.messages import Gains, Joints, Mode, Speed, Vec3


@dataclass(frozen=True, slots=True)
class Command:
    """A packet without its ID."""

    com: Com
    param: int = 0
    vec: VecInt = ZERO_VEC

    def packet(self, id_: int) -> Packet:
        """Return the packet under an ID."""
        return Packet(id_, int(self.com), self.param, self.vec)


@dataclass(frozen=True, slots=True)
class PoseCarry:
    """State between two poses of a stream: rounding error, and O, A, T for the singularities."""

    error_m: Vec3 = (0.0, 0.0, 0.0)  # target minus sent
    oat: Oat | None = None


NO_CARRY = PoseCarry()


def unchanged(T_target: pin.SE3, now_ns: int) -> pin.SE3:  # noqa: ARG001 - as `Pacing.release`
    """Return a set point unchanged."""
    return T_target


@dataclass(frozen=True, slots=True)
class Pacing:
    """Flow control: number of packets in flight to the controller, and the heartbeat interval."""

    max_unexecuted: int = 1  # unexecuted in the ring, before the next set point, centre or gains
    max_unacknowledged: int = 2  # unacknowledged by the receiver, before another wrench
    heartbeat_after_s: float = 0.040
    # Pose to send for the newest set point [at ns]: itself, one towards it, or None for not yet.
    release: Callable[[pin.SE3, int], pin.SE3 | None] = unchanged


@dataclass(frozen=True, slots=True)
class ControllerLimits:
    """Limits that the controller enforces itself (commands 10 and 11)."""

    # of force feedback: an iteration, its speed, its travel; and the watchdog time
    step_m: float
    step_rad: float
    speed_m_s: float
    travel_m: float
    force_N: float
    watchdog_s: float
    # of every motion
    turn_rad: float  # since the first one after a hold
    torque_Nm: float
    set_point_m: float  # from one set point of a stream to the next
    set_point_rad: float
    fastest_m_s: float
    lower_m: Vec3  # the box of the TCP, base axes
    upper_m: Vec3
    T_flange_tcp: pin.SE3
    # of this controller and arm
    least_segment_s: float  # of a motion that blends into the next one
    least_speed_m_s: float  # that it executes
    joint_speed_rad_s: Joints  # at 100 %


GROUP_SPAN = 1 << 16  # of a group of 16 signals in 104
HOLD = Command(Com.HOLD)
HEARTBEAT = Command(Com.HEARTBEAT)
STOP_FEEDBACK = Command(Com.FEEDBACK, int(FeedbackSwitch.STOP))
SWITCHES = {
    "position": (FeedbackSwitch.POSITION,),
    "orientation": (FeedbackSwitch.ORIENTATION,),
    "both": (FeedbackSwitch.POSITION, FeedbackSwitch.ORIENTATION),
}


@lru_cache(maxsize=64)
def _numbers(com: int, param: int, scales: Six) -> tuple[tuple[PacketValue, int], ...]:
    """Return the values of a vector, each with its packet units per unit."""
    named: dict[str | int, int] = dict(zip(Scales.model_fields, scales, strict=True))
    return tuple(
        (number, named.get(number.quantity.scale) or int(number.quantity.scale))
        for number in TABLE[com].numbers(param)
    )


def encoded(com: Com, values: Sequence[float], scales: Scales, param: int = 0) -> Command:
    """Return a command from its values in SI, in the order of the packet table.

    Raises LocalProtocolError for another number of values than the table has, and, naming the
    quantity, for a value that is not finite or does not fit.
    """
    vec, numbers = [0] * 6, _numbers(com, param, scales.vec)
    if len(values) != len(numbers):
        names = "; ".join(number.name for number, _ in numbers)
        raise LocalProtocolError(
            f"command {com:d} has {len(numbers)} values ({names}), {len(values)} were given: "
            "in the packet table a comma ends a name"
        )
    for place, (value, (number, scale)) in enumerate(zip(values, numbers, strict=True)):
        amount = value * number.quantity.per_si
        if not isfinite(amount):
            raise LocalProtocolError(f"{number.label} is {amount}, it cannot be sent")
        vec[place] = round(amount * scale)
        if not VALUE_MIN <= vec[place] <= VALUE_MAX:
            low, high = VALUE_MIN / scale, VALUE_MAX / scale
            raise LocalProtocolError(
                f"{number.label} is {amount:.6g}, the packet holds {low:.6g} to {high:.6g}"
            )
    a, b, c, d, e, f = vec
    return Command(com, param, (a, b, c, d, e, f))


# --- commands -------------------------------------------------------------------------------------


def pose(
    com: Com, T: pin.SE3, scales: Scales, carry: PoseCarry = NO_CARRY, *, param: int = 0
) -> tuple[Command, PoseCarry]:
    """Return command 1, 11 or 13 with a pose, and the state for the next pose of a stream.

    One unit is 0.02 mm, which is 2 N at 1e5 N/m. The rounding error of this position is therefore
    added to the next one (first-order noise shaping): the mean is exact.

    Raises LocalProtocolError for a pose that is not finite or does not fit.
    """
    if not is_finite_pose(T):
        raise LocalProtocolError("the pose contains a number that is not finite: it is not sent")
    oat, per_mm = oat_from_R(T.rotation, carry.oat), scales.position_per_mm
    x, y, z = [p + error for p, error in zip(T.translation.tolist(), carry.error_m, strict=True)]
    command = encoded(com, (x, y, z, *oat), scales, param)
    sent_x, sent_y, sent_z = [units / per_mm * 1e-3 for units in command.vec[:3]]
    return command, PoseCarry((x - sent_x, y - sent_y, z - sent_z), oat)


def tcp(T_flange_tcp: pin.SE3, scales: Scales, point: CentreParam) -> Command:
    """Return command 11: the TCP, or only the centre of rotation of force feedback."""
    return pose(Com.TCP, T_flange_tcp, scales, param=int(point))[0]


def wrench(force_N: Vec3, torque_Nm: Vec3, scales: Scales) -> Command:
    """Return command 4: the measured wrench, base axes, about the TCP."""
    return encoded(Com.WRENCH, (*force_N, *torque_Nm), scales)


def force_set_point(force_N: Vec3, torque_Nm: Vec3, scales: Scales) -> Command:
    """Return command 14: the set point of force feedback in the controller."""
    return encoded(Com.FORCE_SET_POINT, (*force_N, *torque_Nm), scales)


def speeds(speed: Speed, scales: Scales) -> Command:
    """Return command 5."""
    shares = (speed.accel_fraction, speed.decel_fraction, speed.modular_fraction)
    return encoded(Com.SPEEDS, (*shares, speed.mechanical_m_s), scales)


def gains(gains_si: Gains, scales: Scales) -> tuple[Command, Command]:
    """Return the two commands 6: proportional, then integral.

    Raises LocalProtocolError also for a gain that would be rounded to zero.
    """
    proportional = (*gains_si.force_p_m_per_N, *gains_si.torque_p_rad_per_Nm)
    integral = (*gains_si.force_i_m_per_Ns, *gains_si.torque_i_rad_per_Nms)
    return (
        _gains(GainKind.PROPORTIONAL, proportional, scales),
        _gains(GainKind.INTEGRAL, integral, scales),
    )


def _gains(kind: GainKind, values: tuple[float, ...], scales: Scales) -> Command:
    command = encoded(Com.GAINS, values, scales, int(kind))
    numbers = TABLE[Com.GAINS].numbers(kind)
    for number, value, sent in zip(numbers, values, command.vec, strict=True):
        if value != 0.0 and sent == 0:
            text = f"{number.name} is {value:.3g}, too small: it would be sent as 0"
            raise LocalProtocolError(text)
    return command


def start_feedback(mode: Mode) -> tuple[Command, ...]:
    """Return the commands 7 that start force feedback in a mode; both is one after the other."""
    return tuple(Command(Com.FEEDBACK, int(switch)) for switch in SWITCHES[mode])


def hello(scales: Scales, arm: int) -> Command:
    """Return command 9, which requests the scales and names the arm's number."""
    return Command(Com.HELLO, greeting(arm), scales.vec)


def set_up(kept: ControllerLimits, scales: Scales) -> tuple[Command, ...]:
    """Return the commands required before the controller moves: 10 and 11."""
    feedback = (
        kept.step_m, kept.step_rad, kept.speed_m_s, kept.travel_m, kept.force_N, kept.watchdog_s
    )  # fmt: skip
    motion = (
        kept.turn_rad, kept.torque_Nm, kept.set_point_m, kept.set_point_rad, kept.fastest_m_s
    )  # fmt: skip
    lowest_m, highest_m = (
        value / scales.position_per_mm * 1e-3 for value in (VALUE_MIN, VALUE_MAX)
    )  # of the poses that a packet can hold: no corner need be farther out
    banks: dict[Bank, Sequence[float]] = {
        Bank.FEEDBACK: feedback,
        Bank.MOTION: motion,
        Bank.LOWER_CORNER: np.clip(kept.lower_m, lowest_m, highest_m).tolist(),
        Bank.UPPER_CORNER: np.clip(kept.upper_m, lowest_m, highest_m).tolist(),
        Bank.SEGMENT: (kept.least_segment_s, kept.least_speed_m_s),
        Bank.JOINT_SPEED: kept.joint_speed_rad_s,
    }
    return (
        *(encoded(Com.LIMITS, values, scales, int(bank)) for bank, values in banks.items()),
        tcp(kept.T_flange_tcp, scales, CentreParam.TCP),
    )


# --- reports --------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class HelloReceived:
    """The controller's hello: same protocol version, with the requested scales."""


@dataclass(frozen=True, slots=True)
class PoseReport:
    """101: flange in base, ID of the last command executed by the robot program."""

    T_base_flange: pin.SE3
    taken_id: int
    counter: int
    status: Status


@dataclass(frozen=True, slots=True)
class JointReport:
    """102: joint angles, ID of the last command framed by the receiver."""

    joint_rad: Joints
    framed_id: int
    counter: int
    status: Status


@dataclass(frozen=True, slots=True)
class HealthReport:
    """103: health of the controller's program."""

    error_code: int
    loop_count: int
    wrench_age_s: float
    queue_length: int
    monitor_speed_fraction: float
    held_id: int  # of the last hold; hello is one
    any_peer: bool  # fm.peer names no address: any client may connect


@dataclass(frozen=True, slots=True)
class SignalReport:
    """104: signals by group of 16, the first of a group in bit 0; ID as in 102."""

    groups: VecInt
    framed_id: int


Event = HelloReceived | PoseReport | JointReport | HealthReport | SignalReport


def parse_hello(packet: Packet, asked: Scales, arm: int) -> HelloReceived:
    """Return the controller's hello.

    Raises RemoteProtocolError when the first packet is another one, or when version, number of the
    arm or scales differ from the requested ones; the text contains both and the remedy.
    """
    if packet.com != Com.HELLO:
        raise RemoteProtocolError(
            f"the controller's first packet is command {packet.com}, it must be hello "
            f"({int(Com.HELLO)}): is the program that ships with this version loaded?"
        )
    version, number = greeted(packet.param)
    if version != PROTOCOL_VERSION:
        raise RemoteProtocolError(
            f"the controller's program speaks protocol {version}, this gateway {PROTOCOL_VERSION}: "
            "load controller/forcemesh.as of this version, then EXECUTE fm.main"
        )
    if number != arm:
        raise RemoteProtocolError(
            f"this is arm {number}, the cell file's gateway.arm is {arm}: are cables or addresses "
            "of two arms swapped? If not, make fm.num in fm.config and gateway.arm the same"
        )
    scales = zip(Scales.model_fields, asked.vec, packet.vec, strict=True)
    if wrong := [f"{name} asked {a}, has {b}" for name, a, b in scales if a != b]:
        raise RemoteProtocolError(f"the controller did not set our scales: {'; '.join(wrong)}")
    return HelloReceived()


def parse_report(
    packet: Packet, scales: Scales
) -> PoseReport | JointReport | HealthReport | SignalReport:
    """Return a report in SI. Raise RemoteProtocolError for any other packet."""
    com = known(packet.com, packet.param)
    if com not in REPORTS:
        raise RemoteProtocolError(f"the controller sent a gateway command, {packet.com}")
    if com == Com.HELLO:
        raise RemoteProtocolError("the controller sent hello twice")
    if com == Com.SIGNALS:
        return _parse_signals(packet)
    numbers = zip(packet.vec, _numbers(com, 0, scales.vec), strict=True)
    a, b, c, d, e, f = [
        units / scale / number.quantity.per_si for units, (number, scale) in numbers
    ]
    if com == Com.HEALTH:
        return HealthReport(packet.param, int(a), b, int(c), d, ID_FIRST + int(e), f != 0)
    counter, status = unpack_status(packet.param)
    if com == Com.POSE:
        T_base_flange = pin.SE3(R_from_oat(Oat(d, e, f)), np.array([a, b, c]))
        return PoseReport(T_base_flange, packet.id, counter, status)
    return JointReport((a, b, c, d, e, f), packet.id, counter, status)


def _parse_signals(packet: Packet) -> SignalReport:
    """Return 104. Raise RemoteProtocolError for a number that is no group of 16 signals."""
    if not all(0 <= group < GROUP_SPAN for group in packet.vec):
        worst = next(group for group in packet.vec if not 0 <= group < GROUP_SPAN)
        raise RemoteProtocolError(
            f"104 has {worst} for a group of 16 signals, it must be 0 to {GROUP_SPAN - 1}"
        )
    return SignalReport(packet.vec, packet.id)
