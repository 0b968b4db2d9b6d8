"""Command encoder: SI to packet. Millimetres, degrees and O, A, T are used only here.

A command is a packet without its ID, which the dialogue assigns when it sends.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import degrees

import numpy as np
import pinocchio as pin

from common.motion.frames import Array, Oat, is_finite_pose, oat_from_R
from controller.packet import VALUE_MAX, VALUE_MIN, ZERO_VEC, Packet, VecInt
from controller.packet_table import (
    FEEDBACK_BITS,
    GAIN_I,
    GAIN_P,
    PERCENT,
    Bank,
    CentreParam,
    Com,
    FeedbackSwitch,
    GainKind,
    Status,
    greeting,
)
from forcemesh.errors import LocalProtocolError
from forcemesh.messages import Gains, Joints, Mode, Speed, Vec3
from services.gateway.scales import Scales, to_units, to_vec

MM_PER_M = 1e3
_POSE_NAMES = ("X [mm]", "Y [mm]", "Z [mm]", "O [deg]", "A [deg]", "T [deg]")
_JOINT_NAMES = tuple(f"JT{number} [deg]" for number in range(1, 7))
_WRENCH_NAMES = ("Fx [N]", "Fy [N]", "Fz [N]", "Mx [N m]", "My [N m]", "Mz [N m]")
_SPEED_NAMES = ("acceleration [%]", "deceleration [%]", "modular speed [%]", "speed [mm/s]")
_LIMIT_NAMES = (
    "step [mm]", "step [deg]", "speed [mm/s]", "travel [mm]", "force ceiling [N]", "watchdog [ms]",
)  # fmt: skip
_MOTION_NAMES = (
    "turn limit [deg]", "torque ceiling [N m]", "set-point step [mm]", "set-point step [deg]",
    "highest speed [mm/s]", "nothing",
)  # fmt: skip


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

    error_mm: Vec3 = (0.0, 0.0, 0.0)  # target minus sent
    oat: Oat | None = None


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


BITS_OF_MODE = {
    "position": Status.POSITION_FEEDBACK,
    "orientation": Status.ORIENTATION_FEEDBACK,
    "both": FEEDBACK_BITS,
}
HOLD = Command(Com.HOLD)
HEARTBEAT = Command(Com.HEARTBEAT)
STOP_FEEDBACK = Command(Com.FEEDBACK, int(FeedbackSwitch.STOP))


def move_to_pose(
    T_base_flange: pin.SE3, scales: Scales, carry: PoseCarry
) -> tuple[Command, PoseCarry]:
    """Return command 1, a goal, and the state for the next pose.

    One unit is 0.02 mm, which is 2 N at 1e5 N/m. The rounding error of this position is therefore
    added to the next one (first-order noise shaping): the mean is exact.

    Raises LocalProtocolError for a pose that is not finite or does not fit.
    """
    _refuse_unless_finite(T_base_flange)
    oat = oat_from_R(T_base_flange.rotation, carry.oat)
    target_mm = T_base_flange.translation * MM_PER_M + np.array(carry.error_mm)
    vec = _pose_vec(target_mm, oat, scales)
    x, y, z = (float(e) for e in target_mm - np.array(vec[:3]) / scales.position_per_mm)
    return Command(Com.MOVE_POSE, 0, vec), PoseCarry((x, y, z), oat)


def set_point(
    T_base_flange: pin.SE3, scales: Scales, carry: PoseCarry
) -> tuple[Command, PoseCarry]:
    """Return command 13, one pose of a stream; otherwise as `move_to_pose`."""
    command, rest = move_to_pose(T_base_flange, scales, carry)
    return replace(command, com=Com.SET_POINT), rest


def move_to_joints(joint_rad: Joints, scales: Scales) -> Command:
    """Return command 2 for joint angles [rad]."""
    return Command(Com.MOVE_JOINTS, 0, _joint_vec(joint_rad, scales))


def move_by_joints(turn_rad: Joints, scales: Scales) -> Command:
    """Return command 3 for joint rotations [rad]."""
    return Command(Com.MOVE_BY_JOINTS, 0, _joint_vec(turn_rad, scales))


def wrench(force_N: Vec3, torque_Nm: Vec3, scales: Scales) -> Command:
    """Return command 4: the measured wrench, base axes, about the TCP."""
    return Command(Com.WRENCH, 0, _wrench_vec(force_N, torque_Nm, scales))


def force_set_point(force_N: Vec3, scales: Scales) -> Command:
    """Return command 14: the set point of force feedback in the controller."""
    return Command(Com.FORCE_SET_POINT, 0, _wrench_vec(force_N, (0.0, 0.0, 0.0), scales))


def speeds(speed: Speed, scales: Scales) -> Command:
    """Return command 5."""
    fractions = (speed.accel_fraction, speed.decel_fraction, speed.modular_fraction)
    units = [
        to_units(name, value * 100.0, PERCENT)
        for name, value in zip(_SPEED_NAMES[:3], fractions, strict=True)
    ]
    mechanical = to_units(_SPEED_NAMES[3], speed.mechanical_m_s * MM_PER_M, scales.speed_per_mm_s)
    return Command(Com.SPEEDS, 0, (units[0], units[1], units[2], mechanical, 0, 0))


def gains(gains_si: Gains) -> tuple[Command, Command]:
    """Return the two commands 6: proportional, then integral.

    Raises LocalProtocolError also for a gain that would be rounded to zero.
    """
    proportional = _gain_vec("P", gains_si.force_p_m_per_N, gains_si.torque_p_rad_per_Nm, GAIN_P)
    integral = _gain_vec("I", gains_si.force_i_m_per_Ns, gains_si.torque_i_rad_per_Nms, GAIN_I)
    return (
        Command(Com.GAINS, int(GainKind.PROPORTIONAL), proportional),
        Command(Com.GAINS, int(GainKind.INTEGRAL), integral),
    )


def start_feedback(mode: Mode) -> tuple[Command, ...]:
    """Return the commands 7 that start force feedback in a mode; both is one after the other."""
    switches = {
        "position": (FeedbackSwitch.POSITION,),
        "orientation": (FeedbackSwitch.ORIENTATION,),
        "both": (FeedbackSwitch.POSITION, FeedbackSwitch.ORIENTATION),
    }
    return tuple(Command(Com.FEEDBACK, int(switch)) for switch in switches[mode])


def hello(scales: Scales, arm: int) -> Command:
    """Return command 9, which requests the scales and names the arm's number."""
    return Command(Com.HELLO, greeting(arm), scales.vec)


