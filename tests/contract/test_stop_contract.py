"""Stops of every robot: causes, bounds, and the conditions for the next motion."""

from collections.abc import Callable

import numpy as np
import pytest

from common.motion.convert import record_of
from forcemesh.messages import Gains, PoseRecord, WrenchAtTcp
from tests.contract.rig import DEADLINE_S, Rig, distance_m, goal, pose_goal, shifted

SPEED_M_S = 0.1  # of the goals; set points and feedback are slower
STOP_TIME_S = 0.3  # at rest after a hold during full motion
REPORT_S = 0.05  # a report of every robot is younger
NAN = float("nan")


def to_a_pose(rig: Rig) -> None:
    """Move along a straight line."""
    rig.send("goal", goal=pose_goal(1, shifted(rig.T, x_m=0.1, z_m=0.1)))


def to_joints(rig: Rig) -> None:
    """Move to joint angles."""
    target = rig.joint_rad + np.array([0.4, -0.2, 0.2, 0.0, 0.0, 0.0])
    rig.send("goal", goal=goal(1, "joints", joint_rad=tuple(target.tolist())))


def by_joints(rig: Rig) -> None:
    """Move by joint angles."""
    rig.send("goal", goal=goal(1, "by", joint_rad=(0.4, -0.2, 0.2, 0.0, 0.0, 0.0)))


def by_feedback(rig: Rig) -> None:
    """Give way to a force: set points where force feedback is on the PC."""
    rig.push(force_N=(0.0, 0.0, 10.0))
    rig.feed_back("position", Gains(force_i_m_per_Ns=(0.004,) * 3))


MOTIONS: dict[str, Callable[[Rig], None]] = {
    "pose": to_a_pose,
    "joints": to_joints,
    "by": by_joints,
    "feedback": by_feedback,
}


def bring_into_motion(rig: Rig, motion: str) -> None:
    """Arm, and advance into the middle of a motion."""
    rig.arm()
    start = rig.T
    MOTIONS[motion](rig)
    rig.until(lambda: distance_m(rig.T, start) > 0.008)


def assert_stays(rig: Rig, duration_s: float = 0.4) -> None:
    """Assert that nothing moves in that time."""
    before = rig.T
    rig.advance(duration_s)
    assert distance_m(rig.T, before) < 2e-4


@pytest.mark.parametrize("motion", MOTIONS)
def test_a_hold_in_motion_stops_within_a_bound_and_the_arm_stays(rig: Rig, motion: str) -> None:
    """Bound in time and in travel; afterwards the same lease moves nothing, a newer one does."""
    bring_into_motion(rig, motion)
    rig.send_hold("enough")
    held = rig.T
    rig.advance(STOP_TIME_S)
    assert distance_m(rig.T, held) < SPEED_M_S * (STOP_TIME_S / 2 + REPORT_S)
    assert "enough" in rig.state.hold_reason
    if motion != "feedback":
        assert (rig.state.goal.state, "enough" in rig.state.goal.reason) == ("refused", True)
    assert_stays(rig)
    assert rig.state.status.held
    assert rig.feedback_bits == (False, False)
    to_a_pose(rig)
    assert_stays(rig)
    assert "lease" in rig.state.hold_reason
    rig.arm()
    assert_stays(rig, 0.2)
    rig.send("goal", goal=pose_goal(2, shifted(rig.T, z_m=0.005)))
    rig.until(lambda: rig.state.goal.id == 2 and rig.state.goal.state == "done")


@pytest.mark.parametrize("motion", ["pose", "feedback"])
def test_a_command_older_than_its_deadline_holds(rig: Rig, motion: str) -> None:
    """They arrive every period, but late: they are no longer executed."""
    bring_into_motion(rig, motion)
    rig.arbiter_clock.late_s = 1.2 * DEADLINE_S
    rig.until(lambda: rig.state.hold_reason, within_s=2 * DEADLINE_S)
    assert "old" in rig.state.hold_reason
    assert rig.is_at_rest()
    rig.arbiter_clock.late_s = 0.0
    assert_stays(rig)
    assert "lease" in rig.state.hold_reason


def test_a_command_with_a_number_that_is_not_finite_moves_nothing_and_holds(rig: Rig) -> None:
    """It is no command: after the deadline without another one the lease is dead."""
    rig.arm()
    start = rig.T
    good = record_of(start)
    bad = PoseRecord(position_m=(0.0, NAN, 0.3), orientation_xyzw=good.orientation_xyzw)
    rig.send("setpoint", pose=good)
    rig.advance(0.05)
    assert rig.command is not None
    rig.command = rig.command.replaced(pose=bad)
    rig.until(lambda: rig.state.hold_reason)
    assert_stays(rig)
    assert distance_m(rig.T, start) < 2e-4
    rig.send("setpoint", pose=record_of(shifted(start, z_m=0.005)))
    assert_stays(rig)
    assert "lease" in rig.state.hold_reason


# --- a goal that ends other than done -------------------------------------------------------------

