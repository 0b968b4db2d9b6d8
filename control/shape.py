"""Command of a period: the motion that law and compliant axes want, within all limits. Pure.

Nothing before this limits a motion. What is cut here goes back: the commanded pose is the state of
the PI law, and a virtual mass keeps no speed that was not left to it.

The turn comes first. The point of contact then stays where it is for the turn that is left, and on
a frame with an origin the TCP moves on the arc of that turn. Force control and compliance keep the
speed limit without what the turn adds, which is the speed of the point of contact, and with it. A
deviation from the reference is limited last.
"""

from dataclasses import dataclass
from math import hypot, inf, sqrt

from common.config.cell import CellConfig
from common.motion.frames import (
    Array,
    Speeds,
    cross,
    moved,
    plus,
    rotated,
    rotated_back,
    scaled,
    speeds_between,
)
from control.axis_task import CELLS, clipped, masked
from control.compliance import ComplianceState
from control.law import LawInput, LawMotion, limit_norm
from forcemesh.messages import ZERO3, Vec3

ACCEL_SHARE = 0.95  # of the cell's limit: the arbiter must not have to limit the command
NO_TRAVEL_M = 1e-12  # of a period: below it there is no travel to slow


@dataclass(frozen=True, slots=True)
class MotionLimits:
    """Limits of the motion of force feedback in one cell."""

    speed_m_s: float
    speed_rad_s: float
    accel_m_s2: float = inf  # of force control

    @classmethod
    def of(cls, cell: CellConfig, *, predicts: bool) -> "MotionLimits":
        """Return those of a cell; a law with a predictor needs its commands executed unchanged."""
        speed_m_s = min(cell.force.speed_max_m_s, cell.limits.speed_m_s)
        accel_m_s2 = ACCEL_SHARE * cell.limits.accel_m_s2 if predicts else inf
        return cls(speed_m_s, cell.force.speed_max_rad_s, accel_m_s2)


def shape(
    motion: LawMotion,
    complied: Speeds,
    sample: LawInput,
    compliance: ComplianceState,
    *,
    limits: MotionLimits,
) -> None:
    """Set the command of a period, and what is left of the motion that was wanted.

    Args:
        motion: Of the law, advanced in place.
        complied: What the compliant axes want: shift [m] and rotation [rad], base axes.
        sample: Input of the law.
        compliance: Its reference and its virtual masses.
        limits: The cell's.
    """
    task, T, (along, about) = sample.task, sample.motion.T_base_tcp, sample.task.moving
    turn_rad = masked(
        plus(motion.turn_rad, complied[1]), about, sample.R_base_task, task.speeds[1],
        share=sample.dt_s,
    )  # fmt: skip
    turn_rad = limit_norm(turn_rad, limits.speed_rad_s * sample.dt_s)
    turn_rad = _turn_within_deviation(turn_rad, sample, compliance)
    own_m = _force_control_m(motion, sample, limits)
    motion.speed_m_s = scaled(own_m, 1.0 / sample.dt_s)
    if task.complies:
        own_m = _within_speeds(plus(own_m, complied[0]), sample, limits)
    shift_m, by_turn_m = own_m, ZERO3
    if motion.lever_m is not None:
        turned_rad = masked(turn_rad, task.torque_about, sample.R_base_task)
        axes = task.compliant[0] if motion.contact == "approach" else along
        by_turn_m = masked(cross(motion.lever_m, turned_rad), axes, sample.R_base_task)
        shift_m = _within_speeds(plus(own_m, by_turn_m), sample, limits)
    if task.origin_m is not None:  # far from it a slow turn is a fast travel: both are slowed
        shift_m = plus(own_m, cross(turn_rad, sample.arm_m))
        slowed = min(1.0, limits.speed_m_s * sample.dt_s / max(hypot(*shift_m), NO_TRAVEL_M))
        shift_m, turn_rad = scaled(shift_m, slowed), scaled(turn_rad, slowed)
        by_turn_m = cross(turn_rad, sample.arm_m)
    shift_m = _shift_within_deviation(shift_m, sample, compliance)
    motion.T_base_tcp = moved(T, (shift_m, turn_rad), 1.0)
    motion.shift_m = motion.turn_rad = ZERO3
    left_m = plus(shift_m, by_turn_m, -1.0)
    compliance.keep((own_m, complied[1]), (left_m, turn_rad), sample)
    compliance.note_limits(motion.T_base_tcp, sample)


def _force_control_m(motion: LawMotion, sample: LawInput, limits: MotionLimits) -> Vec3:
    """Return the shift by force control, base axes; an approach has limits of its own."""
    shift_m = _within_speeds(motion.shift_m, sample, limits)
    if limits.accel_m_s2 == inf or motion.contact == "approach":
        return shift_m
    before_m_s = masked(sample.motion.speed_m_s, sample.task.force_along, sample.R_base_task)
    before_m = scaled(before_m_s, sample.dt_s)
    change_m = plus(shift_m, before_m, -1.0)
    return plus(before_m, limit_norm(change_m, limits.accel_m_s2 * sample.dt_s**2))


def _within_speeds(shift_m: Vec3, sample: LawInput, limits: MotionLimits) -> Vec3:
    """Return a shift within the speeds of the axes, and of the tool."""
    task, dt_s = sample.task, sample.dt_s
    if task.speeds[0] is not None:
        along = rotated_back(sample.R_base_task, shift_m)
        shift_m = rotated(sample.R_base_task, clipped(along, task.speeds[0], dt_s))
    return limit_norm(shift_m, limits.speed_m_s * dt_s)


def _turn_within_deviation(turn_rad: Vec3, sample: LawInput, compliance: ComplianceState) -> Vec3:
    """Return a turn that keeps the tool within its largest rotation from the reference."""
    limits_rad = sample.task.deviations[1]
    if limits_rad == CELLS:
        return turn_rad
    T = sample.motion.T_base_tcp
    _, away_rad = compliance.deviation(moved(T, (ZERO3, turn_rad), 1.0), sample)
    kept_rad = clipped(away_rad, limits_rad)
    if kept_rad == away_rad:
        return turn_rad
    turned_rad = rotated(sample.R_base_task, kept_rad)
    return speeds_between(T, moved(compliance.T_reference, (ZERO3, turned_rad), 1.0), 1.0)[1]


def _shift_within_deviation(shift_m: Vec3, sample: LawInput, compliance: ComplianceState) -> Vec3:
    """Return a shift that keeps the tool within its largest travel from the reference."""
    limits_m = sample.task.deviations[0]
    if limits_m == CELLS:
        return shift_m
    T = sample.motion.T_base_tcp
    away_m, _ = compliance.deviation(moved(T, (shift_m, ZERO3), 1.0), sample)
    cut_m = plus(clipped(away_m, limits_m), away_m, -1.0)
    return plus(shift_m, rotated(sample.R_base_task, cut_m))


def room_m(pushed_m: Array, direction: Array, most_m: float) -> float:
    """Return the longest motion along a direction that stays, with another one, within most_m."""
    along_m = float(pushed_m @ direction)
    return max(0.0, sqrt(max(0.0, most_m**2 - float(pushed_m @ pushed_m) + along_m**2)) - along_m)