def set_up(kept: ControllerLimits, scales: Scales) -> tuple[Command, ...]:
    """Return the commands required before the controller moves: 10 and 11."""
    corners = ((Bank.LOWER_CORNER, kept.lower_m), (Bank.UPPER_CORNER, kept.upper_m))
    return (
        _feedback_limits(kept, scales),
        _motion_limits(kept, scales),
        *(Command(Com.LIMITS, int(bank), _corner(place, scales)) for bank, place in corners),
        tcp(kept.T_flange_tcp, scales, CentreParam.TCP),
    )


def _feedback_limits(kept: ControllerLimits, scales: Scales) -> Command:
    values = (
        kept.step_m * MM_PER_M,
        degrees(kept.step_rad),
        kept.speed_m_s * MM_PER_M,
        kept.travel_m * MM_PER_M,
        kept.force_N,
        kept.watchdog_s * 1e3,
    )
    mm, degree = scales.position_per_mm, scales.oat_per_deg
    per_one = (mm, degree, scales.speed_per_mm_s, mm, scales.force_per_N, 1)
    return Command(Com.LIMITS, int(Bank.FEEDBACK), to_vec(_LIMIT_NAMES, values, per_one))


def _motion_limits(kept: ControllerLimits, scales: Scales) -> Command:
    values = (
        degrees(kept.turn_rad),
        kept.torque_Nm,
        kept.set_point_m * MM_PER_M,
        degrees(kept.set_point_rad),
        kept.fastest_m_s * MM_PER_M,
        0.0,
    )
    mm, degree = scales.position_per_mm, scales.oat_per_deg
    per_one = (degree, scales.torque_per_Nm, mm, degree, scales.speed_per_mm_s, 1)
    return Command(Com.LIMITS, int(Bank.MOTION), to_vec(_MOTION_NAMES, values, per_one))


def _corner(place_m: Vec3, scales: Scales) -> VecInt:
    """Return a corner of the box, clamped to the range of poses that a packet can hold."""
    units = (round(value * MM_PER_M * scales.position_per_mm) for value in place_m)
    x, y, z = (min(max(unit, VALUE_MIN), VALUE_MAX) for unit in units)
    return (x, y, z, 0, 0, 0)


def tcp(T_flange_tcp: pin.SE3, scales: Scales, point: CentreParam) -> Command:
    """Return command 11: the TCP, or only the centre of rotation of force feedback."""
    _refuse_unless_finite(T_flange_tcp)
    position_mm = T_flange_tcp.translation * MM_PER_M
    vec = _pose_vec(position_mm, oat_from_R(T_flange_tcp.rotation), scales)
    return Command(Com.TCP, int(point), vec)


def _refuse_unless_finite(T: pin.SE3) -> None:
    if not is_finite_pose(T):
        raise LocalProtocolError("the pose contains a number that is not finite: it is not sent")


def _wrench_vec(force_N: Vec3, torque_Nm: Vec3, scales: Scales) -> VecInt:
    per_one = (scales.force_per_N,) * 3 + (scales.torque_per_Nm,) * 3
    return to_vec(_WRENCH_NAMES, (*force_N, *torque_Nm), per_one)


def _pose_vec(position_mm: Array, oat: Oat, scales: Scales) -> VecInt:
    x, y, z = (float(value) for value in position_mm)
    o, a, t = (degrees(angle) for angle in oat)
    per_one = (scales.position_per_mm,) * 3 + (scales.oat_per_deg,) * 3
    return to_vec(_POSE_NAMES, (x, y, z, o, a, t), per_one)


def _joint_vec(joint_rad: Joints, scales: Scales) -> VecInt:
    a, b, c, d, e, f = (degrees(angle) for angle in joint_rad)
    return to_vec(_JOINT_NAMES, (a, b, c, d, e, f), (scales.joint_per_deg,) * 6)


def _gain_vec(kind: str, force: Vec3, torque: Vec3, per_one: float) -> VecInt:
    """Scale gains from m and rad to the packet's mm and degrees."""
    names = tuple(f"{kind} gain {axis}" for axis in ("x", "y", "z", "mx", "my", "mz"))
    fx, fy, fz = (value * MM_PER_M for value in force)
    mx, my, mz = (degrees(value) for value in torque)
    vec = to_vec(names, (fx, fy, fz, mx, my, mz), (per_one,) * 6)
    for name, requested, sent in zip(names, (*force, *torque), vec, strict=True):
        if requested != 0.0 and sent == 0:
            raise LocalProtocolError(f"{name} is {requested:.3g}, too small: it would be sent as 0")
    return vec
