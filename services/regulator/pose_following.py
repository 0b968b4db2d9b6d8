"""Motion of one period along a path of poses, added to that of force control. Pure.

The command is the reference on the curve plus an offset. Along the axes that force control or an
admittance moves, the offset is theirs: it turns with the task frame, so what was corrected on one
side of a workpiece is not left aside on the next. Along the others it is a deviation, which is
removed. The shape of the path is fed forward also along the force, except under a law with a
predictor: that one takes motion which is not its own for the surface's, and foresees it itself.
"""

from dataclasses import replace
from math import hypot

import numpy as np
import pinocchio as pin

from common.motion.convert import vec3
from common.motion.frames import dot, moved, plus, speeds_between
from forcemesh.messages import ZERO3
from services.regulator.axis_task import AxisTask, Flags, masked
from services.regulator.law import LawInput, LawMotion, limit_norm
from services.regulator.pose_path import PosePath, feed_share, is_missed
from services.regulator.tcp_path import room_m

BEHIND_M = 0.002  # deviation along a held axis at which the path waits for the tool
BEHIND_RAD = 0.02
SEARCH_M = 0.001  # below the height of the last contact, where a path goes on without contact


def path_start(T_base_tcp: pin.SE3, T_first: pin.SE3, task: AxisTask) -> pin.SE3:
    """Return the pose from which a path leads to its first pose without a step.

    It is the present command, without what it is away along the axes of force control: there the
    contact is somewhere else than the program assumes, and stays where it is.
    """
    R_base_task = task.R_base_task(T_first.rotation.tolist())
    away_m = vec3(T_base_tcp.translation - T_first.translation)
    aside_m = masked(away_m, _held(task)[0], R_base_task)
    return pin.SE3(T_base_tcp.rotation, T_first.translation + np.array(aside_m))


def follow_poses(
    path: PosePath, sample: LawInput, motion: LawMotion, *, predicts: bool, most_m: float
) -> tuple[PosePath, pin.SE3]:
    """Return the path and the command after one period.

    Args:
        path: The path so far.
        sample: Input of the law.
        motion: What the law has returned.
        predicts: Whether the law has a predictor.
        most_m: Longest motion of the period, of force control and path together.
    """
    T, task, before = motion.T_base_tcp, sample.task, path.T_reference
    touches = motion.contact == "contact"
    if path.in_contact and not touches:
        return replace(path, now_m_s=0.0), T
    height_m = dot(sample.press_axis, vec3(before.translation - T.translation))
    if touches:
        path = replace(path, height_m=height_m)
    elif path.height_m - height_m > SEARCH_M:  # a gap: it goes on over it, and does not dive in
        T = pin.SE3(T.rotation, sample.motion.T_base_tcp.translation)
    error_N = -dot(motion.error_force_N or ZERO3, sample.press_axis)
    pushed_m = T.translation - sample.motion.T_base_tcp.translation
    share = feed_share(error_N, task.press_N) if touches else 1.0
    share = 0.0 if _is_behind(before, sample) else share
    path = path.advanced(sample.dt_s, share=share, most_m=room_m(pushed_m, path.tangent, most_m))
    if not touches or is_missed(error_N, task.press_N):
        path = replace(path, missed_m=path.missed_m + path.now_m_s * sample.dt_s)
    after = path.T_reference
    shift_m, turn_rad = speeds_between(before, after, 1.0)
    T_fed = moved(T, (shift_m, turn_rad), 1.0)
    away_m, away_rad = speeds_between(after, T_fed, 1.0)
    R_base_task, (held, held_turns) = task.R_base_task(T_fed.rotation.tolist()), _held(task)
    if predicts:
        shift_m = masked(shift_m, held, R_base_task)
    shift_m = plus(shift_m, masked(away_m, held, R_base_task), -1.0)
    back_rad = masked(away_rad, held_turns, R_base_task)
    turn_rad = plus(turn_rad, limit_norm(back_rad, path.turn_rad_s * sample.dt_s), -1.0)
    return path, moved(T, (limit_norm(shift_m, most_m), turn_rad), 1.0)


def _is_behind(T_reference: pin.SE3, sample: LawInput) -> bool:
    """Return whether limits keep the tool from following: the path would run away from it."""
    held, held_turns = _held(sample.task)
    away_m, away_rad = speeds_between(T_reference, sample.motion.T_base_tcp, 1.0)
    behind_m = masked(away_m, held, sample.R_base_task)
    behind_rad = masked(away_rad, held_turns, sample.R_base_task)
    return hypot(*behind_m) > BEHIND_M or hypot(*behind_rad) > BEHIND_RAD


def _held(task: AxisTask) -> tuple[Flags, Flags]:
    """Return the axes along and about which neither force control nor an admittance moves."""
    x, y, z = [not a and b is None for a, b in zip(task.yields, task.shifts, strict=True)]
    rx, ry, rz = [not a and b is None for a, b in zip(task.turns, task.swings, strict=True)]
    return (x, y, z), (rx, ry, rz)
