"""Points that a pressed tool follows: poses whose height and orientation are free."""

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.motion.convert import pose_of, record_of, vec3
from common.motion.frames import apart
from control.axis_task import IDENTITY
from control.path_follower import tangent_frame
from forcemesh import topics
from forcemesh.force_task import parse_task
from forcemesh.messages import UNIT_QUATERNION, ZERO3, PoseRecord, RobotCommand
from forcemesh.requests import ForceStartRequest, PathRequest
from services.regulator import service
from services.regulator.path_request import path_poses
from tests.fakes.bench import CELL
from tests.fakes.regulator_bench import KI, PERIOD_S, T_FLANGE_TCP, FollowingBench

ORIGIN = PoseRecord(position_m=ZERO3, orientation_xyzw=UNIT_QUATERNION)
coordinates = st.floats(-0.05, 0.05).map(lambda x: round(x, 4))
places = st.tuples(*[coordinates] * 3)
turns = st.tuples(*[st.floats(-0.5, 0.5)] * 3)
PRESS = ForceStartRequest(mode="position", setpoint_N=5.0, axes=(False, False, True) * 2)


def path_x(bench: FollowingBench) -> list[float]:
    """Return the direction of axis x of the path frame, along the path."""
    assert isinstance(bench.service, service.Regulator)
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
    """Lateral set points turn with it; at the end of a path it keeps its direction."""
    ahead = np.array([0.0, 1.0, 0.0])
    R = np.array(tangent_frame(IDENTITY, ahead, np.eye(3), 0.01))
    assert np.arctan2(R[1, 0], R[0, 0]) == pytest.approx(0.06)
    there = np.array(tangent_frame(IDENTITY, np.zeros(3), np.eye(3), 0.01))
    assert there == pytest.approx(np.eye(3))


@given(places, turns, st.lists(places, min_size=1, max_size=4))
def test_a_point_is_a_pose_whose_height_and_orientation_are_free(place, turn, points) -> None:
    """Those of where the path begins; across the tool's axis it is the point."""
    T_from = pin.SE3(pin.exp3(np.array(turn)), np.array(place))
    poses = path_poses(PathRequest(points_m=tuple(points)), T_from)
    assert len(poses) == len(points)
    for point, T in zip(points, poses, strict=True):
        assert np.array_equal(T.rotation, T_from.rotation)
        assert T_from.actInv(T).translation[2] == pytest.approx(0.0, abs=1e-12)
        off_m = T_from.rotation.T @ (T.translation - np.array(point))
        assert off_m[:2] == pytest.approx([0.0, 0.0], abs=1e-12)


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


class PointsBench(FollowingBench):
    """A tool that presses with 8 N; places are in its axes at the start [mm]."""

    slowest_m: float | None = None  # travel of a period that the arbiter releases

    def __init__(self, request: ForceStartRequest) -> None:
        """Begin in contact, under this request."""
        super().__init__()
        self.begin = self.poses[0].copy()
        self.load()
        assert self.start(request).accepted
        self.pass_s(0.2)

    def load(self, x_N: float = 0.0, y_N: float = 0.0, about_y_Nm: float = 0.0) -> None:
        """Apply the press and a lateral load, in the tool's present axes."""
        R = self.poses[-1].rotation
        self.push(vec3(R @ [x_N, y_N, -8.0]), vec3(R @ [0.0, about_y_Nm, 0.0]))

    def follow(self) -> None:
        """Release the target, slowed."""
        T, before = pose_of(self.published().pose or ORIGIN), pose_of(self.robot)
        travel_m = T.translation - before.translation
        if self.slowest_m is None or np.linalg.norm(travel_m) <= self.slowest_m:
            super().follow()
            self.command = self.command.replaced(limited=False)
            return
        p_m = before.translation + self.slowest_m * travel_m / np.linalg.norm(travel_m)
        pose = record_of(pin.SE3(T.rotation, p_m))
        self.robot = self.robot.replaced(**pose.as_dict())
        self.command = RobotCommand(kind="setpoint", pose=pose, limited=True)
        self.poses.append(pose_of(pose) * T_FLANGE_TCP)

    def send(self, *places_mm: tuple[float, float, float], speed_m_s: float, **more: Any) -> None:
        """Request a path of points."""
        points = tuple(vec3(self.begin.act(1e-3 * np.array(place))) for place in places_mm)
        request = PathRequest(points_m=points, speed_m_s=speed_m_s, **more)
        assert self.ask(topics.FORCE_PATH, request).accepted

    def at_mm(self) -> np.ndarray:
        """Return where the tool is."""
        place: np.ndarray = 1e3 * self.begin.actInv(self.poses[-1]).translation
        return place

    def until_the_end(self) -> None:
        """Let the path end; force and path together keep the speed limit."""
        for _ in range(100):
            self.pass_s(0.2)
            if self.published().path_left_m == 0.0:
                break
        assert self.published().path_left_m == 0.0
        assert max(self.steps_m) <= CELL.force.speed_max_m_s * PERIOD_S * (1.0 + 1e-6)


