"""Curve through the poses of a path, its feed and look-ahead."""

from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.motion.frames import apart
from control.path_curve import ROTATION_RADIUS_M, PathCurve, TurnLimits

DT_S, FEED_M_S, ACCEL_M_S2, TURN_RAD_S = 0.004, 0.02, 0.3, 1.0
IN_PLACE_RAD_S = 0.3
TURNS = TurnLimits(TURN_RAD_S, IN_PLACE_RAD_S)
MOST_M, SLOW_S = 1.0, 0.05
coordinates = st.floats(-0.05, 0.05).map(lambda x: round(x, 4))
angles = st.floats(-0.5, 0.5).map(lambda x: round(x, 3))
places = st.tuples(*[coordinates] * 3, *[angles] * 3)
routes = st.lists(places, min_size=1, max_size=6)
blends = st.sampled_from([0.0, 0.002, 0.02])


def pose_at(place: tuple[float, ...]) -> pin.SE3:
    """Return a pose of three coordinates and a rotation vector."""
    return pin.SE3(pin.exp3(np.array(place[3:])), np.array(place[:3]))


def start() -> PathCurve:
    """Return a path without poses at the origin."""
    return PathCurve(pin.SE3.Identity(), FEED_M_S, ACCEL_M_S2, TURNS)


def joined(path: PathCurve, poses: list[pin.SE3], blend_m: float) -> PathCurve:
    """Return the path with more poses, all joined."""
    path = path.extended(poses, blend_m)
    while path.waiting:
        path = path.joined()
    return path


def followed(path: PathCurve, dt_s: float = DT_S) -> list[PathCurve]:
    """Return the path at each period until it stands at its end."""
    passed = [path]
    while passed[-1].pending:
        assert len(passed) < 20_000, "the path does not end"
        passed.append(passed[-1].advanced(dt_s, share=1.0, most_m=MOST_M))
    return passed


@settings(max_examples=10)
@given(routes, blends)
def test_the_feed_never_exceeds_its_limits_and_the_end_is_reached_exactly(route, blend_m) -> None:
    """Travel, turn and acceleration of each period; the length that is left only falls."""
    poses = [pose_at(place) for place in route]
    passed = followed(start().extended(poses, blend_m), SLOW_S)
    assert apart(passed[-1].T_reference, poses[-1]) == pytest.approx((0.0, 0.0), abs=1e-9)
    for before, after in pairwise(passed):
        moved_m, turned_rad = apart(before.T_reference, after.T_reference)
        assert moved_m <= FEED_M_S * SLOW_S * 1.01
        assert turned_rad <= TURN_RAD_S * SLOW_S * 1.05 + 1e-9
        assert after.left_m <= before.left_m
        assert after.now_m_s <= before.now_m_s + ACCEL_M_S2 * SLOW_S + 1e-12


def test_the_tool_stops_at_a_sharp_corner_and_not_at_a_blended_one() -> None:
    """A blend of 3 mm is passed at the speed that its curvature and the acceleration permit."""
    corner = [pose_at((0.02, 0, 0, 0, 0, 0)), pose_at((0.02, 0.02, 0, 0, 0, 0))]
    slowest = [
        min(each.now_m_s for each in followed(start().extended(corner, blend_m))[20:-40])
        for blend_m in (0.0, 0.003)
    ]
    assert slowest[0] < 0.003
    assert slowest[1] == pytest.approx(FEED_M_S)


def test_it_brakes_over_several_short_pieces() -> None:
    """Not only in the last one."""
    route = [pose_at((1e-4 * number, 0, 0, 0, 0, 0)) for number in range(1, 60)]
    passed = followed(joined(start(), route, 0.0))
    for before, after in pairwise(passed):
        assert before.now_m_s - after.now_m_s <= 2.0 * ACCEL_M_S2 * DT_S + 1e-9


def test_a_corner_that_is_near_already_is_blended_without_a_jump() -> None:
    """The blend begins no earlier than where the tool is."""
    near = followed(start().extended([pose_at((0.02, 0, 0, 0, 0, 0))], 0.0))[-20]
    after = near.extended([pose_at((0.02, 0.02, 0, 0, 0, 0))], 0.01).joined()
    assert apart(near.T_reference, after.T_reference) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert after.pieces[0].length_m - after.done_m >= -1e-9


