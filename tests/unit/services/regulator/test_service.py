"""The regulator on the bus: start and stop by request, refusals with a reason, gains."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.motion.convert import pose_of
from control.gain_rule import tune
from control.law import LawSettings
from forcemesh import topics
from forcemesh.force_task import GUIDED, parse_task
from forcemesh.messages import ArbiterStatus
from forcemesh.requests import Empty, ForceStartRequest, GainsRequest
from tests.fakes.arbiter_world import T_START
from tests.fakes.bench import CELL, cell_with
from tests.fakes.regulator_bench import (
    BOTH_HOSTS,
    KI,
    PERIOD_S,
    T_FLANGE_TCP,
    FollowingBench,
    RegulatorBench,
    assert_stopped,
)


@pytest.fixture
def bench() -> RegulatorBench:
    """Return a regulator that has not been started."""
    bench = RegulatorBench()
    bench.pass_s(0.1)
    return bench


def test_it_publishes_every_period_while_it_is_stopped(bench: RegulatorBench) -> None:
    """The target is not valid and stopped, with the sample it is based on; silence means death.

    Each wrench triggers a step: the loop does not wait for a period.
    """
    assert bench.service.trigger is not None
    assert bench.service.trigger.topic is topics.WRENCH
    for _ in range(10):
        bench.step()
        reading = bench.out.read(bench.clock.now_ns())
        assert (reading.age_s, reading.origin) == (0.0, bench.origin)
        assert_stopped(bench, "stopped")


def test_stop_ends_it_and_a_new_start_begins_at_the_arm(bench: RegulatorBench) -> None:
    """The last proposal is dropped."""
    bench.push((0.0, 0.0, 20.0))
    bench.start()
    bench.pass_s(0.5)
    assert bench.ask(topics.FORCE_STOP, Empty()).accepted
    bench.step()
    assert_stopped(bench, "stopped")
    assert bench.start().accepted
    start = (T_START * T_FLANGE_TCP).translation
    assert bench.T_base_tcp().translation == pytest.approx(start, abs=1e-12)


def test_another_mode_or_set_point_continues_without_a_step(bench: RegulatorBench) -> None:
    """While it runs the pose continues from where it was, the set point on a ramp."""
    bench.push((0.0, 0.0, 5.0))
    bench.start()
    bench.pass_s(0.5)
    before = bench.T_base_tcp().translation
    errors = [bench.published().error_force_N[2]]
    assert bench.start(ForceStartRequest(mode="both", setpoint_N=20.0)).accepted
    assert np.linalg.norm(bench.T_base_tcp().translation - before) < 1e-4
    ramp_s = 20.0 / CELL.force.setpoint_ramp_N_s
    errors.append(bench.published().error_force_N[2])
    for _ in range(round(ramp_s / PERIOD_S) + 5):
        bench.step()
        errors.append(bench.published().error_force_N[2])
    assert max(np.abs(np.diff(errors))) <= CELL.force.setpoint_ramp_N_s * PERIOD_S + 1e-9
    assert errors[-1] == pytest.approx(5.0 - 20.0 + CELL.force.deadband_N)


@pytest.mark.parametrize(
    ("measured_N", "setpoint_N", "begins_N"),
    [(15.0, 25.0, 15.0), (15.0, 10.0, 10.0), (15.0, 0.0, 0.0), (0.0, 20.0, 0.0), (-3.0, 20.0, 0.0)],
    ids=["more", "less", "release", "from the air", "pulled"],
)
def test_the_set_point_ramp_begins_at_the_measured_force(
    bench: RegulatorBench, measured_N: float, setpoint_N: float, begins_N: float
) -> None:
    """An arm that presses does not release first, and a release does not wait for a ramp."""
    bench.push((0.0, 0.0, measured_N))
    bench.start(ForceStartRequest(mode="position", setpoint_N=setpoint_N))
    bench.step()
    band_N, step_N = CELL.force.deadband_N, CELL.force.setpoint_ramp_N_s * PERIOD_S
    ramp_error_N = measured_N - min(begins_N + step_N, setpoint_N)
    error_N = np.sign(ramp_error_N) * max(abs(ramp_error_N) - band_N, 0.0)
    assert bench.published().error_force_N[2] == pytest.approx(error_N, abs=step_N)


@pytest.mark.parametrize("stiffer", [0.0, 0.3, 1.0, 3.0])
def test_the_controller_approaches_no_faster_than_the_law_on_the_pc(stiffer: float) -> None:
    """Its speed is gain times set point: until the touch the sent set point is lower.

    Without gain it stands, whatever the set point.
    """
    bench = RegulatorBench(BOTH_HOSTS)
    bench.pass_s(0.1)
    gain = stiffer * KI
    assert bench.ask(topics.GAINS, GainsRequest(force_i_m_per_Ns=(gain,) * 3)).accepted
    request = ForceStartRequest(mode="position", host="controller", setpoint_N=30.0)
    assert bench.start(request).accepted
    bench.pass_s(1.0)
    limit_N = LawSettings.of(CELL).approach_m_s / gain if gain else 30.0
    assert sent_setpoint_N(bench) == pytest.approx(min(limit_N, 30.0), rel=1e-3)
    bench.push((0.0, 0.0, 5.0))
    before_N = sent_setpoint_N(bench)
    for _ in range(60):
        bench.step()
        assert (
            -1e-9
            <= sent_setpoint_N(bench) - before_N
            <= CELL.force.setpoint_ramp_N_s * PERIOD_S + 1e-9
        )
        before_N = sent_setpoint_N(bench)
    assert before_N == pytest.approx(30.0)


def sent_setpoint_N(bench: RegulatorBench) -> float:
    """Return the set point that is sent to the controller."""
    feedback = bench.published().feedback
    assert feedback is not None
    return float(np.linalg.norm(feedback.setpoint_force_N))


def test_gains_are_set_by_request_and_the_rest_keeps_its_value(bench: RegulatorBench) -> None:
    """One kind of gain changes, on a ramp and without a step; the reply lists all."""
    bench.push((0.0, 0.0, 5.0 + CELL.force.deadband_N), (0.5, 0.0, 0.0))
    bench.start(ForceStartRequest(mode="orientation"))
    reply = bench.ask(topics.GAINS, GainsRequest(force_i_m_per_Ns=(0.0, 0.0, 2.0 * KI)))
    assert reply.accepted
    assert reply.gains is not None
    assert reply.gains.force_i_m_per_Ns == (0.0, 0.0, 2.0 * KI)
    assert reply.gains.torque_i_rad_per_Nms == tune(CELL).gains.torque_i_rad_per_Nms
    assert reply.gains.force_p_m_per_N == (0.0, 0.0, 0.0)
    assert not reply.text
    with_preset = GainsRequest(preset="stiff", force_i_m_per_Ns=(0.0, 0.0, 2.0 * KI))
    reply = bench.ask(topics.GAINS, with_preset)  # single gains take precedence
    assert reply.gains == tune(CELL, "stiff").gains.replaced(force_i_m_per_Ns=(0.0, 0.0, 2.0 * KI))
    bench.start()
    bench.pass_s(1.0)
    before = bench.T_base_tcp().translation[2]
    bench.pass_s(0.5)
    assert bench.T_base_tcp().translation[2] - before == pytest.approx(5.0 * KI, rel=0.02)


# --- transitions --------------------------------------------------------------------------------

MAX_STEP_M = CELL.force.speed_max_m_s * PERIOD_S * (1 + 1e-6)
MAX_STEP_RAD = CELL.force.speed_max_rad_s * PERIOD_S * (1 + 1e-6)
ADAPTIVE = ForceStartRequest(law="adaptive")

forces = st.tuples(*[st.floats(-30.0, 30.0)] * 2, st.floats(0.0, 40.0))
torques = st.tuples(*[st.floats(-1.0, 1.0)] * 3)
modes = st.builds(
    ForceStartRequest,
    mode=st.sampled_from(["position", "orientation", "both"]),
    host=st.sampled_from(["pc", "controller"]),
    law=st.sampled_from(["plain", "adaptive"]),
    setpoint_N=st.one_of(st.just(0.0), st.floats(0.0, 30.0)),
    axes=st.tuples(*[st.sampled_from([True, True, True, False])] * 6),
    frame=st.sampled_from(["base", "tool"]),
)
guided = [ForceStartRequest(task=parse_task(text)) for text in GUIDED.values()]
starts = st.one_of(modes, st.sampled_from(guided))
gains = st.floats(0.0, 5e-3).map(
    lambda gain: GainsRequest(force_i_m_per_Ns=(gain,) * 3, accept_unstable=True)
)
requests = st.one_of(starts, starts, gains, st.just(Empty()))
TOPICS: dict[type, topics.Request[Any]] = {
    ForceStartRequest: topics.FORCE_START,
    GainsRequest: topics.GAINS,
    Empty: topics.FORCE_STOP,
}


@settings(max_examples=100, deadline=None)
@given(st.lists(st.tuples(requests, forces, torques, st.integers(1, 8)), min_size=2, max_size=10))
def test_no_sequence_of_requests_and_forces_makes_a_step_of_the_command(history) -> None:
    """Starts in any mode, host, law, set point and mask, stops, gains, any wrench in between.

    A refused start is no transition.
    """
    bench = FollowingBench(BOTH_HOSTS)
    for request, force_N, torque_Nm, periods in history:
        bench.push(force_N, torque_Nm)
        bench.ask(TOPICS[type(request)], request)
        bench.step(periods)
    assert all(step <= MAX_STEP_M for step in bench.steps_m)
    assert all(step <= MAX_STEP_RAD for step in bench.steps_rad)


def test_the_identified_stiffness_is_kept_over_a_restart_in_the_same_contact() -> None:
    """After a restart the law keeps its estimate; elsewhere or after a lift it does not."""
    speeds = []
    for meanwhile in ("touches", "moved", "lifted"):
        bench = FollowingBench(BOTH_HOSTS)
        bench.push((0.0, 0.0, 3.0))
        assert bench.start(ADAPTIVE.replaced(setpoint_N=10.0)).accepted
        p = bench.poses[0].translation.copy()
        for _ in range(100):  # a spring of 3000 N/m
            bench.push((0.0, 0.0, 3.0 - 3e3 * float((bench.poses[-1].translation - p)[2])))
            bench.step(1)
        bench.ask(topics.FORCE_STOP, Empty())
        if meanwhile == "moved":
            x, y, z = bench.robot.position_m
            bench.robot = bench.robot.replaced(position_m=(x + 0.01, y, z))
            bench.poses.append(pose_of(bench.robot) * T_FLANGE_TCP)
        bench.push((0.0, 0.0, 0.2 if meanwhile == "lifted" else 10.0))
        bench.step(3)
        bench.push((0.0, 0.0, 4.0))
        assert bench.start(ADAPTIVE).accepted
        bench.step(5)  # the acceleration is limited
        a, b = bench.poses[-2:]
        speeds.append(float((b.translation - a.translation)[2]) / PERIOD_S)
    assert speeds[0] > 1.5 * speeds[1] > 0.0
    assert speeds[2] == pytest.approx(speeds[1], rel=0.05)


def test_the_controller_is_sent_gains_for_the_identified_contact() -> None:
    """Host controller: from the stiffest contact's gains up to a soft one's, not every period."""
    bench = FollowingBench(BOTH_HOSTS)
    bench.arbiter = ArbiterStatus(state="ARMED", lease=3)
    bench.push((0.0, 0.0, 30.0))
    assert bench.start(ADAPTIVE.replaced(host="controller")).accepted
    bench.step(1)
    sent = []
    x, y, z = bench.robot.position_m
    for number in range(80):
        force_N = 30.0 * np.exp(-number / 25.0)
        bench.robot = bench.robot.replaced(position_m=(x, y, z + (30.0 - force_N) / 4000.0))
        bench.push((0.0, 0.0, force_N))
        bench.step(1)
        feedback = bench.published().feedback
        assert feedback is not None
        sent.append(feedback.gains.force_i_m_per_Ns[2])
    assert sent[-1] > 2.0 * sent[0]
    assert len(set(sent)) < 20


@pytest.mark.parametrize(
    ("law", "tracks", "continues"),
    [("adaptive", True, True), ("adaptive", False, False), ("plain", True, False)],
)
def test_a_rising_surface_is_followed_by_the_adaptive_law(law, tracks, continues) -> None:
    """Contact from free space, then the surface rises: without tracking its work is rejected."""
    bench = FollowingBench(cell_with(force__surface_tracking=tracks))
    assert bench.start(ADAPTIVE.replaced(law=law, setpoint_N=10.0)).accepted
    surface_m = float(bench.poses[0].translation[2]) - 0.0005
    for number in range(900):
        surface_m += 3e-3 * PERIOD_S if number > 600 else 0.0
        deep_m = max(0.0, surface_m - float(bench.poses[-1].translation[2]))
        bench.push((0.0, 0.0, 1e4 * deep_m))
        bench.step(1)
    assert bench.published().valid is continues
    assert bench.published().code == ("" if continues else "sensor_sign")
