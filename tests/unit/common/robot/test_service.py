"""Robot service with the smallest driver: what it asks of an arm, and when.

Limits, permission and stops are tested on every robot in tests/contract.
"""

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from common.config.load import load_cell
from common.motion.arm_check import ArmCheck
from common.motion.convert import record_of
from common.motion.kinematics import ArmKinematics
from common.robot.driver import NO_REPORT, NO_SIGNALS, RobotDriver
from common.robot.report import ArmReport
from common.robot.service import EARLY, RobotService
from forcemesh import topics
from forcemesh.clock import NS_PER_S, ManualClock
from forcemesh.errors import LocalProtocolError
from forcemesh.faults import tripped
from forcemesh.messages import Feedback, Gains, GoalState, RobotSignals, Trip
from tests.contract.rig import DEMO_CELL, Rig, goal, pose_goal, shifted

LAMP: dict[str, Any] = {"output": 1, "set_by": ["operator"], "while_held": True}
CELL = load_cell(DEMO_CELL, {"rates.robot_hz": 100, "signals": {"lamp": LAMP}})
REPORT_NS = 10_000_000
EARLY_NS = round(EARLY * REPORT_NS)
HOME_RAD = (0.0, 0.0, -np.pi / 2, 0.0, -np.pi / 2, 0.0)
HOME = ArmKinematics(CELL.robot.model).flange_pose(np.array(HOME_RAD))


class StillArm(RobotDriver):
    """Reports one pose, accepts everything and moves nothing."""

    measured: ArmReport | None = None

    def __init__(self) -> None:
        self.calls: list[Any] = []
        self.period_ns = REPORT_NS
        self.T = HOME
        self.begins = True
        self.moving = False
        self.state: tuple[GoalState, str] = ("running", "")
        self.refusal = ""
        self._new: list[ArmReport] = []
        self._due_ns = 0

    def receive(self, now_ns: int) -> None:
        """Report once a period."""
        if now_ns >= self._due_ns and self.period_ns:
            self._due_ns = now_ns + self.period_ns
            self.measured = ArmReport(self.T, HOME_RAD, self.moving, now_ns)
            self._new, self.link_fault = [self.measured], None

    def report(self) -> list[ArmReport]:
        """Return the new report."""
        new, self._new = self._new, []
        return new

    def stream(self, T_base_flange: pin.SE3, *, begins: bool) -> Trip | None:
        """Note the height above home."""
        self.calls.append(("stream", T_base_flange.translation[2] - HOME.translation[2], begins))
        return None

    def goal(self, goal, speed) -> str:
        """Note the goal; one of them does not fit."""
        if goal.id == 99:
            raise LocalProtocolError("it does not fit")
        self.calls.append(("goal", goal.id))
        return self.refusal

    def goal_state(self) -> tuple[GoalState, str]:
        """Return what the test has set."""
        return self.state

    def may_begin(self, kind: str) -> bool:
        """Return what the test has set."""
        return self.begins

    def hold(self, *, begins: bool) -> None:
        """Note the beginning."""
        if begins:
            self.calls.append("brake")


class Bench:
    """The service on a bus, with the arbiter's substitute."""

    def __init__(self, *, arms: bool = True) -> None:
        self.arm = StillArm()
        self.rig = Rig(CELL, ManualClock(), self._make, feedback_host="pc")
        if arms:
            self.rig.connect()
            self.rig.arm()
            self.arm.calls.clear()

    def _make(self, bus, cell) -> RobotService:
        self.service = RobotService(bus, cell, self.arm, ArmCheck(cell))
        return self.service

    def after(self, kind: str, **content: Any) -> list[Any]:
        """Return the calls of the driver within some periods of a command."""
        self.arm.calls.clear()
        self.rig.send(kind, **content)
        self.rig.advance(0.03)
        return self.arm.calls

    @property
    def goal(self) -> tuple[int, str, str]:
        """The published goal."""
        report = self.rig.state.goal
        return report.id, report.state, report.reason


def test_before_the_first_report_the_state_is_invalid_at_the_usual_rate() -> None:
    """An arm that has not reported cannot be armed; its pose is not guessed."""
    bench = Bench(arms=False)
    bench.arm.period_ns = 0
    bench.rig.send("idle")
    bench.rig.advance(0.2)
    state = bench.rig.states[-1]
    assert (state.valid, state.reason, state.code) == (False, NO_REPORT.text, NO_REPORT.code)
    assert state.hold_code == NO_REPORT.code
    assert bench.service.fault == NO_REPORT.text
    assert len(bench.rig.states) == pytest.approx(17, abs=1)  # at every third command
    assert bench.arm.calls == []