LATERAL = ForceStartRequest(task=parse_task("z=force:8 y=force:0", "path"), law="plain")
PRESS_8 = PRESS.replaced(setpoint_N=8.0)
ALL_FREE = ForceStartRequest(mode="position", setpoint_N=8.0, law="plain")


@pytest.mark.parametrize("path_mm", [1.5, 10.0])
def test_a_tool_that_limits_slow_down_still_reaches_the_last_point(path_mm: float) -> None:
    """Found: it stopped up to 2 mm before it, and nothing was left of the path."""
    bench = PointsBench(PRESS_8)
    bench.slowest_m = 0.005 * PERIOD_S
    bench.send((path_mm, 0.0, 0.0), speed_m_s=0.02)
    bench.pass_s(0.1)
    assert (bench.published().path_left_m or 0.0) > 0.6e-3 * path_mm
    bench.until_the_end()
    assert bench.at_mm()[:2] == pytest.approx([path_mm, 0.0], abs=1e-3)


def test_each_corner_is_met_also_behind_a_slower_limit() -> None:
    """Found: the reference went round it before the tool was there."""
    bench, corners = PointsBench(PRESS_8), [(10.0, 0.0, 0.0), (10.0, 10.0, 0.0), (0.0, 10.0, 0.0)]
    bench.slowest_m = 0.005 * PERIOD_S
    bench.send(*corners, speed_m_s=0.02)
    bench.until_the_end()
    passed_mm = [1e3 * bench.begin.actInv(T).translation[:2] for T in bench.poses]
    for corner in corners:
        assert min(np.linalg.norm(place - corner[:2]) for place in passed_mm) < 0.05


def test_the_height_of_points_means_nothing() -> None:
    """Neither to the workspace, nor to the feed, nor to a spring along the tool's axis."""
    task = parse_task("z=compliant,stiffness=500")
    bench = PointsBench(ForceStartRequest(task=task, law="plain"))
    bench.load()
    bench.pass_s(1.0)
    away_m = bench.published().axes[2].deviation
    bench.send((10.0, 0.0, 600.0), (20.0, 0.0, 630.0), speed_m_s=0.02, in_contact=False)
    bench.pass_s(0.2)
    bench.send((30.0, 0.0, 590.0), speed_m_s=0.02, append=True, in_contact=False)
    bench.until_the_end()
    assert bench.at_mm()[0] == pytest.approx(30.0, abs=1e-3)
    assert bench.published().axes[2].deviation == pytest.approx(away_m, abs=1e-3)


def test_a_lateral_push_behind_a_limit_ends_with_its_force() -> None:
    """Found: what the arbiter had not let through was made up for seconds later."""
    bench = PointsBench(LATERAL)
    bench.slowest_m = 0.003 * PERIOD_S
    bench.send((40.0, 0.0, 0.0), speed_m_s=0.02)
    bench.load(y_N=15.0)
    bench.pass_s(1.5)
    bench.load()
    bench.pass_s(0.1)
    (x_mm, y_mm, _) = bench.at_mm()
    bench.pass_s(1.0)
    assert bench.at_mm()[1] - y_mm < 0.3
    assert bench.at_mm()[0] - x_mm > 2.0


@pytest.mark.parametrize("law", ["plain", "adaptive"])
def test_points_on_a_circle_are_followed_by_a_turning_frame(law: str) -> None:
    """Found: at each bend a part of the travel was lost."""
    bench = PointsBench(LATERAL.replaced(law=law))
    turns = np.linspace(0.0, 2.0 * np.pi, 49)[1:]
    circle = [(20.0 * np.sin(a), 20.0 * (1.0 - np.cos(a)), 0.0) for a in turns]
    bench.send(*circle, speed_m_s=0.03)
    bench.until_the_end()
    assert bench.at_mm()[:2] == pytest.approx([0.0, 0.0], abs=0.1)


