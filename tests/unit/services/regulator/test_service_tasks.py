"""Tasks per axis through the service: refusals, both loop hosts, changes, the frame of a path."""

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from common.motion.convert import pose_of, record_of
from forcemesh import topics
from forcemesh.force_task import parse_task
from forcemesh.messages import ZERO3, RegulatorTarget
from forcemesh.requests import ForceStartRequest, PathRequest
from services.regulator.axis_task import IDENTITY, AxisTask
from services.regulator.gains import held_gains
from services.regulator.task_request import first_setpoint, next_setpoint, ramped, request_task
from services.regulator.tcp_path import path_along, tangent_frame
from tests.fakes.arbiter_world import T_START
from tests.fakes.bench import CELL
from tests.fakes.regulator_bench import FollowingBench, RegulatorBench
from tuning.gain_rule import tune

TWO_HOSTS = CELL.model_copy(
    update={"robot": CELL.robot.model_copy(update={"hosts": ("pc", "controller")})}
)
POSE = record_of(pin.SE3(pin.utils.rotate("z", 0.5), np.array([0.4, 0.0, 0.2])))


def request(text: str, frame: Any = "tool", **others: Any) -> ForceStartRequest:
    """Return the request of a task."""
    pose = others.pop("pose", None)
    return ForceStartRequest(task=parse_task(text, frame, pose), **others)


def task_frame(bench: RegulatorBench) -> Any:
    """Return the axes of the task frame of the running session."""
    regulator: Any = bench.service
    return regulator._session.goal.R_task


@pytest.mark.parametrize(
    ("asked", "code", "named"),
    [
        (request("z=force:5", setpoint_N=5.0), "malformed", "belong to the axes of the task"),
        (request("z=force:5", axes=(False,) * 6), "malformed", "belong to the axes of the task"),
        (request("z=force:5", law="admittance"), "malformed", "guided by control free"),
        (request("z=force:5", "pose"), "malformed", "frame pose needs the pose"),
        (request("z=force:5", "base", pose=POSE), "malformed", "the others have none"),
        (request("x=free", "path"), "malformed", "x of frame path"),
        (request("x=free,stiffness=9"), "malformed", "a free axis has no stiffness"),
        (request("z=force:39 x=force:39"), "setpoint", "force.setpoint_max_N"),
        (request("rz=torque:9e3"), "setpoint", "torque set point"),
        (request("z=free", host="controller"), "host", "axis z: host controller has no control"),
        (request("z=force:5,speed=9", host="controller"), "host", "has no speed_max for single"),
        (request("z=force:5", "path", host="controller"), "host", "cannot follow a path"),
        (request("z=force:5", "pose", pose=POSE, host="controller"), "host", "frame pose"),
        (request("z=force:5", "sensor", host="controller"), "host", "can hold base axes only"),
        (request("z=force:5 rx=torque:0", host="controller"), "host", "turns them away"),
    ],
)
def test_a_task_that_cannot_run_is_refused_by_name(asked, code, named) -> None:
    """With its axis, frame or limit; nothing starts."""
    bench = RegulatorBench(TWO_HOSTS)
    turned = pin.SE3(pin.utils.rotate("z", 0.4), np.zeros(3))
    bench.robot = bench.robot.replaced(**record_of(turned * T_START).as_dict())
    bench.pass_s(0.1)
    reply = bench.start(asked)
    assert (reply.accepted, reply.code) == (False, code)
    assert named in reply.text
    assert not bench.published().valid


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"setpoint": 2.0}, "control held has no set point"),
        ({"mass": 2.0}, "mass, damping and stiffness need control admittance or free"),
    ],
)
def test_contradictions_that_no_text_can_hold_are_refused_too(changes, named) -> None:
    """A program builds its task itself."""
    bench = RegulatorBench()
    bench.pass_s(0.1)
    task = parse_task("z=force:5")
    x, *others = task.axes
    asked = ForceStartRequest(task=task.replaced(axes=(x.replaced(**changes), *others)))
    reply = bench.start(asked)
    assert (reply.code, named in reply.text) == ("malformed", True)


def test_a_compliant_axis_needs_verified_axes() -> None:
    """A wrong sign cannot be distinguished from a hand."""
    bench = RegulatorBench()
    bench.wrench = bench.wrench.replaced(axes_checked=False)
    bench.pass_s(0.1)
    reply = bench.start(request("x=free"))
    assert (reply.code, "a compliant axis follows" in reply.text) == ("axes_unproved", True)