def test_an_arm_without_a_controller_of_its_own_is_ready_moving_or_held() -> None:
    """What a driver that says no more publishes: status, link, and that it has no signals."""
    bench = Bench()
    reader = bench.rig._bus(topics.CLIENT).reader(topics.ROBOT_SIGNALS)
    bench.arm.moving = True
    bench.rig.advance(0.03)
    state = bench.rig.state
    assert (state.status.ready, state.status.moving, state.status.held) == (True, True, False)
    assert (state.link.connected, state.link.round_trip_s) == (True, 0.0)
    bench.rig.send_hold()
    bench.rig.advance(1.1)
    assert bench.rig.state.status.held
    assert reader.poll()
    signals = reader.read(bench.rig.clock.now_ns()).message
    assert isinstance(signals, RobotSignals)
    assert (signals.valid, signals.code, signals.reason) == (
        False,
        NO_SIGNALS.code,
        NO_SIGNALS.text,
    )
    assert bench.arm.switch(1, True) == NO_SIGNALS


def test_a_stream_begins_at_the_measured_pose_and_again_after_a_hold() -> None:
    """Only then; each new set point passes once."""
    bench = Bench()
    target = record_of(shifted(HOME, z_m=0.002))
    first, *others = bench.after("setpoint", pose=target)
    assert first == ("stream", 0.0, True)
    assert others == [("stream", pytest.approx(0.002), False)] * len(others)
    assert 5 <= len(others) <= 9  # as many as commands
    assert bench.rig.state.sent == target
    bench.arm.calls.clear()
    bench.rig.silence()
    bench.rig.advance(0.03)
    assert (bench.arm.calls, bench.rig.state.hold_code) == ([], "")
    bench.rig.send_hold()
    bench.rig.advance(0.02)
    assert bench.rig.state.sent is None
    bench.rig.arm()
    assert bench.after("setpoint", pose=target)[0] == ("stream", 0.0, True)
    bench.after("idle")
    assert bench.after("setpoint", pose=target)[0] == ("stream", 0.0, True)


def test_a_number_used_again_for_another_purpose_is_another_lease() -> None:
    """The motion is braked, and the limits are those of the new one; found by the hostile suite."""
    bench = Bench()
    target = record_of(shifted(HOME, z_m=0.002))
    bench.after("setpoint", pose=target)
    permission = bench.rig.permission(purpose="back_off")
    assert "brake" in bench.after("setpoint", pose=target, permission=permission)
    assert (bench.rig.state.sent, bench.rig.state.hold_code) == (None, "state")
    assert "armed to back off" in bench.rig.state.hold_reason


def test_a_command_that_is_refused_at_once_leaves_the_hold_as_it_is() -> None:
    """The arm is not braked again: under a load it would creep with each such lease."""
    bench = Bench()
    bench.rig.send_hold()
    bench.rig.advance(0.03)
    bench.rig.push(force_N=(0.0, 0.0, 2.0 * CELL.limits.force_N))
    bench.rig.advance(0.03)
    rig = bench.rig
    rig.lease, rig.challenge = rig.lease + 1, rig.state.challenge
    assert bench.after("idle") == []
    assert "is above the ceiling" in rig.state.hold_reason


def test_nothing_begins_before_the_arm_may() -> None:
    """A goal is queued and then sent once; a stream waits, and withdraws a goal in its place."""
    bench = Bench()
    bench.arm.begins = False
    assert bench.after("goal", goal=pose_goal(1, HOME)) == []
    assert bench.goal == (1, "queued", "")
    bench.arm.begins = True
    bench.rig.advance(0.03)
    assert (bench.arm.calls, bench.goal) == ([("goal", 1)], (1, "running", ""))
    bench.arm.begins = False
    assert bench.after("setpoint", pose=record_of(HOME)) == ["brake"]
    assert bench.goal == (1, "refused", "the arbiter withdrew the goal")
    assert bench.rig.state.hold_code == ""


def test_a_goal_that_waits_is_withdrawn_without_a_brake() -> None:
    """It was never sent; one that was is braked, also for another goal, which is refused."""
    bench = Bench()
    bench.arm.begins = False
    bench.after("goal", goal=pose_goal(1, HOME))
    assert bench.after("idle") == []
    bench.arm.begins = True
    assert bench.after("goal", goal=pose_goal(2, HOME)) == [("goal", 2)]
    assert bench.after("goal", goal=pose_goal(3, HOME)) == ["brake"]
    assert bench.goal == (3, "refused", "another goal was in progress; it is braked")


def test_force_feedback_withdraws_a_goal_that_runs() -> None:
    """It is braked before the controller's loop gets the arm."""
    bench = Bench()
    bench.rig.feedback_host = "controller"
    bench.rig.push(force_N=(0.0, 0.0, 1.0))
    assert bench.after("goal", goal=pose_goal(1, HOME)) == [("goal", 1)]
    feedback = Feedback(mode="position", gains=Gains())
    assert bench.after("feedback", host="controller", feedback=feedback)[0] == "brake"
    assert bench.goal == (1, "refused", "the arbiter withdrew the goal")


def test_the_end_of_a_goal_is_the_drivers() -> None:
    """Done ends it; refused also brakes, once; a refusal at once starts nothing."""
    bench = Bench()
    bench.after("goal", goal=goal(1, "joints", joint_rad=HOME_RAD))
    bench.arm.state = ("done", "")
    assert bench.after("goal", goal=goal(1, "joints", joint_rad=HOME_RAD)) == []
    assert bench.goal == (1, "done", "")
    bench.arm.state = ("refused", "no path")
    assert bench.after("goal", goal=pose_goal(2, HOME)) == [("goal", 2), "brake"]
    assert bench.goal == (2, "refused", "no path")
    bench.arm.refusal = "out of reach"
    assert bench.after("goal", goal=pose_goal(3, HOME)) == [("goal", 3)]
    assert bench.goal == (3, "refused", "out of reach")
    assert bench.rig.state.hold_code == ""


