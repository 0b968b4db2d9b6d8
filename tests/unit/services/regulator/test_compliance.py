"""Compliant axes beside force control: virtual masses, springs, limits and a reference."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from forcemesh.messages import ZERO3
from forcemesh.requests import HELD, ForceTask, TaskAxis
from services.regulator.axis_task import CELLS, NONE, AxisTask, VirtualMass
from services.regulator.compliance import (
    ComplianceSettings,
    ComplianceState,
    axis_states,
    comply,
)
from services.regulator.gains import PiGains
from services.regulator.law import LawInput, next_motion, start_at
from tests.fakes.arbiter_world import T_START
from tests.fakes.bench import CELL
from tests.fakes.regulator_bench import T_FLANGE_TCP
from tuning.gain_rule import tune

SETTINGS = ComplianceSettings.of(CELL)
PLAIN = SETTINGS.guiding.plain
GAINS = PiGains.of(tune(CELL).gains)
START = T_START * T_FLANGE_TCP
SPRING = VirtualMass(stiffness=1000.0)
TORSION = VirtualMass(stiffness=10.0)


def pushed(task: AxisTask, force_tool_N=ZERO3, torque_tool_Nm=ZERO3, periods=2000):
    """Return the state and the last motion under a constant load in tool axes."""
    state, motion = ComplianceState.at(task, START, START, SETTINGS), start_at(START)
    sample = LawInput(ZERO3, ZERO3, task, 0.004, GAINS, motion, START)
    for _ in range(periods):
        R = motion.T_base_tcp.rotation
        force_N, torque_Nm = tuple(R @ force_tool_N), tuple(R @ torque_tool_Nm)
        sample = LawInput(force_N, torque_Nm, task, 0.004, GAINS, motion, motion.T_base_tcp)
        motion = comply(state, sample, next_motion(sample, PLAIN), SETTINGS)
    return state, motion, sample


@settings(max_examples=15)
@given(st.floats(-30.0, 30.0))
def test_a_spring_rests_where_it_carries_the_force_beyond_the_deadband(force_N) -> None:
    """K x = F', with x from the reference; other axes do not move."""
    task = AxisTask(NONE, shifts=(SPRING, None, None))
    state, motion, sample = pushed(task, (force_N, 5.0, 5.0))
    away_m, away_rad = state.deviation(motion.T_base_tcp, sample)
    beyond_N = np.sign(force_N) * max(abs(force_N) - PLAIN.deadband_N, 0.0)
    assert away_m == pytest.approx((beyond_N / 1000.0, 0.0, 0.0), abs=1e-5)
    assert away_rad == pytest.approx(ZERO3, abs=1e-9)


@settings(max_examples=10)
@given(st.floats(-1.0, 1.0))
def test_a_torsion_spring_rests_where_it_carries_the_torque(torque_Nm) -> None:
    """About one axis; a torque within the deadband turns nothing."""
    task = AxisTask(NONE, swings=(None, TORSION, None))
    state, motion, sample = pushed(task, torque_tool_Nm=(0.3, torque_Nm, 0.3), periods=4000)
    _, away_rad = state.deviation(motion.T_base_tcp, sample)
    beyond_Nm = np.sign(torque_Nm) * max(abs(torque_Nm) - PLAIN.deadband_Nm, 0.0)
    assert away_rad == pytest.approx((0.0, beyond_Nm / 10.0, 0.0), abs=1e-3)


def test_a_free_axis_follows_the_hand_no_faster_than_its_limit() -> None:
    """A hand that keeps pushing moves it at the speed limit of that axis."""
    task = AxisTask(NONE, shifts=(VirtualMass(), None, None), speeds=((0.005, None, None), None))
    _, motion, _ = pushed(task, (30.0, 0.0, 0.0), periods=250)
    moved_m = START.rotation.T @ (motion.T_base_tcp.translation - START.translation)
    assert 0.003 < moved_m[0] <= 0.005 * 1.0 + 1e-9


def test_heavier_and_more_damped_axes_move_less() -> None:
    """A mass and a damping below those of hand guiding are raised to them."""
    travels = []
    light = VirtualMass(1e-3, 1e-3)
    for virtual in (light, VirtualMass(), VirtualMass(50.0), VirtualMass(None, 9e3)):
        task = AxisTask(NONE, shifts=(None, virtual, None))
        _, motion, _ = pushed(task, (0.0, 9.0, 0.0), periods=50)
        travels.append(np.linalg.norm(motion.T_base_tcp.translation - START.translation))
    assert travels[0] == travels[1] > travels[2] > 0.0
    assert travels[1] > travels[3] > 0.0


