"""Every transition of mode, host and law: no command steps farther than one period allows."""

from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from common.motion.convert import pose_of
from common.motion.frames import rotation_between
from forcemesh import topics
from forcemesh.messages import ArbiterStatus, RobotState
from forcemesh.requests import Empty, ForceStartRequest, GainsRequest
from tests.fakes.bench import CELL
from tests.fakes.regulator_bench import PERIOD_S, T_FLANGE_TCP, RegulatorBench

BOTH_HOSTS = CELL.model_copy(
    update={"robot": CELL.robot.model_copy(update={"hosts": ("pc", "controller")})}
)
MODES, HOSTS, LAWS = (
    ("position", "orientation", "both"),
    ("pc", "controller"),
    ("plain", "adaptive"),
)
STATES = tuple(product(MODES, HOSTS, LAWS))
MOST_M = CELL.force.speed_max_m_s * PERIOD_S * (1 + 1e-6)
MOST_RAD = CELL.force.speed_max_rad_s * PERIOD_S * (1 + 1e-6)

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


class Obedient(RegulatorBench):
    """A regulator whose arm is wherever it is told to be, and that notes every step."""

    def __init__(self) -> None:
        """Begin armed."""
        super().__init__(BOTH_HOSTS)
        self.robot: RobotState
        self.poses = [pose_of(self.robot) * T_FLANGE_TCP]
        self.steps_m: list[float] = []
        self.steps_rad: list[float] = []
        self.pass_s(0.1)

    def live(self, periods: int) -> None:
        """Let periods pass and obey."""
        for _ in range(periods):
            self.step()
            self.obey()

    def obey(self) -> None:
        """Go where the newest target says, and note how far that was."""
        said = self.said()
        if not said.valid or said.pose is None:
            return
        self.robot = self.robot.model_copy(update=said.pose.model_dump())
        self.poses.append(pose_of(said.pose) * T_FLANGE_TCP)
        before, after = self.poses[-2:]
        self.steps_m.append(float(np.linalg.norm(after.translation - before.translation)))
        turn = rotation_between(before.rotation, after.rotation)
        self.steps_rad.append(float(np.linalg.norm(turn)))

    def do(self, kind: str, what) -> None:
        """Ask for something; a start may be refused, which is no transition."""
        if kind == "gains":
            self.ask(topics.GAINS, GainsRequest(force_i_m_per_Ns=(what, what, what)))
        elif kind == "stop":
            self.ask(topics.FORCE_STOP, Empty())
        else:
            mode, host, law, setpoint_N, axes, frame = what
            wanted = ForceStartRequest(
                mode=mode, host=host, law=law, setpoint_N=setpoint_N, axes=axes, frame=frame
            )
            self.start(wanted)
        self.obey()


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(events)
def test_no_history_of_requests_and_forces_makes_a_command_jump(history) -> None:
    """Starts in any mode, host, law, set point and mask, stops, gains, any wrench in between."""
    bench = Obedient()
    for (kind, what), force_N, torque_Nm, periods in history:
        bench.push(force_N, torque_Nm)
        bench.do(kind, what)
        bench.live(periods)
    assert all(step <= MOST_M for step in bench.steps_m)
    assert all(step <= MOST_RAD for step in bench.steps_rad)


@pytest.mark.parametrize("first", STATES, ids="-".join)
def test_every_pair_of_modes_hosts_and_laws_goes_over_without_a_bump(first) -> None:
    """Swept: from each of the twelve to each of the twelve, pressed, while it moves."""
    bench = Obedient()
    for second in STATES:
        for state in (first, second):
            bench.push((1.0, -1.0, 20.0), (0.2, -0.1, 0.0))
            bench.do("start", (*state, 10.0, (True,) * 6, "base"))
            said = bench.said()
            assert (said.valid, said.mode, said.host) == (True, state[0], state[1])
            bench.live(5)
    assert len(bench.steps_m) > len(STATES) or first[1] == "controller"
    assert max(bench.steps_m, default=0.0) <= MOST_M
    assert max(bench.steps_rad, default=0.0) <= MOST_RAD


