"""Task frame and axes of one period: what is held does not move, limits and a centre of rotation.

Set points, springs and held axes of whole tasks: tests/scenario/test_force_axes.py.
"""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.motion.frames import cross, plus, rotated, rotation_from_vector
from forcemesh.messages import ZERO3
from services.regulator.axis_task import ALL, CELLS, NONE, AxisTask, VirtualMass, mode_task
from services.regulator.compliance import ComplianceSettings, ComplianceState, comply
from services.regulator.law import LawInput, LawSettings, next_motion, start_at
from tests.fakes.bench import CELL
from tests.fakes.law_input import DT_S, GAINS, START

LAW, SETTINGS = LawSettings.of(CELL), ComplianceSettings.of(CELL)
PLAIN = SETTINGS.guiding.plain
TORSION = VirtualMass(stiffness=10.0)
vectors = st.tuples(*[st.floats(-30.0, 30.0)] * 3)
turns = st.tuples(*[st.floats(-2.0, 2.0)] * 3)
flags = st.tuples(*[st.booleans()] * 3)


def rows_of(turn):
    """Return a rotation matrix by rows."""
    return rotation_from_vector(np.array(turn)).tolist()


def sample_of(task, force_N=ZERO3, torque_Nm=ZERO3, contact="contact"):
    """Return one sample of a tool that is already in contact."""
    motion = replace(start_at(START), contact=contact)
    return LawInput(force_N, torque_Nm, task, DT_S, GAINS, motion, START)


def pushed(task: AxisTask, force_tool_N=ZERO3, torque_tool_Nm=ZERO3, periods=400):
    """Return the state and the last motion under a constant load in tool axes."""
    state, motion = ComplianceState.at(task, START, START, SETTINGS), start_at(START)
    sample = sample_of(task)
    for _ in range(periods):
        R = motion.T_base_tcp.rotation
        force_N, torque_Nm = tuple(R @ force_tool_N), tuple(R @ torque_tool_Nm)
        sample = LawInput(force_N, torque_Nm, task, DT_S, GAINS, motion, motion.T_base_tcp)
        motion = comply(state, sample, next_motion(sample, PLAIN), SETTINGS)
    return state, motion, sample


@given(turns, flags, flags, vectors, vectors, vectors, st.sampled_from(["free", "contact"]))
def test_held_axes_of_any_frame_do_not_move(
    turn, yields, may_turn, force_N, torque_Nm, push_N, contact
):
    """Along and about them, for any force, torque and set point, in approach, contact and loss."""
    R = rows_of(turn)
    task = AxisTask(
        yields, may_turn, tuple(np.array(push_N) * yields), ZERO3, R_task=R, in_base=True
    )
    after = next_motion(sample_of(task, force_N, torque_Nm, contact), LAW)
    moved_m = np.array(R).T @ (after.T_base_tcp.translation - START.translation)
    assert np.abs(moved_m[~np.array(yields)]).max(initial=0.0) < 1e-12


@given(turns, st.floats(0.0, 1.0))
def test_the_law_uses_deadbands_of_single_axes(turn, band) -> None:
    """Along and about axes of any frame; the errors are published beyond them."""
    R = rows_of(turn)
    bands = ((band, band, band), (band, band, band))
    task = AxisTask(ALL, ALL, ZERO3, R_task=R, in_base=True, deadbands=bands)
    load = tuple(rotated(R, (3.0, 0.0, 0.0)))
    after = next_motion(sample_of(task, load, load), LAW)
    for error in (after.error_force_N, after.error_torque_Nm):
        assert np.array(R).T @ error == pytest.approx([3.0 - band, 0.0, 0.0], abs=1e-9)


