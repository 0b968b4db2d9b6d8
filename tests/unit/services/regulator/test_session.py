"""The end of force feedback, which is latched, and the effect of a limited command."""

import numpy as np
import pinocchio as pin
import pytest

from common.motion.convert import record_of, vec3
from common.motion.frames import rotation_from_vector
from control.timing import TimingSettings
from forcemesh import topics
from forcemesh.messages import ArbiterStatus, RobotCommand, WrenchAtTcp
from forcemesh.requests import ForceStartRequest
from tests.fakes.arbiter_world import T_START
from tests.fakes.bench import CELL, cell_with
from tests.fakes.regulator_bench import (
    BOTH_HOSTS,
    KI,
    PERIOD_S,
    POSITION,
    T_FLANGE_TCP,
    RegulatorBench,
    assert_stopped,
)


@pytest.fixture
def bench() -> RegulatorBench:
    """Return a regulator that yields to 10 N and whose commands are applied."""
    bench = RegulatorBench()
    bench.push((0.0, 0.0, 10.0))
    bench.pass_s(0.1)
    assert bench.start().accepted
    bench.arbiter = ArbiterStatus(state="ACTIVE", commander="regulator", lease=3)
    bench.pass_s(0.2)
    assert bench.published().valid
    return bench


# --- inputs ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("topic", [topics.WRENCH, topics.ROBOT_STATE], ids=lambda t: t.key)
def test_a_stale_input_makes_the_target_not_valid_with_its_name(bench, topic) -> None:
    """The mode stays in the message: it runs and cannot continue, so the arbiter holds."""
    bench.silent = {topic.key}
    bench.pass_s(CELL.stale_after_s(topic) - PERIOD_S)
    assert bench.published().valid
    bench.step(3)
    target = bench.published()
    assert (target.valid, target.mode, target.pose) == (False, "position", None)
    assert f"{topic.key} stale" in target.reason
    assert bench.service.fault == target.reason


def test_a_failure_is_latched_until_the_next_start(bench: RegulatorBench) -> None:
    """The input returns, the target does not; code and reason are those of the sensor."""
    good = bench.wrench
    bench.wrench = WrenchAtTcp(valid=False, code="sensor_frozen", reason="the same 50 times")
    bench.step()
    bench.wrench = good
    for _ in range(20):
        target = bench.published()
        assert (target.valid, target.mode, target.code) == (False, "position", "sensor_frozen")
        assert target.reason == "wrench invalid: the same 50 times"
        bench.step()
    assert bench.start().accepted
    assert bench.published().code == ""
    assert bench.T_base_tcp().translation == (
        pytest.approx((T_START * T_FLANGE_TCP).translation, abs=1e-12)
    )


@pytest.mark.parametrize("topic", [topics.SENSOR_WRENCH, topics.WRENCH, topics.ROBOT_STATE])
def test_it_rests_while_an_input_is_late_and_after_a_gap(bench: RegulatorBench, topic) -> None:
    """What came in says nothing about the last commands: more of them would add up to a step."""
    before = bench.T_base_tcp().translation[2]
    bench.silent = {topic.key}
    bench.step(9)
    assert bench.published().valid
    rest = bench.T_base_tcp().translation[2]
    period_m = (10.0 - CELL.force.deadband_N) * KI * PERIOD_S * (1.0 + 1e-9)
    assert rest - before <= 3.0 * period_m
    bench.silent = set()
    bench.step()
    assert bench.T_base_tcp().translation[2] - rest <= period_m
    bench.step()
    assert bench.T_base_tcp().translation[2] > rest


@pytest.mark.parametrize("delay_s", [0.01, 0.04])
def test_a_law_that_predicts_rests_until_the_released_commands_have_arrived(delay_s: float) -> None:
    """Found: its model starts anew, so the travel in flight would be commanded twice."""
    cell = cell_with(robot__delay_s=delay_s)
    bench = RegulatorBench(cell)
    bench.push((0.0, 0.0, 10.0))
    bench.pass_s(0.1)
    assert bench.start(POSITION.replaced(law="adaptive")).accepted
    bench.pass_s(0.2)
    bench.silent = {topics.WRENCH.key}
    bench.step(6)
    bench.silent = set()
    bench.step()
    rest = bench.T_base_tcp().translation[2]
    bench.pass_s(delay_s)
    assert bench.T_base_tcp().translation[2] == rest
    bench.pass_s(TimingSettings.of(cell).window_s)
    assert bench.T_base_tcp().translation[2] > rest


@pytest.mark.parametrize(("control_hz", "rests"), [(250, True), (500, False)])
def test_a_sensor_slower_than_control_may_repeat_its_sample(control_hz, rests) -> None:
    """Its last sample is used until the next one; of a faster sensor a repetition is silence."""
    bench = RegulatorBench(cell_with(rates__control_hz=control_hz, rates__sensor_hz=250))
    bench.push((0.0, 0.0, 10.0))
    bench.pass_s(0.1)
    assert bench.start().accepted
    bench.step(5)
    before = bench.T_base_tcp().translation[2]
    bench.silent = {topics.SENSOR_WRENCH.key}
    bench.step(2)
    assert (bench.T_base_tcp().translation[2] == before) == rests


def test_it_continues_from_the_released_command_while_the_arbiter_is_late(bench) -> None:
    """Commands that the arbiter has not released do not add up."""
    bench.command = RobotCommand(kind="setpoint", pose=bench.published().pose)
    bench.step()
    released = bench.T_base_tcp().translation[2]
    bench.silent = {topics.ROBOT_COMMAND.key}
    bench.step(15)
    period_m = (10.0 - CELL.force.deadband_N) * KI * PERIOD_S
    assert abs(bench.T_base_tcp().translation[2] - released) <= period_m * (1.0 + 1e-9)
    bench.silent = set()
    bench.step(2)
    assert bench.T_base_tcp().translation[2] != released