def test_the_target_holds_the_state_of_each_axis() -> None:
    """Of a task; a mode has none, and the mode of a task is what it controls."""
    bench = FollowingBench()
    bench.push((0.0, 0.0, 8.0))
    reply = bench.start(request("z=force:5 rx=admittance,stiffness=2", preset="gentle"))
    assert reply.accepted
    assert "frame tool, x=held y=held z=force:5" in reply.text
    bench.pass_s(0.1)
    target: RegulatorTarget = bench.published()
    assert (target.frame, target.mode, target.setpoint_N) == ("tool", "both", 5.0)
    assert [axis.control for axis in target.axes] == [
        "held", "held", "force", "admittance", "held", "held",
    ]  # fmt: skip
    assert target.axes[2].exerted == pytest.approx(8.0)
    assert bench.start(request("rx=torque:0")).accepted
    bench.pass_s(0.05)
    assert bench.published().mode == "orientation"
    assert bench.start(request("x=free")).accepted
    bench.pass_s(0.05)
    assert bench.published().mode == "position"
    assert bench.start(ForceStartRequest(mode="position")).accepted
    bench.pass_s(0.05)
    assert (bench.published().frame, bench.published().axes) == (None, ())


@pytest.mark.parametrize("frame", ["base", "tool", "sensor", "pose", "path"])
@pytest.mark.parametrize("law", ["plain", "adaptive"])
def test_a_change_of_frame_and_axes_makes_no_step(frame, law) -> None:
    """The commanded pose goes on from where it is, from each frame to each other one."""
    bench = FollowingBench()
    bench.push((2.0, -1.0, 8.0), (0.1, 0.0, -0.1))
    for axes in ("z=force:5", "x=held z=force:8 y=force:1 rz=torque:0.1", "rx=free y=free"):
        for name in (frame, "tool"):
            pose = POSE if name == "pose" else None
            assert bench.start(request(axes, name, law=law, pose=pose)).accepted
            bench.pass_s(0.2)
    most_m = CELL.force.speed_max_m_s * 0.004
    assert max(bench.steps_m) <= 1.001 * most_m
    assert max(bench.steps_rad) <= 1.001 * CELL.force.speed_max_rad_s * 0.004


def test_the_controller_gets_set_points_in_base_and_gains_of_free_axes() -> None:
    """A held axis has gain zero; while one is held it turns about the TCP."""
    bench = RegulatorBench(TWO_HOSTS)
    bench.push((1.0, 0.0, 8.0))
    bench.pass_s(0.1)
    asked = "z=force:-5 y=force:2 rx=torque:0.1 ry=torque:0"
    assert bench.start(request(asked, "base", host="controller")).accepted
    bench.pass_s(0.5)
    feedback = bench.published().feedback
    assert feedback is not None
    assert feedback.mode == "both"
    assert feedback.setpoint_force_N == pytest.approx((0.0, -2.0, 5.0))
    assert feedback.setpoint_torque_Nm == pytest.approx((-0.1, 0.0, 0.0))
    assert feedback.lever_m == (0.0, 0.0, 0.0)
    assert [gain > 0.0 for gain in feedback.gains.force_i_m_per_Ns] == [False, True, True]
    assert [gain > 0.0 for gain in feedback.gains.torque_i_rad_per_Nms] == [True, True, False]


def test_the_controller_runs_a_turned_frame_without_held_axes() -> None:
    """The set point is in base then; all gains are those of the cell."""
    bench = RegulatorBench(TWO_HOSTS)
    bench.push((0.0, 0.0, 8.0))
    bench.pass_s(0.1)
    asked = request("x=force:0 y=force:0 z=force:5", "sensor", host="controller")
    assert bench.start(asked).accepted
    bench.pass_s(0.5)
    feedback = bench.published().feedback
    assert feedback is not None
    assert np.linalg.norm(feedback.setpoint_force_N) == pytest.approx(5.0)
    assert feedback.gains == tune(CELL).gains


def test_frame_sensor_is_that_of_the_sensor_as_it_is_mounted() -> None:
    """The cell file's mounting with the rotation that the calibration has identified."""
    bench = FollowingBench()
    mounting_rad = (0.02, -0.03, 0.15)
    bench.wrench = bench.wrench.replaced(mounting_rotation_rad=mounting_rad)
    bench.push((8.0, 0.0, 0.0))
    assert bench.start(request("x=force:0 y=force:0 z=force:0", "sensor", preset="gentle")).accepted
    bench.pass_s(0.1)
    true_R = CELL.sensor.T_flange_sensor.pose.rotation @ pin.exp3(np.array(mounting_rad))
    R_base_sensor = pose_of(bench.robot).rotation @ true_R
    exerted = [axis.exerted for axis in bench.published().axes[:3]]
    assert exerted == pytest.approx((R_base_sensor.T @ [-8.0, 0.0, 0.0]).tolist(), abs=1e-3)


