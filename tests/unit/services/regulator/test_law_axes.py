"""Masked axes: they do not move, and a set point along one is refused."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.motion.frames import plus, rotation_from_vector
from forcemesh import topics
from forcemesh.messages import ZERO3
from forcemesh.requests import ArmRequest, Empty, ForceStartRequest
from launch.virtual_cell import VirtualCell
from services.regulator.gains import PiGains
from services.regulator.law import LawSettings, next_motion, start_at
from tests.fakes.arbiter_world import T_START
from tests.fakes.bench import CELL, HALF_CELL
from tests.fakes.law_input import mode_input
from tests.fakes.regulator_bench import T_FLANGE_TCP, RegulatorBench

X_ONLY = (True, False, False, False, False, False)
Z_HELD = (True, True, False, True, True, True)
GAINS = PiGains((1e-6,) * 3, (1e-3,) * 3, (0.01,) * 3, (0.5,) * 3)


def test_a_set_point_along_a_held_axis_is_refused_and_nothing_moves() -> None:
    """`force start --setpoint 5 --axes x --frame base` went 20 mm down and pressed with 6 N."""
    world = VirtualCell(HALF_CELL)
    world.advance(1.3)
    assert world.client.ask(topics.TARE, Empty()).accepted
    assert world.client.ask(topics.ARM, ArmRequest()).accepted
    before_m = world.arm.T_base_tcp.translation.copy()
    request = ForceStartRequest(mode="position", setpoint_N=5.0, axes=X_ONLY, frame="base")
    reply = world.client.ask(topics.FORCE_START, request)
    world.advance(1.0)
    assert np.linalg.norm(world.arm.T_base_tcp.translation - before_m) < 1e-4
    assert (reply.accepted, reply.code) == (False, "axes")
    assert "5 N" in reply.text
    assert "z" in reply.text
    assert (reply.value, reply.limit) == (None, None)  # shares of an axis do not help a reader


@pytest.mark.parametrize("axes", [X_ONLY, Z_HELD])
@pytest.mark.parametrize("frame", ["base", "tool"])
@pytest.mark.parametrize("mode", ["position", "both"])
@pytest.mark.parametrize("law", ["plain", "adaptive"])
def test_it_is_refused_in_every_frame_mode_and_law(
    axes: Any, frame: Any, mode: Any, law: Any
) -> None:
    """A set point needs the tool's axis; at set point 0 the same axes are accepted."""
    bench = RegulatorBench()
    bench.pass_s(0.1)
    request = ForceStartRequest(mode=mode, setpoint_N=5.0, axes=axes, frame=frame, law=law)
    reply = bench.start(request)
    assert (reply.accepted, reply.code) == (False, "axes")
    assert bench.start(request.replaced(setpoint_N=0.0)).accepted
    assert bench.start(request).code == "axes"  # while it runs as well
    assert bench.start(request.replaced(axes=(True,) * 6)).accepted


def test_mode_orientation_needs_no_press_axis() -> None:
    """Its set point is not used."""
    bench = RegulatorBench()
    bench.pass_s(0.1)
    request = ForceStartRequest(mode="orientation", setpoint_N=5.0, axes=Z_HELD)
    assert bench.start(request).accepted


@settings(max_examples=60, deadline=None)
@given(
    axes=st.tuples(*[st.booleans()] * 6),
    turn=st.tuples(*[st.floats(-2.0, 2.0)] * 3),
    frame=st.sampled_from(["base", "tool"]),
    force_N=st.tuples(*[st.floats(-30.0, 30.0)] * 3),
    setpoint_N=st.floats(0.0, 40.0),
    mode=st.sampled_from(["position", "orientation", "both"]),
)
def test_masked_axes_hold_under_every_law(axes, turn, frame, force_N, setpoint_N, mode) -> None:
    """Approach, press and release make no step along or about a masked axis of the task frame."""
    T = T_START * T_FLANGE_TCP
    T.rotation = rotation_from_vector(np.array(turn)) @ T.rotation
    law, settings_ = start_at(T), LawSettings.of(CELL)
    held = ~np.array(axes)
    for size in (0.0, 0.05, 1.0, 1.0, 0.5, 0.0):  # free, approach, contact, lost
        sample = mode_input(
            plus(ZERO3, force_N, size), plus(ZERO3, force_N, 0.1 * size), setpoint_N, mode, 0.004,
            GAINS, law, T, frame=frame, axes=axes,
        )  # fmt: skip
        before = law.T_base_tcp
        R_task = before.rotation if frame == "tool" else np.eye(3)
        law = next_motion(sample, settings_)
        shift_m = R_task.T @ (law.T_base_tcp.translation - before.translation)
        assert np.abs(shift_m[held[:3]]).max(initial=0.0) < 1e-12