def test_what_was_met_holds_after_a_stop_and_a_start_as_long_as_it_touches_there() -> None:
    """Started again, the law goes on with what it knew; elsewhere or after a lift anew."""
    speeds = []
    for meanwhile in ("touches", "moved", "lifted"):
        bench = Obedient()
        adaptive = ("start", ("position", "pc", "adaptive", 10.0, (True,) * 6, "base"))
        bench.push((0.0, 0.0, 3.0))
        bench.do(*adaptive)
        p = bench.poses[0].translation.copy()
        for _ in range(100):  # a spring of 3000 N/m
            bench.push((0.0, 0.0, 3.0 - 3e3 * float((bench.poses[-1].translation - p)[2])))
            bench.live(1)
        bench.do("stop", None)
        if meanwhile == "moved":
            x, y, z = bench.robot.position_m
            bench.robot = bench.robot.model_copy(update={"position_m": (x + 0.01, y, z)})
            bench.poses.append(pose_of(bench.robot) * T_FLANGE_TCP)
        bench.push((0.0, 0.0, 0.2 if meanwhile == "lifted" else 10.0))
        bench.live(3)
        bench.push((0.0, 0.0, 4.0))
        bench.do("start", ("position", "pc", "adaptive", 0.0, (True,) * 6, "base"))
        bench.live(5)  # it speeds up no faster than the arm may
        a, b = list(pairwise(bench.poses))[-1]
        speeds.append(float((b.translation - a.translation)[2]) / PERIOD_S)
    assert speeds[0] > 1.5 * speeds[1] > 0.0
    assert speeds[2] == pytest.approx(speeds[1], rel=0.05)


def test_the_controller_is_sent_gains_for_what_is_touched() -> None:
    """Host controller: from the stiffest contact's gains up to a soft one's, not every period."""
    bench = Obedient()
    bench.arbiter = ArbiterStatus(state="ARMED", lease=3)
    bench.push((0.0, 0.0, 30.0))
    bench.do("start", ("position", "controller", "adaptive", 0.0, (True,) * 6, "base"))
    bench.live(1)
    sent = []
    x, y, z = bench.robot.position_m
    for number in range(80):
        force_N = 30.0 * np.exp(-number / 25.0)
        bench.robot = bench.robot.model_copy(
            update={"position_m": (x, y, z + (30.0 - force_N) / 4e3)}
        )
        bench.push((0.0, 0.0, force_N))
        bench.live(1)
        feedback = bench.said().feedback
        assert feedback is not None
        sent.append(feedback.gains.force_i_m_per_Ns[2])
    assert sent[-1] > 2.0 * sent[0]
    assert len(set(sent)) < 20
    masked = ForceStartRequest(
        mode="position", host="controller", axes=(True, False, True, True, True, True)
    )
    assert bench.start(masked).code == "host"


@pytest.mark.parametrize(("law", "goes_on"), [("adaptive", True), ("plain", False)])
def test_a_surface_that_carries_the_tool_is_followed_by_the_adaptive_law(law, goes_on) -> None:
    """Found from free space, pressed, then it rises: the plain law takes its work for a lie."""
    bench = Obedient()
    bench.do("start", ("position", "pc", law, 10.0, (True,) * 6, "base"))
    surface_m = float(bench.poses[0].translation[2]) - 0.0005
    for number in range(900):
        surface_m += 3e-3 * PERIOD_S if number > 600 else 0.0
        deep_m = max(0.0, surface_m - float(bench.poses[-1].translation[2]))
        bench.push((0.0, 0.0, 1e4 * deep_m))
        bench.live(1)
    assert bench.said().valid is goes_on
    assert bench.said().code == ("" if goes_on else "sensor_sign")