def test_a_command_that_cannot_be_sent_ends_the_lease() -> None:
    """The driver's error is the reason; the refusal is counted once."""
    bench = Bench()
    assert bench.after("goal", goal=pose_goal(99, HOME)) == ["brake"]
    assert bench.service.counters()["refusals"] == 1
    assert "it does not fit" in bench.rig.state.hold_reason
    assert bench.goal == (0, "none", "")


def test_a_goal_that_is_sent_in_part_is_braked_although_the_arm_was_held() -> None:
    """Of a new lease, after a hold: what the driver has sent before its error may move the arm."""
    bench = Bench()
    bench.rig.send_hold()
    bench.rig.advance(0.03)
    bench.rig.lease, bench.rig.challenge = bench.rig.lease + 1, bench.rig.state.challenge
    assert bench.after("goal", goal=pose_goal(99, HOME)) == ["brake"]


def test_a_fault_of_the_arm_ends_the_lease_and_stands_before_its_end() -> None:
    """The cause is published as long as it lasts."""
    bench = Bench()
    bench.arm.arm_fault = tripped("robot_motors", "the motors are off")
    assert bench.after("idle") == ["brake"]
    assert bench.rig.state.hold_code == "robot_motors"
    assert bench.rig.state.hold_reason.startswith("the motors are off; lease 1 ended")
    bench.arm.arm_fault = None
    bench.rig.advance(0.03)
    assert bench.rig.state.hold_code == "robot_motors"  # of the ended lease
    assert bench.rig.state.hold_reason.startswith("lease 1 ended")


def test_a_new_lease_begins_from_a_hold() -> None:
    """Also without one between the two; the goal of the first is refused."""
    bench = Bench()
    bench.after("goal", goal=pose_goal(1, HOME))
    bench.arm.calls.clear()
    bench.rig.lease += 1
    bench.rig.send("idle")
    bench.rig.advance(0.03)
    assert bench.arm.calls == ["brake"]
    assert bench.goal == (1, "refused", "armed again")
    assert bench.rig.state.hold_code == ""


@pytest.mark.parametrize("is_lost", [False, True])
def test_an_arm_that_was_moved_is_a_fault_unless_it_was_not_seen(is_lost: bool) -> None:
    """It is braked once, and the finding lasts; after a lost link its pose is a new one."""
    bench = Bench()
    bench.after("idle")
    bench.rig.advance(1.5)
    bench.rig.send_hold()
    bench.rig.advance(0.1)
    if is_lost:
        bench.arm.period_ns, bench.arm.measured, bench.arm.link_fault = 0, None, NO_REPORT
        bench.rig.advance(0.1)
        bench.arm.period_ns = REPORT_NS
    bench.arm.calls.clear()
    bench.arm.T = shifted(HOME, z_m=0.02)
    bench.rig.advance(0.3)
    assert bench.rig.state.hold_code == ("hold" if is_lost else "unexplained_motion")
    assert bench.arm.calls == ([] if is_lost else ["brake"])


def test_an_arm_that_a_goal_moves_is_explained_however_long_it_waits() -> None:
    """It may stand at its start for longer than an arm that nothing moves may take to rest."""
    bench = Bench()
    bench.after("goal", goal=pose_goal(1, shifted(HOME, z_m=0.02)))
    bench.rig.advance(4.0)
    bench.arm.T = shifted(HOME, z_m=0.02)
    bench.rig.advance(0.3)
    assert (bench.rig.state.hold_code, bench.goal) == ("", (1, "running", ""))


def test_an_arm_beyond_a_limit_is_braked_by_the_report_that_shows_it() -> None:
    """Not a period later, with the first state that says so."""
    bench = Bench()
    bench.after("setpoint", pose=record_of(HOME))
    bench.arm.calls.clear()
    bench.arm.T = shifted(HOME, z_m=5.0)
    now_ns = bench.rig.clock.now_ns()
    while bench.service.verdict.command is not None:
        assert "brake" not in bench.arm.calls
        now_ns += 1_000_000
        bench.service.step(now_ns)
    assert bench.arm.calls[-1] == "brake"


def test_reports_above_the_rate_of_the_cell_are_not_published() -> None:
    """All are checked; one within three quarters of a period is left out."""
    bench = Bench()
    bench.arm.period_ns = 1
    begin_ns = bench.rig.clock.now_ns() + NS_PER_S
    published = []
    for at_ns in (0, EARLY_NS - 1, EARLY_NS, 2 * EARLY_NS - 1, REPORT_NS + EARLY_NS):
        bench.service.step(begin_ns + at_ns)
        published.append(bench.rig._reader.poll())
    assert published == [True, False, True, False, True]
