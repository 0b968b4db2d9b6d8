"""Curve through the poses of a path."""

from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.motion.frames import apart
from services.regulator.path_curve import PathCurve, TurnLimits

FEED_M_S, ACCEL_M_S2 = 0.02, 0.3
TURNS = TurnLimits(rad_s=1.0, in_place_rad_s=0.3)
coordinates = st.floats(-0.05, 0.05).map(lambda x: round(x, 4))
angles = st.floats(-0.5, 0.5).map(lambda x: round(x, 3))
places = st.tuples(*[coordinates] * 3, *[angles] * 3)
routes = st.lists(places, min_size=1, max_size=6)
blends = st.sampled_from([0.0, 0.002, 0.02])


def start() -> PathCurve:
    """Return a path without poses at the origin."""
    return PathCurve(pin.SE3.Identity(), FEED_M_S, ACCEL_M_S2, TURNS)


def pose_at(place: tuple[float, ...]) -> pin.SE3:
    """Return a pose of three coordinates and a rotation vector."""
    return pin.SE3(pin.exp3(np.array(place[3:])), np.array(place[:3]))


def joined(path: PathCurve, poses: list[pin.SE3], blend_m: float) -> PathCurve:
    """Return the path with more poses, all joined."""
    path = path.extended(poses, blend_m)
    while path.waiting:
        path = path.joined()
    return path


@settings(max_examples=40)
@given(routes, blends)
def test_the_curve_is_continuous_and_passes_near_every_pose(route, blend_m) -> None:
    """Each piece begins where the last one ends; a blend cuts a corner within its distance."""
    poses = [pose_at(place) for place in route]
    path = joined(start(), poses, blend_m)
    for a, b in pairwise(path.pieces):
        assert apart(a.at(a.length_m), b.at(0.0)) == pytest.approx((0.0, 0.0), abs=1e-9)
    samples = [
        piece.at(share * piece.length_m) for piece in path.pieces for share in np.linspace(0, 1, 60)
    ]
    for T in poses:
        nearest_m = min(
            (apart(T, sample)[0] for sample in samples), default=apart(T, pin.SE3.Identity())[0]
        )
        assert nearest_m <= blend_m / np.sqrt(2.0) + 2e-3


@settings(max_examples=40)
@given(routes, routes, blends)
def test_poses_in_two_requests_are_the_same_curve_as_in_one(first, second, blend_m) -> None:
    """Also the corner between both is blended, as long as the tool is before it."""
    a, b = [[pose_at(place) for place in route] for route in (first, second)]
    at_once = joined(start(), a + b, blend_m)
    in_two = joined(joined(start(), a, blend_m), b, blend_m)
    assert len(at_once.pieces) == len(in_two.pieces)
    assert at_once.ends_m_s == pytest.approx(in_two.ends_m_s)
    for one, other in zip(at_once.pieces, in_two.pieces, strict=True):
        assert apart(one.T_to, other.T_to) == pytest.approx((0.0, 0.0), abs=1e-9)