@settings(max_examples=25)
@given(st.tuples(*[st.floats(-40.0, 40.0)] * 3), st.tuples(*[st.floats(-2.0, 2.0)] * 3))
def test_no_axis_moves_beyond_its_deviation(force_N, torque_Nm) -> None:
    """Neither by force control nor by compliance, and its state says so at the limit."""
    limits = ((0.002, 0.001, None), (0.01, None, 0.02))
    task = AxisTask(
        (True, False, False),
        (False, False, True),
        shifts=(None, VirtualMass(), None),
        swings=(TORSION, None, None),
        deviations=limits,
    )
    state, motion, sample = pushed(task, force_N, torque_Nm, periods=400)
    away_m, away_rad = state.deviation(motion.T_base_tcp, sample)
    rows = zip((*away_m, *away_rad), (*limits[0], *limits[1]), state.at_limit, strict=True)
    for away, limit, at_limit in rows:
        assert limit is None or abs(away) <= limit + 1e-6
        assert not at_limit or (limit is not None and abs(away) > 0.99 * limit)
    if abs(torque_Nm[2]) > 1.0:
        assert state.at_limit[5]


@given(st.tuples(*[st.floats(-40.0, 40.0)] * 3))
def test_force_control_and_compliance_keep_the_speed_limit_together(force_N) -> None:
    """One period moves the tool by at most the limit of force feedback."""
    task = AxisTask((True, True, False), shifts=(None, None, VirtualMass()))
    _, motion, sample = pushed(task, force_N, periods=30)
    after = comply(
        ComplianceState.at(task, START, START, SETTINGS), sample, replace(motion), SETTINGS
    )
    moved_m = after.T_base_tcp.translation - sample.motion.T_base_tcp.translation
    assert np.linalg.norm(moved_m) <= PLAIN.speed_max_m_s * 0.004 + 1e-12


def test_a_frame_with_an_origin_swings_the_tool_about_it() -> None:
    """The torque is the one about the origin, whose place does not move."""
    origin_m = START.translation + np.array([0.05, 0.0, 0.0])
    axes = np.eye(3).tolist()
    task = AxisTask(
        NONE, swings=(None, None, TORSION), in_base=True, R_task=axes, origin_m=tuple(origin_m)
    )
    _, motion, _ = pushed(task, torque_tool_Nm=(0.0, 0.0, 1.0), periods=200)
    kept = START.actInv(origin_m)
    assert motion.T_base_tcp.act(kept) == pytest.approx(origin_m, abs=1e-4)
    assert np.linalg.norm(motion.T_base_tcp.translation - START.translation) > 1e-4


def test_the_reference_moves_with_a_path_and_stays_for_the_same_axes() -> None:
    """A changed set point keeps it; other compliant axes begin where they are."""
    task = AxisTask(NONE, shifts=(SPRING, None, None))
    state = ComplianceState.at(task, START, START, SETTINGS)
    state.move(((0.0, 0.01, 0.0), (0.0, 0.0, 0.0)))
    assert state.T_reference.translation - START.translation == pytest.approx([0.0, 0.01, 0.0])
    assert state.covers(replace(task, force_N=(0.0, 0.0, 5.0)))
    assert not state.covers(replace(task, shifts=(None, SPRING, None)))
    assert not state.covers(replace(task, deviations=((0.1, None, None), CELLS)))


def test_the_state_of_each_axis_is_of_the_tool_on_its_environment() -> None:
    """Exerted loads have the sign of set points."""
    axes = (TaskAxis(control="force", setpoint=5.0), HELD, HELD, HELD, HELD, HELD)
    task = AxisTask((True, False, False), force_N=(5.0, 0.0, 0.0))
    motion = start_at(START * pin.SE3(np.eye(3), np.array([0.001, 0.0, 0.0])))
    R = START.rotation
    sample = LawInput(
        tuple(R @ (-4.0, 1.0, 0.0)), tuple(R @ (0.0, 0.0, 0.5)), task, 0.004, GAINS, motion, START
    )
    state = ComplianceState.at(task, START, START, SETTINGS)
    x, y, *_, rz = axis_states(ForceTask(axes=axes), sample, state)
    assert (x.control, x.setpoint, x.at_limit) == ("force", 5.0, False)
    assert (x.exerted, y.exerted, rz.exerted) == pytest.approx((4.0, -1.0, -0.5))
    assert x.deviation == pytest.approx(0.001)
