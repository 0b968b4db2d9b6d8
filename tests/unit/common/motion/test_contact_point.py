"""Contact point on the face of a tool."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.motion.contact_point import FACE_RADIUS_M, LEAST_NORMAL_N, contact_point_m
from common.motion.frames import rotation_from_vector

ANGLES = st.tuples(*[st.floats(-3.0, 3.0)] * 3)
IN_FACE_M = st.tuples(*[st.floats(-0.04, 0.04)] * 2)


@given(ANGLES, IN_FACE_M, st.floats(1.1 * LEAST_NORMAL_N, 100.0), st.floats(-20.0, 20.0))
def test_a_force_at_a_point_of_the_face_is_found_at_this_point(turn, place_m, normal_N, side_N):
    """In every attitude, with friction, and with a torque about the tool axis."""
    R = rotation_from_vector(np.array(turn))
    force_N = R @ np.array([side_N, -0.5 * side_N, -normal_N])
    point_m = R @ np.array([*place_m, 0.0])
    torque_Nm = np.cross(point_m, force_N) + 0.3 * R[:, 2]
    assert contact_point_m(R, force_N, torque_Nm) == pytest.approx(point_m, abs=1e-9)


@pytest.mark.parametrize(
    ("force_N", "arm_m"),
    [
        ((0.0, 0.0, -0.9 * LEAST_NORMAL_N), 0.01),  # too weak
        ((0.0, 0.0, 20.0), 0.01),  # pulls
        ((20.0, 0.0, 0.0), 0.01),  # from the side
        ((0.0, 0.0, -20.0), 1.1 * FACE_RADIUS_M),  # outside of the face
    ],
)
def test_without_a_contact_of_the_face_the_point_is_the_tcp(force_N, arm_m):
    """A force that does not push on the face has no point on it."""
    torque_Nm = np.cross([arm_m, 0.0, 0.0], force_N)
    assert not contact_point_m(np.eye(3), np.array(force_N), torque_Nm).any()