@given(vectors, vectors)
def test_a_frame_with_an_origin_turns_the_tool_about_it(force_N, offset_mm) -> None:
    """The torque is the one about the origin, and the TCP moves on an arc."""
    offset_m = tuple(1e-3 * np.array(offset_mm))
    origin_m = tuple(START.translation - offset_m)
    task = AxisTask(NONE, ALL, in_base=True, R_task=rows_of(ZERO3), origin_m=origin_m)
    sample = sample_of(task, force_N, (0.5, -0.3, 0.2))
    after = next_motion(sample, LAW)
    torque_Nm = plus((0.5, -0.3, 0.2), cross(offset_m, force_N))
    assert sample.task_torque_Nm() == pytest.approx(torque_Nm, abs=1e-9)
    turn = after.T_base_tcp.rotation @ START.rotation.T
    moved_m = after.T_base_tcp.translation - START.translation
    assert moved_m == pytest.approx(turn @ offset_m - offset_m, abs=1e-6)


def test_a_free_axis_follows_the_hand_no_faster_than_its_limit() -> None:
    """A hand that keeps pushing moves it at the speed limit of that axis."""
    task = AxisTask(NONE, shifts=(VirtualMass(), None, None), speeds=((0.005, None, None), None))
    _, motion, _ = pushed(task, (30.0, 0.0, 0.0), periods=250)
    moved_m = START.rotation.T @ (motion.T_base_tcp.translation - START.translation)
    assert 0.003 < moved_m[0] <= 0.005 * 1.0 + 1e-9


@settings(max_examples=25)
@given(st.tuples(*[st.floats(-40.0, 40.0)] * 3), st.tuples(*[st.floats(-2.0, 2.0)] * 3))
def test_no_axis_moves_beyond_its_deviation_or_faster_than_the_cell_permits(
    force_N, torque_Nm
) -> None:
    """Neither by force control nor by compliance, and its state says so at the limit."""
    limits = ((0.002, 0.001, None), (0.01, None, 0.02))
    task = AxisTask(
        (True, False, False),
        (False, False, True),
        shifts=(None, VirtualMass(), VirtualMass()),
        swings=(TORSION, None, None),
        deviations=limits,
    )
    state, motion, sample = pushed(task, force_N, torque_Nm)
    away_m, away_rad = state.deviation(motion.T_base_tcp, sample)
    rows = zip((*away_m, *away_rad), (*limits[0], *limits[1]), state.at_limit, strict=True)
    for away, limit, at_limit in rows:
        assert limit is None or abs(away) <= limit + 1e-6
        assert not at_limit or (limit is not None and abs(away) > 0.99 * limit)
    if abs(torque_Nm[2]) > 1.0:
        assert state.at_limit[5]
    moved_m = motion.T_base_tcp.translation - sample.motion.T_base_tcp.translation
    assert np.linalg.norm(moved_m) <= PLAIN.speed_max_m_s * DT_S + 1e-12


def test_the_reference_moves_with_a_path_and_stays_for_the_same_axes() -> None:
    """A changed set point keeps it; other compliant axes begin where they are."""
    spring = VirtualMass(stiffness=1000.0)
    task = AxisTask(NONE, shifts=(spring, None, None))
    state = ComplianceState.at(task, START, START, SETTINGS)
    state.move(((0.0, 0.01, 0.0), (0.0, 0.0, 0.0)))
    assert state.T_reference.translation - START.translation == pytest.approx([0.0, 0.01, 0.0])
    assert state.covers(replace(task, force_N=(0.0, 0.0, 5.0)))
    assert not state.covers(replace(task, shifts=(None, spring, None)))
    assert not state.covers(replace(task, deviations=((0.1, None, None), CELLS)))


@pytest.mark.parametrize("mode", ["position", "orientation", "both"])
def test_a_mode_is_a_row_of_axes(mode) -> None:
    """With all axes free in tool axes; with a mask in base, the press is along base axes."""
    task = mode_task(mode, 10.0)
    moves, may_turn = mode != "orientation", mode != "position"
    assert (task.yields, task.turns) == ((moves,) * 3, (may_turn,) * 3)
    assert (task.force_N, task.R_task) == ((0.0, 0.0, 10.0 * moves), None)
    only_z = (False, False, True) * 2
    task = mode_task(mode, 10.0, axes=only_z, in_base=True, press_axis=(0.6, 0.0, -0.8))
    assert task.in_base
    assert task.force_N == pytest.approx((0.0, 0.0, -8.0 * moves))
