"""Task frame and axes of one period: what is held does not move, set points are the tool's."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.motion.frames import cross, plus, rotated, rotation_from_vector
from forcemesh.messages import ZERO3
from services.regulator.axis_task import ALL, CELLS, NONE, AxisTask, clipped, masked, mode_task
from services.regulator.gains import PiGains
from services.regulator.law import (
    LawInput,
    LawSettings,
    next_motion,
    soft_deadband,
    start_at,
    task_deadband,
)
from tests.fakes.arbiter_world import T_START
from tests.fakes.bench import CELL
from tests.fakes.regulator_bench import T_FLANGE_TCP

SETTINGS = LawSettings.of(CELL)
GAINS = PiGains((0.0,) * 3, (1e-3,) * 3, (0.0,) * 3, (0.5,) * 3)
START = T_START * T_FLANGE_TCP
vectors = st.tuples(*[st.floats(-30.0, 30.0)] * 3)
turns = st.tuples(*[st.floats(-2.0, 2.0)] * 3)
flags = st.tuples(*[st.booleans()] * 3)


def rows_of(turn):
    """Return a rotation matrix by rows."""
    return rotation_from_vector(np.array(turn)).tolist()


def sample_of(task, force_N=ZERO3, torque_Nm=ZERO3, contact="contact"):
    """Return one sample of a tool that is already in contact."""
    motion = replace(start_at(START), contact=contact)
    return LawInput(force_N, torque_Nm, task, 0.004, GAINS, motion, START)


@given(turns, flags, flags, vectors, vectors, vectors)
def test_held_axes_of_any_frame_do_not_move(turn, yields, may_turn, force_N, torque_Nm, push_N):
    """Along and about them, for any force, torque and set point."""
    R = rows_of(turn)
    task = AxisTask(
        yields, may_turn, tuple(np.array(push_N) * yields), ZERO3, R_task=R, in_base=True
    )
    after = next_motion(sample_of(task, force_N, torque_Nm), SETTINGS)
    moved_m = np.array(R).T @ (after.T_base_tcp.translation - START.translation)
    assert np.abs(moved_m[~np.array(yields)]).max(initial=0.0) < 1e-12


@given(turns, turns, vectors)
def test_a_frame_of_the_tool_turns_with_it(turn, mounted, push_N) -> None:
    """The set point is along the axes of the frame as the tool is now."""
    task = AxisTask(ALL, NONE, push_N, R_task=rows_of(mounted))
    R_base_tcp = rows_of(turn)
    expected = np.array(R_base_tcp) @ rows_of(mounted)
    assert np.array(task.R_base_task(R_base_tcp)) == pytest.approx(expected, abs=1e-12)


@given(vectors, flags, st.floats(1e-3, 1.0))
def test_speed_limits_of_single_axes_apply_to_a_period(motion, yields, limit) -> None:
    """An axis without a limit is not slowed."""
    out = masked(motion, yields, rows_of((0.3, 0.2, 0.1)), (limit, None, limit), share=0.5)
    along = np.array(rows_of((0.3, 0.2, 0.1))).T @ np.array(out)
    free = np.array(rows_of((0.3, 0.2, 0.1))).T @ np.array(motion) * yields
    assert abs(along[[0, 2]]).max() <= 0.5 * limit + 1e-12
    assert along[1] == pytest.approx(free[1], abs=1e-12)
    assert clipped(motion, None) == motion


@given(vectors, st.floats(0.0, 5.0))
def test_an_axis_with_its_own_deadband_does_not_share_one(error, band) -> None:
    """Its error is shortened by its own width; the others share the cell's."""
    x, y, z = task_deadband(error, 1.0, 0.0, (None, band, None))
    assert (x, 0.0, z) == pytest.approx(soft_deadband((error[0], 0.0, error[2]), 1.0))
    assert abs(y) == pytest.approx(max(abs(error[1]) - band, 0.0))
    assert task_deadband(error, 1.0, 0.0, CELLS) == soft_deadband(error, 1.0)


@given(turns, st.floats(0.0, 1.0))
def test_the_law_uses_deadbands_of_single_axes(turn, band) -> None:
    """Along and about axes of any frame; the errors are published beyond them."""
    R = rows_of(turn)
    bands = ((band, band, band), (band, band, band))
    task = AxisTask(ALL, ALL, ZERO3, R_task=R, in_base=True, deadbands=bands)
    load = tuple(rotated(R, (3.0, 0.0, 0.0)))
    after = next_motion(sample_of(task, load, load), SETTINGS)
    error = np.array(R).T @ np.array(after.error_force_N)
    assert error == pytest.approx([3.0 - band, 0.0, 0.0], abs=1e-9)
    error = np.array(R).T @ np.array(after.error_torque_Nm)
    assert error == pytest.approx([3.0 - band, 0.0, 0.0], abs=1e-9)


@given(vectors, vectors)
def test_a_frame_with_an_origin_turns_the_tool_about_it(force_N, offset_mm) -> None:
    """The torque is the one about the origin, and the TCP moves on an arc."""
    offset_m = tuple(1e-3 * np.array(offset_mm))
    origin_m = tuple(START.translation - offset_m)
    task = AxisTask(NONE, ALL, in_base=True, R_task=rows_of(ZERO3), origin_m=origin_m)
    sample = sample_of(task, force_N, (0.5, -0.3, 0.2))
    after = next_motion(sample, SETTINGS)
    torque_Nm = plus((0.5, -0.3, 0.2), cross(offset_m, force_N))
    assert sample.task_torque_Nm() == pytest.approx(torque_Nm, abs=1e-9)
    turn = after.T_base_tcp.rotation @ START.rotation.T
    arc_m = turn @ offset_m - offset_m
    moved_m = after.T_base_tcp.translation - START.translation
    assert moved_m == pytest.approx(arc_m, abs=1e-6)


def test_the_press_index_is_the_axis_with_the_largest_set_point() -> None:
    """Z without one."""
    found = [
        AxisTask(force_N=force).press_index
        for force in (ZERO3, (0.0, 0.0, 1.0), (3.0, 2.0, -1.0), (1.0, -3.0, 2.0), (1.0, 0.0, -3.0))
    ]
    assert found == [2, 2, 0, 1, 2]


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
