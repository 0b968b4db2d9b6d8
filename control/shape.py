"""Command of a period: the motion that law and compliant axes want, within all limits. Pure.

Nothing before this limits a motion, and what is cut here goes back: the commanded pose is the state
of the PI law, and virtual masses continue at the speed that was left to them.

The turn comes first. The point of contact then stays where it is for the turn that is left, and on
a frame with an origin the TCP moves on the arc of that turn.
"""

from dataclasses import dataclass
from math import hypot, inf, sqrt

from common.config.cell import CellConfig
from common.motion.frames import (
    Array,
    cross,
    moved,
    plus,
    rotated,
    scaled,
    speeds_between,
)
from control.axis_task import CELLS, AxisLimits, clipped, masked
from control.compliance import ComplianceState
from control.law import LawInput, LawMotion, limit_norm
from forcemesh.messages import ZERO3, Vec3

ACCEL_SHARE = 0.95  # of the cell's limit: the arbiter must not have to limit the command
NO_TRAVEL_M = 1e-12  # of a period: below it there is no travel to slow
AT_LIMIT = 0.999  # of its deviation: an axis there is at the limit


@dataclass(frozen=True, slots=True)
class MotionLimits:
    """Limits of the motion of force feedback in one cell."""

    speed_m_s: float
    speed_rad_s: float
    accel_m_s2: float = inf

    @classmethod
    def of(cls, cell: CellConfig, *, predicts: bool) -> "MotionLimits":
        """Return those of a cell; a law with a predictor needs its commands executed unchanged."""
        speed_m_s = min(cell.force.speed_max_m_s, cell.limits.speed_m_s)
        accel_m_s2 = ACCEL_SHARE * cell.limits.accel_m_s2 if predicts else inf
        return cls(speed_m_s, cell.force.speed_max_rad_s, accel_m_s2)


def shape(
    motion: LawMotion, sample: LawInput, compliance: ComplianceState, limits: MotionLimits
) -> None:
    """Set the command of the motion that is wanted, and what is left of it."""
    task, dt_s, R, T = sample.task, sample.dt_s, sample.R_base_task, sample.motion.T_base_tcp
    most_m, (along, about) = limits.speed_m_s * dt_s, task.moving
    turn_rad = masked(motion.turn_rad, about, R, task.speeds[1], share=dt_s)
    turn_rad = limit_norm(turn_rad, limits.speed_rad_s * dt_s)
    turn_rad = _turn_within_deviation(turn_rad, sample, compliance)
    shift_m = motion.shift_m
    if limits.accel_m_s2 < inf:
        before_m = scaled(masked(sample.motion.speed_m_s, along, R), dt_s)
        change_m = limit_norm(plus(shift_m, before_m, -1.0), limits.accel_m_s2 * dt_s**2)
        shift_m = plus(before_m, change_m)
    by_turn_m = ZERO3  # shift of the TCP
    if motion.lever_m is not None:
        turned_rad = masked(turn_rad, task.torque_about, R)
        by_turn_m = scaled(masked(cross(turned_rad, motion.lever_m), along, R), -1.0)
        shift_m = plus(shift_m, by_turn_m)
    shift_m = limit_norm(masked(shift_m, along, R, task.speeds[0], share=dt_s), most_m)
    if task.origin_m is not None:  # far from it a slow turn is a fast travel: both are slowed
        on_arc_m = plus(shift_m, cross(turn_rad, sample.arm_m))
        slowed = min(1.0, most_m / max(hypot(*on_arc_m), NO_TRAVEL_M))
        shift_m, turn_rad = scaled(on_arc_m, slowed), scaled(turn_rad, slowed)
        by_turn_m = cross(turn_rad, sample.arm_m)
    shift_m = _shift_within_deviation(shift_m, sample, compliance)
    motion.T_base_tcp = moved(T, (shift_m, turn_rad), 1.0)
    motion.speed_m_s = scaled(plus(shift_m, by_turn_m, -1.0), 1.0 / dt_s)
    compliance.keep(motion.speed_m_s, scaled(turn_rad, 1.0 / dt_s), sample)


def _turn_within_deviation(turn_rad: Vec3, sample: LawInput, compliance: ComplianceState) -> Vec3:
    """Return a turn that keeps the tool within its largest rotation from the reference."""
    limits_rad = sample.task.deviations[1]
    if limits_rad == CELLS:
        return turn_rad
    T, R = sample.motion.T_base_tcp, sample.R_base_task
    _, away_rad = compliance.deviation(moved(T, (ZERO3, turn_rad), 1.0), sample)
    kept_rad = clipped(away_rad, limits_rad)
    compliance.at_limit[3:] = at_limits(away_rad, limits_rad)
    if kept_rad == away_rad:
        return turn_rad
    T_kept = moved(compliance.T_reference, (ZERO3, rotated(R, kept_rad)), 1.0)
    return speeds_between(T, T_kept, 1.0)[1]


def _shift_within_deviation(shift_m: Vec3, sample: LawInput, compliance: ComplianceState) -> Vec3:
    """Return a shift that keeps the tool within its largest travel from the reference."""
    limits_m = sample.task.deviations[0]
    if limits_m == CELLS:
        return shift_m
    T, R = sample.motion.T_base_tcp, sample.R_base_task
    away_m, _ = compliance.deviation(moved(T, (shift_m, ZERO3), 1.0), sample)
    kept_m = clipped(away_m, limits_m)
    compliance.at_limit[:3] = at_limits(away_m, limits_m)
    return plus(shift_m, rotated(R, plus(kept_m, away_m, -1.0)))


def at_limits(away: Vec3, limits: AxisLimits) -> list[bool]:
    """Return for each axis whether it is at the limit of its deviation."""
    pairs = zip(away, limits, strict=True)
    return [limit is not None and abs(each) > AT_LIMIT * limit for each, limit in pairs]


def room_m(pushed_m: Array, direction: Array, most_m: float) -> float:
    """Return the longest motion along a direction that stays, with another one, within most_m."""
    along_m = float(pushed_m @ direction)
    return max(0.0, sqrt(max(0.0, most_m**2 - float(pushed_m @ pushed_m) + along_m**2)) - along_m)
