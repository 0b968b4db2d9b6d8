"""Every transition of mode, host and law: no command steps farther than one period allows."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from forcemesh import topics
from forcemesh.messages import ArbiterStatus
from forcemesh.requests import Empty, ForceStartRequest, GainsRequest
from tests.fakes.bench import CELL, cell_with
from tests.fakes.regulator_bench import BOTH_HOSTS, PERIOD_S, FollowingBench

MAX_STEP_M = CELL.force.speed_max_m_s * PERIOD_S * (1 + 1e-6)
MAX_STEP_RAD = CELL.force.speed_max_rad_s * PERIOD_S * (1 + 1e-6)
ADAPTIVE = ForceStartRequest(law="adaptive")

forces = st.tuples(*[st.floats(-30.0, 30.0)] * 2, st.floats(0.0, 40.0))
torques = st.tuples(*[st.floats(-1.0, 1.0)] * 3)
starts = st.builds(
    ForceStartRequest,
    mode=st.sampled_from(["position", "orientation", "both"]),
    host=st.sampled_from(["pc", "controller"]),
    law=st.sampled_from(["plain", "adaptive", "admittance"]),
    setpoint_N=st.one_of(st.just(0.0), st.floats(0.0, 30.0)),
    axes=st.tuples(*[st.sampled_from([True, True, True, False])] * 6),
    frame=st.sampled_from(["base", "tool"]),
)
gains = st.floats(0.0, 5e-3).map(
    lambda gain: GainsRequest(force_i_m_per_Ns=(gain,) * 3, accept_unstable=True)
)
requests = st.one_of(starts, starts, gains, st.just(Empty()))
TOPICS = {
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