# --- the arbiter ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("status", "reason"),
    [
        (ArbiterStatus(state="HOLDING", lease=3), "the arbiter is HOLDING"),
        (ArbiterStatus(state="FAULT", lease=3), "the arbiter is FAULT"),
        (ArbiterStatus(state="IDLE", lease=3), "the arbiter is IDLE"),
        (ArbiterStatus(state="BOOT"), "the arbiter is BOOT"),
        (ArbiterStatus(state="ARMED", lease=4), "armed again"),
        (ArbiterStatus(state="ACTIVE", commander="operator", lease=3), "the operator commands"),
        (
            ArbiterStatus(state="SETTLING", next_commander="program", lease=3),
            "the program commands",
        ),
        (ArbiterStatus(state="STOPPING", lease=3), "the arbiter is STOPPING"),
        (ArbiterStatus(valid=False, reason="no idea"), "arbiter/status invalid: no idea"),
        (ArbiterStatus(valid=False, reason="y" * 500), "arbiter/status invalid: yyy"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_it_ends_without_permission_and_never_resumes(bench, status, reason) -> None:
    """A hold, a new arming (also without a received hold) and a goal each require a new start."""
    bench.arbiter = status
    bench.step()
    assert_stopped(bench, reason)
    bench.arbiter = ArbiterStatus(state="ARMED", lease=status.lease)
    for _ in range(20):
        bench.step()
        assert_stopped(bench, reason)
    assert bench.service.fault == ""
    assert bench.start().accepted
    assert bench.published().valid


def test_a_silent_arbiter_ends_it(bench: RegulatorBench) -> None:
    """It ends within the deadline of the status; the reason names the arbiter."""
    bench.silent = {topics.ARBITER_STATUS.key}
    bench.pass_s(CELL.stale_after_s(topics.ARBITER_STATUS) + 2 * PERIOD_S)
    assert_stopped(bench, "arbiter/status stale")


# --- the applied command --------------------------------------------------------------------------


def test_it_continues_from_the_applied_command(bench: RegulatorBench) -> None:
    """Back-calculation: no integral builds up behind a limit."""
    applied = pin.SE3(
        rotation_from_vector(np.array([0.01, 0.0, 0.0])) @ T_START.rotation,
        T_START.translation + np.array([0.0, 0.0, 0.001]),
    )
    bench.command = RobotCommand(kind="setpoint", pose=record_of(applied), limited=True)
    one_step = (10.0 - CELL.force.deadband_N) * KI * PERIOD_S
    for _ in range(50):
        bench.step()
        T = bench.T_base_tcp()
        moved = T.translation - (applied * T_FLANGE_TCP).translation
        assert moved == pytest.approx([0.0, 0.0, one_step], abs=1e-9)
        assert pin.log3(T.rotation @ applied.rotation.T) == pytest.approx(np.zeros(3), abs=1e-9)


def test_an_unlimited_command_does_not_change_the_pose(bench: RegulatorBench) -> None:
    """An echo that is a period old must not remove a period's motion each time."""
    start = bench.T_base_tcp().translation[2]
    for _ in range(100):
        pose = bench.published().pose
        bench.command = RobotCommand(kind="setpoint", pose=pose)
        bench.step()
    expected = (10.0 - CELL.force.deadband_N) * KI * 100 * PERIOD_S
    assert bench.T_base_tcp().translation[2] - start == pytest.approx(expected, rel=1e-6)


# --- host controller ------------------------------------------------------------------------------


def test_for_the_host_controller_it_publishes_mode_set_point_and_gains() -> None:
    """The set point points along the tool as it turns: a force of the environment, base axes."""
    bench = RegulatorBench(BOTH_HOSTS)
    bench.pass_s(0.1)
    request = ForceStartRequest(mode="both", host="controller", setpoint_N=10.0)
    for turn in ((0.3, 0.2, 0.0), (0.0, 0.4, 0.0)):
        R = rotation_from_vector(np.array(turn)) @ T_START.rotation
        record = record_of(pin.SE3(R, T_START.translation))
        bench.robot = bench.robot.replaced(**record.as_dict())
        bench.step()
        if turn[0]:
            assert bench.start(request).accepted
            bench.pass_s(0.2)
        target = bench.published()
        assert (target.host, target.pose, target.valid) == ("controller", None, True)
        assert target.feedback is not None
        assert target.feedback.mode == "both"
        assert target.feedback.setpoint_force_N == pytest.approx(vec3(-10.0 * R[:, 2]), abs=1e-6)
        assert target.feedback.gains.force_i_m_per_Ns == (KI, KI, KI)


def test_the_host_controller_gets_the_point_of_contact_in_mode_both_only() -> None:
    """F x M / F^2 from the TCP, in the flange's axes, which stay with the tool while it turns."""
    bench = RegulatorBench(BOTH_HOSTS)
    bench.pass_s(0.1)
    bench.push((0.0, 0.0, 10.0), (0.2, 0.0, 0.0))
    bench.step()
    for mode, lever_m in (("both", (0.0, 0.02, 0.0)), ("position", (0.0, 0.0, 0.0))):
        request = ForceStartRequest.from_dict({"mode": mode, "host": "controller"})
        assert bench.start(request).accepted
        bench.pass_s(0.05)
        feedback = bench.published().feedback
        assert feedback is not None
        in_base = T_START.rotation @ np.array(feedback.lever_m)
        assert in_base == pytest.approx(lever_m, abs=1e-4)
