"""The state of a goal by the reports: done, refused, or still running."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from common.motion.convert import record_of
from controller.packet_table import Status
from forcemesh.clock import NS_PER_S
from forcemesh.messages import Goal
from services.gateway import goals
from services.gateway.goals import ControllerReport, Track
from services.gateway.packet_window import NONE_YET

START = pin.SE3(np.eye(3), np.array([0.0, 0.5, 0.3]))
END = pin.SE3(np.eye(3), np.array([0.1, 0.5, 0.3]))
ZERO = (0.0,) * 6
GOAL = Goal(id=3, kind="pose", pose=record_of(END))
PACKET = 40
S = NS_PER_S


def report(T: pin.SE3, status: Status = Status.MOVING, taken: int = PACKET) -> ControllerReport:
    """Return a report with number 1."""
    moving = bool(status & Status.MOVING)
    return ControllerReport(T, (0.0,) * 6, moving, 0, status, counter=1, taken=taken)


def after(measured: ControllerReport, *, times: int = 2, period_ns: int = S // 100) -> Track:
    """Return the goal after some reports with the same content."""
    track = goals.sent(GOAL, PACKET, ZERO, 0)
    for number in range(times):
        now_ns = number * period_ns
        track = goals.follow(track, replace(measured, counter=number, at_ns=now_ns), now_ns)
    return track


@pytest.mark.parametrize("status", [Status(0), Status.TARGET_REFUSED, Status.HELD])
def test_one_report_decides_nothing(status: Status) -> None:
    """ID and status of a report are not of one instant."""
    assert after(report(END, status), times=1).state == "running"
    assert after(report(END, status), times=2).state != "running"


def test_a_joint_move_is_done_at_its_joints_whatever_else_it_says() -> None:
    """The kind decides which target counts."""
    move = Goal(id=3, kind="joints", pose=record_of(START), joint_rad=ZERO)
    track = goals.sent(move, PACKET, ZERO, 0)
    for number in range(2):
        track = goals.follow(track, replace(report(END, STILL), counter=number), number)
    assert track.state == "done"


STILL = Status(0)


@pytest.mark.parametrize(
    ("T", "status", "state"),
    [
        (START, Status.MOVING, "running"),
        (END, Status.MOVING, "running"),  # it may still move on
        (START, STILL, "running"),  # the bit may come later than the ID
        (END, STILL, "done"),
        (START, Status.TARGET_REFUSED, "refused"),
        (START, Status.HELD, "refused"),
        (START, Status.HELD | Status.MOVING, "running"),  # braking
    ],
)
def test_status_and_place_decide(T: pin.SE3, status: Status, state: str) -> None:
    """Two equal reports in a row decide."""
    assert after(report(T, status)).state == state


@pytest.mark.parametrize("status", [STILL, Status.TARGET_REFUSED, Status.HELD])
def test_one_report_alone_does_not_decide(status: Status) -> None:
    """ID and bits of one report may differ in time; the same report twice is one report."""
    assert after(report(END, status), times=1).state == "running"
    track = goals.sent(GOAL, PACKET, ZERO, 0)
    for now_ns in range(10):
        track = goals.follow(track, report(END, status), now_ns)
    assert track.state == "running"


def test_a_goal_that_is_not_taken_is_refused_after_a_while() -> None:
    """Being at the target before the packet was taken does not count; the limit is 2 s."""
    for taken in (NONE_YET, PACKET - 1):
        assert after(report(END, STILL, taken)).state == "running"
    late = after(report(END, STILL, NONE_YET), times=3, period_ns=int(1.1 * S))
    assert (late.state, "not taken" in late.reason) == ("refused", True)


def test_an_arm_that_stops_short_is_reported_with_the_distance() -> None:
    """The arm has been at rest for half a second, 100 mm away."""
    track = after(report(START, STILL), times=40, period_ns=S // 20)
    assert track.state == "refused"
    assert "100.00 mm" in track.reason


def test_an_end_is_final() -> None:
    """Later reports do not change a finished goal."""
    done = after(report(END, STILL))
    assert goals.follow(done, replace(report(START, Status.HELD), counter=9), S) == done


def test_relative_joints_start_from_the_angles_at_sending() -> None:
    """Command 3: target = joints at sending + rotation."""
    goal = Goal(id=1, kind="by", joint_rad=(0.1, 0.0, 0.0, 0.0, 0.0, 0.0))
    track = goals.sent(goal, PACKET, (1.0, 0.0, 0.0, 0.0, 0.0, 0.0), 0)
    assert track.joint_target_rad == pytest.approx((1.1, 0.0, 0.0, 0.0, 0.0, 0.0))
