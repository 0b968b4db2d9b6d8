"""Limits of the command of a period: speeds of tool, axes and contact; what goes back."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.motion.frames import Vector, rotation_between
from control.axis_task import ALL, CELLS, NONE, AxisTask, VirtualMass
from control.compliance import ComplianceState
from control.law import LawInput, back_calculate, start_at
from control.laws import LAWS, ControlSettings, advance
from forcemesh.messages import ZERO3
from tests.fakes.bench import CELL
from tests.fakes.law_input import DT_S, GAINS, START

SETTINGS = {name: ControlSettings.of(CELL, law) for name, law in LAWS.items()}
LIMITS = SETTINGS["plain"].limits
GUIDED = AxisTask(NONE, compliant_along=(VirtualMass(),) * 3)
HEAVY = (VirtualMass(mass=20.0), None, None)
EASE = 1.0 + 1e-6
each_law = pytest.mark.parametrize("law", LAWS)


class Tool:
    """A tool that is where it is commanded, under loads in its own axes."""

    def __init__(self, task: AxisTask, law: str = "plain") -> None:
        self.task, self._settings, self.gains = task, SETTINGS[law], GAINS
        self.motion, self.masses = start_at(START), ComplianceState.at(task, START, START)
        self._state = LAWS[law].begin(START, START, None, self._settings.of_law)
        self.sample = self._sample(ZERO3, ZERO3)

    def _sample(self, force_N: Vector, torque_Nm: Vector) -> LawInput:
        T = self.motion.T_base_tcp
        loads = tuple(T.rotation @ force_N), tuple(T.rotation @ torque_Nm)
        return LawInput(*loads, self.task, DT_S, self.gains, self.motion, T)

    def step(self, force_N: Vector = ZERO3, torque_Nm: Vector = ZERO3, periods: int = 1) -> None:
        """Command the next poses."""
        for _ in range(periods):
            self.sample = self._sample(force_N, torque_Nm)
            self._state, self.motion = advance(
                self._state, self.masses, self.sample, self._settings
            )

    @property
    def v(self) -> np.ndarray:
        """Speed of the TCP in the last period, tool axes [m/s]."""
        T = self.sample.motion.T_base_tcp
        return T.rotation.T @ (self.motion.T_base_tcp.translation - T.translation) / DT_S

    @property
    def w(self) -> np.ndarray:
        """Angular speed in it, tool axes [rad/s]."""
        R = self.sample.motion.T_base_tcp.rotation
        return R.T @ rotation_between(R, self.motion.T_base_tcp.rotation) / DT_S

    @property
    def away_m(self) -> float:
        """Deviation along the tool's x axis."""
        return self.masses.deviation(self.motion.T_base_tcp, self.sample)[0][0]


forces = st.tuples(*[st.floats(-60.0, 60.0)] * 3)
torques = st.tuples(*[st.floats(-3.0, 3.0)] * 3)
own_speeds = st.none() | st.tuples(*[st.none() | st.floats(0.001, 0.04)] * 3)
own_turns = st.none() | st.tuples(*[st.none() | st.floats(0.01, 0.4)] * 3)
axis_uses = st.tuples(*[st.sampled_from(["held", "force", "compliant"])] * 6)


@settings(max_examples=60, deadline=None)
@given(
    axis_uses, own_speeds, own_turns, st.sampled_from([*LAWS]),
    st.lists(st.tuples(forces, torques), min_size=5, max_size=25),
    st.none() | st.tuples(*[st.floats(-0.3, 0.3)] * 3), st.floats(0.0, 30.0),
)  # fmt: skip
def test_no_task_moves_faster_than_its_limits(uses, own, turns, law, loads, offset_m, press_N):
    """Tool, each of its axes, and each virtual mass, for any loads; held axes do not move."""
    mass = [VirtualMass() if use == "compliant" else None for use in uses]
    force = tuple(use == "force" for use in uses)
    origin_m = None if offset_m is None else tuple(START.translation + np.array(offset_m))
    task = AxisTask(
        force[:3], force[3:], force_N=(0.0, 0.0, press_N * force[2]), speeds=(own, turns),
        compliant_along=tuple(mass[:3]), compliant_about=tuple(mass[3:]), origin_m=origin_m,
    )  # fmt: skip
    tool = Tool(task, law)
    for force_N, torque_Nm in loads:
        tool.step(force_N, torque_Nm)
        assert np.linalg.norm(tool.v) <= LIMITS.speed_m_s * EASE
        assert np.linalg.norm(tool.w) <= LIMITS.speed_rad_s * EASE
        for k in range(3):
            most_m_s = LIMITS.speed_m_s if own is None or own[k] is None else own[k]
            assert abs(tool.masses.speed_m_s[k]) <= most_m_s * EASE
            if origin_m is None:
                assert abs(tool.v[k]) <= (0.0 if uses[k] == "held" else most_m_s) * EASE + 1e-9
            most_rad_s = LIMITS.speed_rad_s if turns is None or turns[k] is None else turns[k]
            assert abs(tool.w[k]) <= (0.0 if uses[3 + k] == "held" else most_rad_s) * EASE + 1e-9


