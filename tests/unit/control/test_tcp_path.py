"""Paths of points: their frame, their feed, and a pressed tool that follows them."""

from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from control.axis_task import IDENTITY
from control.tcp_path import advance, path_along, tangent_frame
from forcemesh import topics
from forcemesh.force_task import parse_task
from forcemesh.requests import ForceStartRequest, PathRequest
from services.regulator.service import Regulator
from tests.fakes.regulator_bench import PERIOD_S, FollowingBench

PRESS = ForceStartRequest(mode="position", setpoint_N=5.0, axes=(False, False, True) * 2)
coordinates = st.floats(-0.05, 0.05).map(lambda x: round(x, 4))
points = st.lists(st.tuples(*[coordinates] * 3).map(np.array), min_size=1, max_size=6)


def path_x(bench: FollowingBench) -> list[float]:
    """Return the direction of axis x of the path frame, along the path."""
    assert isinstance(bench.service, Regulator)
    session = bench.service._session
    assert session is not None
    return [row[0] for row in session.goal.R_task or ()]


def test_the_frame_of_a_path_turns_with_it() -> None:
    """The lateral axis stays lateral; at the end of the path the frame keeps its direction."""
    bench = FollowingBench()
    task = parse_task("z=force:8 y=force:0", "path")
    bench.push((0.0, 0.0, 8.0))
    assert bench.start(ForceStartRequest(task=task, law="adaptive")).accepted
    bench.pass_s(0.1)
    begin = bench.p_tcp_m
    corner = begin + np.array([0.0, 0.01, 0.0])
    points_m = tuple(corner), tuple(corner + np.array([0.01, 0.0, 0.0]))
    path = PathRequest(points_m=points_m, speed_m_s=0.02)
    assert bench.ask(topics.FORCE_PATH, path).accepted
    bench.pass_s(0.3)
    assert path_x(bench) == pytest.approx([0.0, 1.0, 0.0], abs=0.05)
    bench.push((5.0, 0.0, 8.0))  # lateral: the tool yields, and the path goes along with it
    bench.pass_s(0.1)
    assert bench.p_tcp_m[0] - begin[0] > 1e-5
    bench.push((0.0, 0.0, 8.0))
    bench.pass_s(2.0)
    assert bench.published().path_left_m == pytest.approx(0.0, abs=1e-3)
    assert path_x(bench) == pytest.approx([1.0, 0.0, 0.0], abs=0.05)


def test_a_tangent_frame_turns_no_faster_than_its_limit() -> None:
    """Lateral set points turn with it; at a reached point it keeps its direction."""
    path = path_along(
        (np.array([0.0, 0.01, 0.0]),), speed_m_s=0.02, accel_m_s2=1.0, in_contact=False
    )
    ahead = path.ahead(pin.SE3.Identity())
    R = np.array(tangent_frame(IDENTITY, ahead, np.eye(3), 0.01))
    assert np.arctan2(R[1, 0], R[0, 0]) == pytest.approx(0.06)
    there = path.ahead(pin.SE3(np.eye(3), path.points[0]))
    assert np.array(tangent_frame(IDENTITY, there, np.eye(3), 0.01)) == pytest.approx(np.eye(3))


@settings(max_examples=20)
@given(points, st.floats(0.005, 0.2), st.floats(0.1, 2.0))
def test_a_path_visits_its_points_across_the_axis_within_its_speed(
    direction, speed_m_s, accel_m_s2
) -> None:
    """Each point is passed within a period's travel, without motion along the axis."""
    R = pin.exp3(np.array([-np.arcsin(0.6), 0.0, 0.0]))
    axis, p = R[:, 2], np.zeros(3)
    route = path_along(
        tuple(direction), speed_m_s=speed_m_s, accel_m_s2=accel_m_s2, in_contact=False
    )
    rest, visited, speeds = np.zeros(3), [p], [0.0]
    left_m = route.report(pin.SE3(R, p))["path_left_m"]
    expected_s = left_m / speed_m_s + len(direction) * speed_m_s / accel_m_s2 + 1.0
    for _ in range(round(3.0 * expected_s / PERIOD_S)):
        route, shift = advance(route, p, axis, dt_s=PERIOD_S, pushed_m=rest, most_m=1.0)
        p = p + shift
        visited.append(p)
        speeds.append(route.now_m_s)
        assert np.linalg.norm(shift) <= route.now_m_s * PERIOD_S * (1 + 1e-9)
        assert abs(float(shift @ axis)) < 1e-12
    assert not route.points
    assert max(speeds) <= speed_m_s * (1 + 1e-9)
    rises = [b - a for a, b in pairwise(speeds)]
    assert max(rises) <= accel_m_s2 * PERIOD_S * (1 + 1e-9)
    for point in direction:
        across = np.array(visited) - point
        across -= np.outer(across @ axis, axis)
        assert np.linalg.norm(across, axis=1).min() < max(1e-5, speed_m_s * PERIOD_S)


def test_a_pressed_tool_follows_points_and_stops_where_contact_ends() -> None:
    """It reports the remaining path, waits without contact, and stops on request."""
    bench = FollowingBench()
    bench.push((0.0, 0.0, 5.0))
    bench.start(PRESS)
    bench.pass_s(0.1)
    start = bench.p_tcp_m
    ahead = tuple(tuple(start + np.array([x, 0.0, 0.3])) for x in (0.01, 0.02))
    assert bench.ask(topics.FORCE_PATH, PathRequest(points_m=ahead, speed_m_s=0.04)).accepted
    bench.pass_s(0.2)
    halfway = bench.p_tcp_m
    assert 0.002 < halfway[0] - start[0] < 0.01
    assert bench.published().path_left_m == pytest.approx(0.02 - (halfway - start)[0], abs=1e-4)
    bench.push()
    bench.pass_s(0.2)
    stopped_at = bench.p_tcp_m
    bench.pass_s(0.2)
    assert bench.p_tcp_m[:2] == pytest.approx(stopped_at[:2], abs=1e-9)
    bench.push((0.0, 0.0, 5.0))
    bench.pass_s(1.0)
    assert bench.p_tcp_m[:2] == pytest.approx((start + np.array([0.02, 0.0, 0.0]))[:2], abs=1e-6)
    assert bench.published().path_left_m == 0.0
    more = PathRequest(points_m=(tuple(start),), append=True)
    assert bench.ask(topics.FORCE_PATH, more).accepted
    bench.pass_s(0.3)
    assert bench.ask(topics.FORCE_PATH, PathRequest()).accepted
    bench.pass_s(0.1)
    stopped_at = bench.p_tcp_m
    bench.pass_s(0.3)
    assert bench.p_tcp_m == pytest.approx(stopped_at, abs=1e-9)


@given(st.tuples(*[st.floats(-1.0, 1.0)] * 3), st.floats(0.0, 1.0))
def test_force_and_path_together_are_within_the_speed_limit(direction, share) -> None:
    """The path takes the rest of the period's motion that the force leaves."""
    pushed_m = 2e-4 * share * np.array(direction) / max(1.0, float(np.linalg.norm(direction)))
    axis = np.array([0.0, 0.0, 1.0])
    route = path_along(
        (np.array([0.1, 0.0, 0.0]),), speed_m_s=0.2, accel_m_s2=100.0, in_contact=False
    )
    _, shift = advance(route, np.zeros(3), axis, dt_s=PERIOD_S, pushed_m=pushed_m, most_m=2e-4)
    assert np.linalg.norm(pushed_m + shift) <= 2e-4 * (1 + 1e-9)
