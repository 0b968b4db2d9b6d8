"""Every transition of mode, host and law: no command steps farther than one period allows."""

from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from common.motion.convert import pose_of
from forcemesh import topics
from forcemesh.messages import ArbiterStatus
from forcemesh.requests import Empty, ForceStartRequest, GainsRequest
from tests.fakes.bench import CELL
from tests.fakes.regulator_bench import PERIOD_S, T_FLANGE_TCP, FollowingBench

BOTH_HOSTS = CELL.model_copy(
    update={"robot": CELL.robot.model_copy(update={"hosts": ("pc", "controller")})}
)
MODES, HOSTS, LAWS = (
    ("position", "orientation", "both"),
    ("pc", "controller"),
    ("plain", "adaptive"),
)
STATES = tuple(product(MODES, HOSTS, LAWS))
MAX_STEP_M = CELL.force.speed_max_m_s * PERIOD_S * (1 + 1e-6)
MAX_STEP_RAD = CELL.force.speed_max_rad_s * PERIOD_S * (1 + 1e-6)

forces = st.tuples(*[st.floats(-30.0, 30.0)] * 2, st.floats(0.0, 40.0))
torques = st.tuples(*[st.floats(-1.0, 1.0)] * 3)
starts = st.builds(
    lambda state, setpoint_N, axes, frame: ("start", (*state, setpoint_N, axes, frame)),
    st.sampled_from(STATES),
    st.floats(0.0, 30.0),
    st.tuples(*[st.sampled_from([True, True, True, False])] * 6),
    st.sampled_from(["base", "tool"]),
)
gains = st.builds(lambda gain: ("gains", gain), st.floats(0.0, 5e-3))
events = st.lists(
    st.tuples(
        st.one_of(starts, gains, st.just(("stop", None))), forces, torques, st.integers(1, 8)
    ),
    min_size=2,
    max_size=10,
)


class TransitionBench(FollowingBench):
    """An arm that follows the regulator through requests."""

    def request(self, kind: str, content) -> None:
        """Send a request; a refused start is no transition."""
        if kind == "gains":
            self.ask(
                topics.GAINS, GainsRequest(force_i_m_per_Ns=(content,) * 3, accept_unstable=True)
            )
        elif kind == "stop":
            self.ask(topics.FORCE_STOP, Empty())
        else:
            mode, host, law, setpoint_N, axes, frame = content
            request = ForceStartRequest(
                mode=mode, host=host, law=law, setpoint_N=setpoint_N, axes=axes, frame=frame
            )
            self.start(request)


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(events)
def test_no_sequence_of_requests_and_forces_makes_a_step_of_the_command(history) -> None:
    """Starts in any mode, host, law, set point and mask, stops, gains, any wrench in between."""
    bench = TransitionBench(BOTH_HOSTS)
    for (kind, content), force_N, torque_Nm, periods in history:
        bench.push(force_N, torque_Nm)
        bench.request(kind, content)
        bench.step(periods)
    assert all(step <= MAX_STEP_M for step in bench.steps_m)
    assert all(step <= MAX_STEP_RAD for step in bench.steps_rad)


@pytest.mark.parametrize("first", STATES, ids="-".join)
def test_every_pair_of_modes_hosts_and_laws_changes_without_a_step(first) -> None:
    """The test sweeps all 12 x 12 pairs, pressed, during motion."""
    bench = TransitionBench(BOTH_HOSTS)
    for second in STATES:
        for state in (first, second):
            bench.push((1.0, -1.0, 20.0), (0.2, -0.1, 0.0))
            bench.request("start", (*state, 10.0, (True,) * 6, "base"))
            target = bench.published()
            assert (target.valid, target.mode, target.host) == (True, state[0], state[1])
            bench.step(5)
    assert len(bench.steps_m) > len(STATES) or first[1] == "controller"
    assert max(bench.steps_m, default=0.0) <= MAX_STEP_M
    assert max(bench.steps_rad, default=0.0) <= MAX_STEP_RAD


def test_the_identified_stiffness_is_kept_over_a_restart_in_the_same_contact() -> None:
    """After a restart the law keeps its estimate; elsewhere or after a lift it does not."""
    speeds = []
    for meanwhile in ("touches", "moved", "lifted"):
        bench = TransitionBench(BOTH_HOSTS)
        adaptive = ("start", ("position", "pc", "adaptive", 10.0, (True,) * 6, "base"))
        bench.push((0.0, 0.0, 3.0))
        bench.request(*adaptive)
        p = bench.poses[0].translation.copy()
        for _ in range(100):  # a spring of 3000 N/m
            bench.push((0.0, 0.0, 3.0 - 3e3 * float((bench.poses[-1].translation - p)[2])))
            bench.step(1)
        bench.request("stop", None)
        if meanwhile == "moved":
            x, y, z = bench.robot.position_m
            bench.robot = bench.robot.replaced(position_m=(x + 0.01, y, z))
            bench.poses.append(pose_of(bench.robot) * T_FLANGE_TCP)
        bench.push((0.0, 0.0, 0.2 if meanwhile == "lifted" else 10.0))
        bench.step(3)
        bench.push((0.0, 0.0, 4.0))
        bench.request("start", ("position", "pc", "adaptive", 0.0, (True,) * 6, "base"))
        bench.step(5)  # the acceleration is limited
        a, b = list(pairwise(bench.poses))[-1]
        speeds.append(float((b.translation - a.translation)[2]) / PERIOD_S)
    assert speeds[0] > 1.5 * speeds[1] > 0.0
    assert speeds[2] == pytest.approx(speeds[1], rel=0.05)


def test_the_controller_is_sent_gains_for_the_identified_contact() -> None:
    """Host controller: from the stiffest contact's gains up to a soft one's, not every period."""
    bench = TransitionBench(BOTH_HOSTS)
    bench.arbiter = ArbiterStatus(state="ARMED", lease=3)
    bench.push((0.0, 0.0, 30.0))
    bench.request("start", ("position", "controller", "adaptive", 0.0, (True,) * 6, "base"))
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
    masked = ForceStartRequest(
        mode="position", host="controller", axes=(True, False, True, True, True, True)
    )
    assert bench.start(masked).code == "host"


def test_a_controller_without_gain_gets_the_whole_set_point() -> None:
    """The approach speed of the host controller limits the set point; without gain it stands."""
    bench = FollowingBench(BOTH_HOSTS)
    assert bench.ask(topics.GAINS, GainsRequest(force_i_m_per_Ns=(0.0,) * 3)).accepted
    request = ForceStartRequest(mode="position", host="controller", setpoint_N=30.0)
    assert bench.start(request).accepted
    bench.step(500)
    feedback = bench.published().feedback
    assert feedback is not None
    assert np.linalg.norm(feedback.setpoint_force_N) == pytest.approx(30.0)


@pytest.mark.parametrize(("law", "continues"), [("adaptive", True), ("plain", False)])
def test_a_rising_surface_is_followed_by_the_adaptive_law(law, continues) -> None:
    """Contact from free space, then the surface rises: the plain law rejects its work."""
    bench = TransitionBench(BOTH_HOSTS)
    bench.request("start", ("position", "pc", law, 10.0, (True,) * 6, "base"))
    surface_m = float(bench.poses[0].translation[2]) - 0.0005
    for number in range(900):
        surface_m += 3e-3 * PERIOD_S if number > 600 else 0.0
        deep_m = max(0.0, surface_m - float(bench.poses[-1].translation[2]))
        bench.push((0.0, 0.0, 1e4 * deep_m))
        bench.step(1)
    assert bench.published().valid is continues
    assert bench.published().code == ("" if continues else "sensor_sign")