@each_law
def test_a_turn_adds_no_speed_to_an_approach(law: str) -> None:
    """Found: a touch from the side while it approached drove the tool at six times its speed."""
    tool = Tool(AxisTask(ALL, ALL, (0.0, 0.0, 10.0)), law)
    tool.step(periods=400)
    approach_m_s = tool.v[2]
    assert approach_m_s == pytest.approx(CELL.plant.probe_m_s, rel=1e-6)
    for about_x_Nm in (-1.0, 1.0):
        tool.step((3.0, 0.0, 0.0), (about_x_Nm, 0.0, -0.3), periods=3)
        assert tool.motion.contact == "approach"
        assert 0.0 < tool.v[2] <= approach_m_s * EASE


def test_the_point_of_contact_keeps_the_speed_limit() -> None:
    """The compensation of a turn is not speed that force control may add to its own."""
    tool, r_m = Tool(AxisTask(ALL, ALL)), np.array([0.0, 0.1, 0.0])
    tool.gains = GAINS.replaced(force_i_m_per_Ns=(0.01,) * 3)
    tool.step((30.0, 0.0, 0.0), tuple(np.cross(r_m, [30.0, 0.0, 0.0])))
    assert np.linalg.norm(tool.w) > 0.1
    assert np.linalg.norm(tool.v + np.cross(tool.w, r_m)) <= LIMITS.speed_m_s * EASE


def test_a_turn_gives_a_virtual_mass_no_speed() -> None:
    """Found: what the limit of an axis cut of a compensation was the speed of its mass."""
    task = AxisTask(
        NONE, (False, False, True), compliant_along=(VirtualMass(mass=50.0), None, None),
        speeds=((0.005, None, None), None), deadbands=((5.0, None, None), CELLS),
    )  # fmt: skip
    tool = Tool(task)
    tool.step((3.0, 0.0, 0.0), (0.0, 0.0, -0.5), periods=100)
    assert tool.masses.speed_m_s == ZERO3  # 3 N are within its deadband
    before = tool.motion.T_base_tcp.translation.copy()
    tool.step(periods=100)
    assert tool.motion.T_base_tcp.translation == pytest.approx(before, abs=1e-9)


def test_a_reference_that_drags_the_tool_gives_its_mass_no_speed() -> None:
    """It stays at the limit of its deviation when the reference stands."""
    tool = Tool(AxisTask(NONE, compliant_along=HEAVY, deviations=((0.001, None, None), CELLS)))
    step_m = tuple(0.02 * DT_S * START.rotation[:, 0])
    for _ in range(100):
        tool.masses.move((step_m, ZERO3))
        tool.step()
    tool.step(periods=300)
    assert tool.away_m == pytest.approx(-0.001, abs=1e-6)


def test_a_virtual_mass_leaves_the_limit_of_its_deviation_at_once() -> None:
    """What the limit cuts of its speed is gone: it has nothing to brake first."""
    tool = Tool(AxisTask(NONE, compliant_along=HEAVY, deviations=((0.002, None, None), CELLS)))
    tool.step((30.0, 0.0, 0.0), periods=400)
    assert tool.masses.at_limit[0]
    tool.step((-30.0, 0.0, 0.0))
    assert tool.away_m < 0.002 - 1e-6
    assert not tool.masses.at_limit[0]


def test_a_turn_ends_at_the_limit_of_its_deviation() -> None:
    """In the period that would pass it: nothing is left of the turn, and nothing is beyond."""
    task = AxisTask(NONE, compliant_about=(VirtualMass(),) * 3, deviations=(CELLS, (1e-4,) * 3))
    tool = Tool(task)
    tool.step(torque_Nm=(2.0, 0.0, 0.0))
    _, away_rad = tool.masses.deviation(tool.motion.T_base_tcp, tool.sample)
    assert away_rad == pytest.approx((1e-4, 0.0, 0.0), abs=1e-9)


@each_law
def test_a_command_that_the_arbiter_limits_does_not_stop_a_hand(law: str) -> None:
    """The acceleration of force control is limited under a predicting law, not a hand's."""
    tool = Tool(GUIDED, law)
    tool.step((8.0, 0.0, 0.0), periods=100)
    before_m_s = tool.v[0]
    tool.motion = back_calculate(tool.motion, tool.motion.T_base_tcp)
    tool.step((8.0, 0.0, 0.0))
    assert tool.v[0] == pytest.approx(before_m_s, rel=1e-3)


def test_what_a_law_wanted_is_not_wanted_again() -> None:
    """A law that continues the motion it is given does not add to it."""
    tool = Tool(AxisTask(ALL, ALL))
    tool.step((8.0, 0.0, 0.0), (1.0, 0.0, 0.0), periods=10)
    assert (tool.motion.shift_m, tool.motion.turn_rad) == (ZERO3, ZERO3)
