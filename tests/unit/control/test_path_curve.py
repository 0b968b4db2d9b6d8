"""Curve through the poses of a path."""

from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.motion.frames import apart
from control.path_curve import PathCurve, TurnLimits

coordinates, angles = st.floats(-0.05, 0.05), st.floats(-0.5, 0.5)
poses = st.builds(
    lambda p, turn: pin.SE3(pin.exp3(np.round(turn, 3)), np.round(p, 4)),
    st.tuples(*[coordinates] * 3).map(np.array), st.tuples(*[angles] * 3).map(np.array),
)  # fmt: skip
routes, blends = st.lists(poses, min_size=1, max_size=6), st.sampled_from([0.0, 0.002, 0.02])


def curve(*requests: list[pin.SE3], blend_m: float) -> PathCurve:
    """Return a path from the origin through the poses of some requests, all joined."""
    path = PathCurve(pin.SE3.Identity(), 0.02, 0.3, TurnLimits(rad_s=1.0, in_place_rad_s=0.3))
    for each in requests:
        path = path.extended(each, blend_m)
        while path.waiting:
            path = path.joined()
    return path


@settings(max_examples=40)
@given(routes, blends)
def test_the_curve_is_continuous_and_passes_near_every_pose(
    route: list[pin.SE3], blend_m: float
) -> None:
    """Each piece begins where the last one ends; a blend cuts a corner within its distance."""
    pieces = curve(route, blend_m=blend_m).pieces
    for a, b in pairwise(pieces):
        assert apart(a.at(a.length_m), b.at(0.0)) == pytest.approx((0.0, 0.0), abs=1e-9)
    passed = [each.at(share * each.length_m) for each in pieces for share in np.linspace(0, 1, 60)]
    for T in route:
        nearest_m = min(apart(T, each)[0] for each in [pin.SE3.Identity(), *passed])
        assert nearest_m <= blend_m / np.sqrt(2.0) + 2e-3


@settings(max_examples=40)
@given(routes, routes, blends)
def test_poses_in_two_requests_are_the_same_curve_as_in_one(
    first: list[pin.SE3], second: list[pin.SE3], blend_m: float
) -> None:
    """Also the corner between both is blended, as long as the tool is before it."""
    at_once = curve(first + second, blend_m=blend_m)
    in_two = curve(first, second, blend_m=blend_m)
    assert at_once.ends_m_s == pytest.approx(in_two.ends_m_s)
    for one, other in zip(at_once.pieces, in_two.pieces, strict=True):
        assert apart(one.T_to, other.T_to) == pytest.approx((0.0, 0.0), abs=1e-9)