def test_a_replaced_path_leads_to_its_points() -> None:
    """Also around a right angle at full speed, while the frame still turns."""
    bench = PointsBench(LATERAL)
    bench.send((50.0, 0.0, 0.0), speed_m_s=0.05)
    bench.pass_s(0.6)
    x_mm = float(bench.at_mm()[0])
    bench.send((x_mm, 30.0, 0.0), speed_m_s=0.05)
    bench.until_the_end()
    assert bench.at_mm()[:2] == pytest.approx([x_mm, 30.0], abs=1e-3)


def test_points_after_an_ended_path_begin_where_the_tool_is() -> None:
    """Found: a tool that had drifted since was pulled back at the highest speed."""
    bench = PointsBench(ALL_FREE)
    bench.send((10.0, 0.0, 0.0), speed_m_s=0.02)
    bench.until_the_end()
    bench.load(y_N=20.0)
    bench.pass_s(1.0)
    bench.load()
    bench.pass_s(0.2)
    assert bench.at_mm()[1] > 5.0
    before = len(bench.steps_m)
    bench.send((20.0, 0.0, 0.0), speed_m_s=0.005, append=True)
    bench.pass_s(0.5)
    assert 0.0 < max(bench.steps_m[before:]) <= 0.005 * PERIOD_S * (1.0 + 1e-6)


@pytest.mark.parametrize(
    "request_",
    [
        ALL_FREE,
        ForceStartRequest(task=parse_task("x=compliant,stiffness=500 z=force:8"), law="plain"),
    ],
)
def test_a_wall_in_the_way_brings_points_to_a_stand(request_: ForceStartRequest) -> None:
    """Where the force moves the tool across its axis as well, no harder than at the feed's gain."""
    bench, forces_N = PointsBench(request_), []
    bench.send((20.0, 0.0, 0.0), speed_m_s=0.02)
    for _ in range(400):
        forces_N.append(20.0 * max(0.0, bench.at_mm()[0] - 5.0))  # 2e4 N/m
        bench.load(x_N=-forces_N[-1])
        bench.step()
    assert 10.0 < max(forces_N) < 1.1 * 0.02 / KI + CELL.force.deadband_N


def test_points_before_the_contact_do_not_end_its_search() -> None:
    """Without waiting for contact the tool goes down along the path."""
    bench = PointsBench(PRESS_8)
    bench.push()
    bench.send((20.0, 0.0, 0.0), speed_m_s=0.02, in_contact=False)
    bench.pass_s(0.8)
    assert bench.at_mm()[2] > 4.0


def test_a_tool_that_turns_on_the_way_meets_a_point_at_its_own_height() -> None:
    """Only what is across its axis then counts."""
    task = parse_task("z=force:8 ry=torque:0")
    bench = PointsBench(ForceStartRequest(task=task, law="plain"))
    bench.send((30.0, 0.0, 10.0), speed_m_s=0.02)
    bench.load(about_y_Nm=1.5)
    bench.pass_s(0.8)
    bench.load()
    bench.until_the_end()
    off_m = bench.poses[-1].actInv(bench.begin.act(np.array([0.03, 0.0, 0.01])))
    assert np.degrees(apart(bench.begin, bench.poses[-1])[1]) > 5.0
    assert off_m[:2] == pytest.approx([0.0, 0.0], abs=1e-5)


@pytest.mark.parametrize("slope_deg", [0.0, 20.0, 30.0])
def test_poses_on_a_slope_of_the_tool_are_followed_in_the_frame_of_the_path(slope_deg) -> None:
    """Found: beyond 26 degrees the path waited for a frame that cannot turn further."""
    bench = PointsBench(ForceStartRequest(task=parse_task("z=force:8", "path"), law="plain"))
    along = np.array([np.cos(np.radians(slope_deg)), 0.0, -np.sin(np.radians(slope_deg))])
    places = (pin.SE3(np.eye(3), s * along) for s in (0.0, 0.01, 0.02))
    poses = tuple(record_of(bench.poses[-1] * T) for T in places)
    assert bench.ask(topics.FORCE_PATH, PathRequest(poses=poses, speed_m_s=0.02)).accepted
    bench.until_the_end()