def test_the_deadband_of_a_spring_is_that_of_hand_guiding_at_rest() -> None:
    """It does not narrow in motion, unless the request has one of its own."""
    T = T_START
    for text, width in (("x=admittance,stiffness=9", CELL.force.idle_max_N), ("x=free", None)):
        task = request_task(request(text), T, CELL, mounting_rad=ZERO3)
        assert task.deadbands[0] == (width, None, None)
    task = request_task(
        request("x=admittance,stiffness=9,deadband=0.5"), T, CELL, mounting_rad=ZERO3
    )
    assert task.deadbands[0] == (0.5, None, None)


def test_gains_stay_where_nothing_of_a_kind_is_held_or_all_of_it() -> None:
    """The mode already says that a kind is not controlled."""
    gains = tune(CELL).gains
    for yields, turns in (((True,) * 3, (False,) * 3), ((False,) * 3, (True,) * 3)):
        assert held_gains(gains, AxisTask(yields, turns), IDENTITY) == gains


def test_a_set_point_begins_at_the_load_and_rises_on_a_ramp() -> None:
    """Towards the goal, never beyond it, and of the same sign; controlled axes continue."""
    goal = AxisTask((True,) * 3, (True,) * 3, (10.0, -10.0, 5.0), (0.5, 0.0, -0.5), IDENTITY, True)
    T = pin.SE3.Identity()
    first = first_setpoint(goal, (-4.0, -4.0, -9.0), (-9.0, 1.0, 0.2), T)
    assert first.force_N == (4.0, 0.0, 5.0)
    assert first.torque_Nm == (0.5, 0.0, -0.2)
    nearer = ramped(first, goal, 1.0)
    assert nearer.force_N == (5.0, -1.0, 5.0)
    assert nearer.torque_Nm == pytest.approx((0.5, 0.0, -0.3))
    held = replace(nearer, yields=(False, True, True), turns=(True, True, False))
    continued = next_setpoint(held, first)
    assert continued.force_N == (4.0, -1.0, 5.0)
    assert continued.torque_Nm == pytest.approx((0.5, 0.0, -0.2))


@pytest.mark.parametrize(("setpoint_N", "contact"), [(0.5, "free"), (0.7, "approach")])
def test_a_set_point_within_noise_is_not_searched_for(setpoint_N: float, contact: str) -> None:
    """A contact at it would count as lost whenever noise hides it, and end in a fast search."""
    bench = FollowingBench()
    assert bench.start(request(f"z=force:{setpoint_N}")).accepted
    bench.pass_s(0.1)
    assert bench.published().contact == contact


def test_a_torque_about_an_origin_begins_at_the_load_about_it() -> None:
    """A force through the origin is no load there, whatever its torque about the TCP."""
    goal = AxisTask(
        (True,) * 3, (True,) * 3, torque_Nm=(0.0, 2.0, 0.0),
        R_task=IDENTITY, in_base=True, origin_m=(0.1, 0.0, 0.0),
    )  # fmt: skip
    T = pin.SE3.Identity()
    through = first_setpoint(goal, (0.0, 0.0, -10.0), (0.0, 1.0, 0.0), T)
    beside = first_setpoint(goal, (0.0, 0.0, -10.0), (0.0, 0.0, 0.0), T)
    assert through.torque_Nm == pytest.approx((0.0, 0.0, 0.0))
    assert beside.torque_Nm == pytest.approx((0.0, 1.0, 0.0))


def test_the_frame_of_a_path_turns_with_it() -> None:
    """The lateral axis stays lateral; at the end of the path the frame keeps its direction."""
    bench = FollowingBench()
    bench.push((0.0, 0.0, 8.0))
    assert bench.start(request("z=force:8 y=force:0", "path", law="adaptive")).accepted
    bench.pass_s(0.1)
    begin = bench.p_tcp_m
    corner = begin + np.array([0.0, 0.01, 0.0])
    points_m = tuple(corner), tuple(corner + np.array([0.01, 0.0, 0.0]))
    path = PathRequest(points_m=points_m, speed_m_s=0.02)
    assert bench.ask(topics.FORCE_PATH, path).accepted
    bench.pass_s(0.3)
    R_path = np.array(task_frame(bench))
    assert R_path[:, 0] == pytest.approx([0.0, 1.0, 0.0], abs=0.05)
    bench.push((5.0, 0.0, 8.0))  # lateral: the tool yields, and the path goes along with it
    bench.pass_s(0.1)
    assert bench.p_tcp_m[0] - begin[0] > 1e-5
    bench.push((0.0, 0.0, 8.0))
    bench.pass_s(2.0)
    assert bench.published().path_left_m == pytest.approx(0.0, abs=1e-3)
    R_path = np.array(task_frame(bench))
    assert R_path[:, 0] == pytest.approx([1.0, 0.0, 0.0], abs=0.05)


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
