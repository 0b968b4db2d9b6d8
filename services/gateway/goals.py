"""Goal tracking: state of a goal from the IDs and status bits of the controller's reports. Pure."""

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from common.motion.convert import pose_of
from common.motion.frames import apart
from common.motion.limits import joint_goal
from common.motion.unexplained import REACH, Reach
from common.robot.report import ArmReport
from controller.packet_table import Status
from forcemesh.messages import Goal, GoalState, Joints
from services.gateway.packet_window import NONE_YET

EXECUTION_WITHIN_NS = 2_000_000_000
# Debounce: the controller does not read ID and status of a report at one instant.
REPORTS_TO_CONFIRM = 2
STOPPED_SHORT_NS = 500_000_000  # time at rest away from the target


@dataclass(frozen=True, slots=True)
class ControllerReport(ArmReport):
    """Newest pose and joints reported by the controller."""

    status: Status
    counter: int
    taken: int  # number of the last packet executed by the robot program


@dataclass(frozen=True, slots=True)
class Track:
    """A goal from its packet to its end."""

    packet: int = NONE_YET  # its number
    T_target: pin.SE3 | None = None
    joint_target_rad: Joints | None = None
    sent_ns: int = 0
    reach: Reach = REACH  # within which it is done
    state: GoalState = "running"
    reason: str = ""  # of a refusal
    rest_ns: int | None = None  # since when the packet is executed and the arm at rest
    candidate: GoalState = "running"  # state by the last report
    counter: int = -1  # of the last report evaluated
    agreeing: int = 0  # consecutive reports with the same state


def sent(goal: Goal, packet: int, joint_rad: Joints, now_ns: int, *, reach: Reach = REACH) -> Track:
    """Return a goal whose packet was sent while the joints were at `joint_rad` [rad]."""
    track = Track(packet, sent_ns=now_ns, reach=reach)
    if goal.kind == "pose" and goal.pose is not None:
        return replace(track, T_target=pose_of(goal.pose))
    return replace(track, joint_target_rad=tuple(joint_goal(goal, joint_rad).tolist()))


def follow(track: Track, measured: ControllerReport, now_ns: int) -> Track:
    """Return the goal updated by the newest report."""
    if track.state != "running":
        return track
    if measured.taken < track.packet:
        if now_ns - track.sent_ns > EXECUTION_WITHIN_NS:
            reason = f"not taken by the controller within {EXECUTION_WITHIN_NS / 1e9:g} s"
            return replace(track, state="refused", reason=reason)
        return track
    if measured.counter == track.counter:
        return track
    candidate, reason, rest_ns = _verdict(track, measured, now_ns)
    agreeing = track.agreeing + 1 if candidate == track.candidate else 1
    track = replace(
        track, candidate=candidate, agreeing=agreeing, rest_ns=rest_ns, counter=measured.counter
    )
    if candidate == "running" or agreeing < REPORTS_TO_CONFIRM:
        return track
    return replace(track, state=candidate, reason=reason)


def _verdict(
    track: Track, measured: ControllerReport, now_ns: int
) -> tuple[GoalState, str, int | None]:
    """Return the state by one report, its reason, and since when the arm is at rest."""
    if measured.status & Status.MOVING:
        return "running", "", None
    rest_ns = now_ns if track.rest_ns is None else track.rest_ns
    if measured.status & Status.TARGET_REFUSED:
        return "refused", "the controller refused the target: range, reach or limits", rest_ns
    if measured.status & Status.HELD:
        return "refused", "the controller holds", rest_ns
    missing = _missing(track, measured)
    if not missing:
        return "done", "", rest_ns
    if now_ns - rest_ns > STOPPED_SHORT_NS:
        return "refused", f"the arm stopped {missing} away from the target", rest_ns
    return "running", "", rest_ns


def _missing(track: Track, measured: ControllerReport) -> str:
    """Return the distance to the target as a text, empty when it is reached."""
    if track.T_target is not None:
        distance_m, turn_rad = apart(measured.T_base_flange, track.T_target)
        if distance_m <= track.reach.position_m and turn_rad <= track.reach.rotation_rad:
            return ""
        return f"{distance_m * 1e3:.2f} mm and {np.degrees(turn_rad):.2f} degrees"
    rotations = np.array(measured.joint_rad) - np.array(
        track.joint_target_rad or measured.joint_rad
    )
    turn_rad = float(np.abs(rotations).max())
    return "" if turn_rad <= track.reach.rotation_rad else f"{np.degrees(turn_rad):.2f} degrees"