def test_a_tool_turns_in_place_at_the_feed_of_a_small_radius() -> None:
    """A rotation has no direction of travel, so the path stops before and after it."""
    turn = pose_at((0.0, 0.0, 0.0, 0.0, 0.0, 0.4))
    path = joined(start(), [turn, turn, pose_at((0.01, 0, 0, 0, 0, 0.4))], 0.005)
    assert len(path.pieces) == 2
    assert path.pieces[0].length_m == pytest.approx(0.4 * ROTATION_RADIUS_M)
    assert path.tangent == pytest.approx(np.zeros(3))
    assert path.ends_m_s == (0.0, 0.0)
    assert len(followed(path)) > 0.4 / IN_PLACE_RAD_S / DT_S


@given(st.floats(0.0, 0.1), st.floats(1e-3, 1.0))
def test_a_turn_that_the_travel_does_not_explain_has_a_speed_of_its_own(travel_m, angle) -> None:
    """A tool that travels over a convex body turns as fast as its feed; in place it is slow."""
    (piece,) = joined(start(), [pose_at((travel_m, 0, 0, 0, angle, 0))], 0.0).pieces
    turn_rad_s = piece.fastest_m_s * angle / piece.length_m
    explained = min(travel_m / (ROTATION_RADIUS_M * angle), 1.0)
    assert turn_rad_s <= TURN_RAD_S * (1 + 1e-6)
    assert turn_rad_s * (1.0 - explained) <= IN_PLACE_RAD_S * (1 + 1e-6)
    assert turn_rad_s >= IN_PLACE_RAD_S * (1 - 1e-6)


def test_a_blend_turns_its_tangent_by_half_in_the_middle() -> None:
    """Of a right angle."""
    corner = [pose_at((0.02, 0, 0, 0, 0, 0)), pose_at((0.02, 0.02, 0, 0, 0, 0))]
    _, blend, _ = joined(start(), corner, 0.005).pieces
    assert blend.tangent(0.5 * blend.length_m) == pytest.approx([0.5**0.5, 0.5**0.5, 0.0])


@settings(max_examples=20)
@given(routes, blends)
def test_a_pose_that_is_joined_while_the_tool_moves_changes_nothing(route, blend_m) -> None:
    """One is joined in each period, and the tool moves as on a curve that is joined at once."""
    poses = [pose_at(place) for place in route]
    lazy, whole = start().extended(poses, blend_m), joined(start(), poses, blend_m)
    for count in range(100):
        lazy = lazy.advanced(DT_S, share=1.0, most_m=MOST_M)
        whole = whole.advanced(DT_S, share=1.0, most_m=MOST_M)
        assert len(lazy.waiting) <= max(len(poses) - 1 - count, 0)
        assert apart(lazy.T_reference, whole.T_reference) == pytest.approx((0.0, 0.0), abs=1e-9)


@settings(max_examples=40)
@given(routes, blends)
def test_the_curve_is_continuous_and_passes_near_every_pose(route, blend_m) -> None:
    """Each piece begins where the last one ends; a blend cuts a corner within its distance."""
    poses = [pose_at(place) for place in route]
    pieces = joined(start(), poses, blend_m).pieces
    for a, b in pairwise(pieces):
        assert apart(a.at(a.length_m), b.at(0.0)) == pytest.approx((0.0, 0.0), abs=1e-9)
    passed = [each.at(share * each.length_m) for each in pieces for share in np.linspace(0, 1, 60)]
    for T in poses:
        nearest_m = min(apart(T, each)[0] for each in [pin.SE3.Identity(), *passed])
        assert nearest_m <= blend_m / np.sqrt(2.0) + 2e-3


@settings(max_examples=40)
@given(routes, routes, blends)
def test_poses_in_two_requests_are_the_same_curve_as_in_one(first, second, blend_m) -> None:
    """Also the corner between both is blended, as long as the tool is before it."""
    some, others = ([pose_at(place) for place in route] for route in (first, second))
    at_once = joined(start(), some + others, blend_m)
    in_two = joined(joined(start(), some, blend_m), others, blend_m)
    assert at_once.ends_m_s == pytest.approx(in_two.ends_m_s)
    for one, other in zip(at_once.pieces, in_two.pieces, strict=True):
        assert apart(one.T_to, other.T_to) == pytest.approx((0.0, 0.0), abs=1e-9)