ENDINGS: dict[str, Callable[[Rig], object]] = {
    "hold": lambda rig: rig.send_hold(),
    "silence": lambda rig: rig.silence(),
    "withdrawn": lambda rig: rig.send("idle"),
    "another goal": lambda rig: rig.send("goal", goal=pose_goal(2, shifted(rig.T, z_m=-0.05))),
    "armed again": lambda rig: rig.arm(),
    "too late": lambda rig: rig.until(lambda: rig.state.goal.state in {"done", "refused"}),
}


@pytest.mark.parametrize("ending", ENDINGS)
def test_a_goal_that_has_ended_moves_nothing_later(rig: Rig, ending: str) -> None:
    """Its packet waits in the controller, whose program runs again after the end."""
    rig.arm()
    rig.stall(True)
    start = rig.T
    rig.send("goal", goal=pose_goal(1, shifted(start, z_m=0.1)))
    rig.advance(0.05)
    ENDINGS[ending](rig)
    rig.advance(0.5)
    assert rig.state.goal.state in {"done", "refused", "none"} or rig.state.hold_reason
    assert distance_m(rig.T, start) < 0.05 or rig.state.goal.state == "done"
    rig.stall(False)
    assert_stays(rig, 1.0)
    rig.arm()
    rig.send("goal", goal=pose_goal(3, shifted(rig.T, z_m=0.005)))
    rig.until(lambda: rig.state.goal.id == 3 and rig.state.goal.state == "done")


@pytest.mark.parametrize("after_idle_s", [0.0, 0.02])
def test_no_motion_begins_before_the_arm_has_come_to_rest(rig: Rig, after_idle_s: float) -> None:
    """The next goal waits, or is refused with the reason, while the one before is braked."""
    bring_into_motion(rig, "pose")
    rig.send("idle")
    rig.advance(after_idle_s)
    rig.send("goal", goal=pose_goal(2, shifted(rig.T, z_m=-0.05)))
    rig.until(lambda: rig.state.goal.id == 2 and rig.state.goal.state in {"running", "refused"})
    has_rested = not all(state.status.moving for state in rig.states[-2:])
    assert rig.state.goal.reason or has_rested


@pytest.mark.parametrize("is_held", [False, True])
def test_an_arm_that_moves_without_a_command_is_a_fault(rig: Rig, is_held: bool) -> None:
    """Armed, and held: reported under its own code until the next lease, in which it is at rest."""
    rig.arm()
    rig.send("goal", goal=pose_goal(1, shifted(rig.T, z_m=0.01)))
    rig.until(lambda: rig.state.goal.state == "done")
    rig.send("idle")
    if is_held:
        rig.send_hold()
    rig.advance(1.5)
    assert rig.state.hold_code == ("hold" if is_held else "")
    rig.shove()
    rig.until(lambda: rig.state.hold_code == "unexplained_motion", within_s=0.5)
    rig.advance(0.2)
    assert rig.state.hold_code == "unexplained_motion"
    assert rig.is_at_rest()
    rig.arm()
    rig.advance(1.5)
    assert rig.state.hold_code == ""


# --- the wrench, where the robot reads it ---------------------------------------------------------


def end_wrench(rig: Rig) -> None:
    """End the wrench service."""
    rig.wrench = None


def invalid(rig: Rig) -> None:
    """Publish a wrench that is marked invalid."""
    rig.wrench = WrenchAtTcp(valid=False, reason="the sensor is unplugged")


def not_a_number(rig: Rig) -> None:
    """Publish a wrench that is not a number."""
    rig.wrench = WrenchAtTcp(force_N=(0.0, 0.0, NAN))


def too_much(rig: Rig) -> None:
    """Publish a force above the cell's ceiling."""
    rig.push(force_N=(0.0, 0.0, rig.cell.limits.force_N + 1.0))


@pytest.mark.parametrize(
    ("spoil", "expected_reason"),
    [
        (end_wrench, "stale"),
        (invalid, "unplugged"),
        (not_a_number, "unreadable"),
        (too_much, "ceiling"),
    ],
)
def test_feedback_ends_in_hold_with_a_bad_wrench_and_does_not_come_back(
    controller_rig: Rig, spoil: Callable[[Rig], None], expected_reason: str
) -> None:
    """The arm stops with a reason; a good wrench alone, or a new lease alone, starts nothing."""
    rig = controller_rig
    bring_into_motion(rig, "feedback")
    spoil(rig)
    rig.until(lambda: rig.state.hold_reason, within_s=0.5)
    assert expected_reason in rig.state.hold_reason
    rig.advance(STOP_TIME_S)
    rig.push(force_N=(0.0, 0.0, 10.0))
    assert_stays(rig)
    assert rig.feedback_bits == (False, False)
    assert rig.state.hold_reason
    rig.arm()
    assert_stays(rig)
    assert rig.feedback_bits == (False, False)
    start = rig.T
    by_feedback(rig)
    rig.until(lambda: distance_m(rig.T, start) > 0.001)
