"""The client's few products of quaternions agree with the mathematics that the services use."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from common.motion.convert import pose_of, record_of
from common.motion.frames import Oat, R_from_oat, R_from_quaternion, pose, rotation_from_vector
from forcemesh.client import rotations as turning
from forcemesh.messages import PoseRecord, Vec3

METRES = st.tuples(*[st.floats(-2.0, 2.0)] * 3)
RADIANS = st.tuples(*[st.floats(-1.7, 1.7)] * 3)
DEGREES = st.tuples(*[st.floats(-360.0, 360.0)] * 3)


def frame(position_m: Vec3, oat_deg: Vec3) -> PoseRecord:
    """A pose as a message carries it."""
    return PoseRecord(position_m=position_m, orientation_xyzw=turning.from_oat_deg(oat_deg))


@given(DEGREES)
@example((30.0, 0.0, 50.0))
@example((30.0, 180.0, 50.0))
@example((0.0, 1e-12, 0.0))
def test_o_a_t_of_a_rotation_give_it_back(oat_deg: Vec3) -> None:
    """Rz(o) Ry(a) Rz(t); also where two of the axes are parallel; A is never negative."""
    q = turning.from_oat_deg(oat_deg)
    assert R_from_quaternion(q) == pytest.approx(R_from_oat(Oat(*np.radians(oat_deg))), abs=1e-12)
    found = turning.to_oat_deg(q)
    assert 0.0 <= found[1] <= 180.0
    again = R_from_quaternion(turning.from_oat_deg(found))
    assert again == pytest.approx(R_from_quaternion(q), abs=1e-8)


@given(METRES, DEGREES, METRES, DEGREES, METRES, RADIANS, st.booleans())
def test_a_jog_is_the_product_of_poses(
    p_m: Vec3, oat: Vec3, tool_m: Vec3, tool_oat: Vec3, shift_m: Vec3, turn: Vec3, in_tool: bool
) -> None:
    """The tool is shifted and turned about the TCP; the flange goes where that puts it."""
    flange, tool = frame(p_m, oat), frame(tool_m, tool_oat)
    T_base_tool = pose_of(flange) * pose_of(tool)
    R, p = T_base_tool.rotation, T_base_tool.translation
    turned = rotation_from_vector(np.array(turn))
    if in_tool:
        new = pose(p + R @ np.array(shift_m), R @ turned)
    else:
        new = pose(p + np.array(shift_m), turned @ R)
    expected = record_of(new * pose_of(tool).inverse())
    found = turning.jogged(flange, tool, shift_m, turn, in_tool_axes=in_tool)
    assert found.position_m == pytest.approx(expected.position_m, abs=1e-9)
    assert pose_of(found).rotation == pytest.approx(pose_of(expected).rotation, abs=1e-9)
