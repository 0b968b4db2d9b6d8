"""Refusals of a start or a path: the reason, and no change of the present operation."""

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from common.motion.convert import record_of
from forcemesh import topics
from forcemesh.force_task import parse_task
from forcemesh.messages import ArbiterStatus
from forcemesh.requests import ForceStartRequest, PathRequest
from services.regulator.path_request import MOST_PATH_POINTS
from tests.fakes.arbiter_world import T_START
from tests.fakes.bench import CELL
from tests.fakes.regulator_bench import (
    BOTH_HOSTS,
    POSITION,
    T_FLANGE_TCP,
    RegulatorBench,
    assert_stopped,
)

T_TURNED = pin.SE3(pin.utils.rotate("z", 0.4), np.zeros(3)) * T_START  # no axis is one of base
T_TCP = T_TURNED * T_FLANGE_TCP
FRAME = record_of(pin.SE3(pin.utils.rotate("z", 0.5), np.array([0.4, 0.0, 0.2])))
X_ONLY, Z_ONLY = (True, False, False, False, False, False), (False, False, True) * 2
Z_HELD, RZ_HELD = (True, True, False, True, True, True), (True,) * 5 + (False,)


@pytest.fixture
def bench() -> RegulatorBench:
    """Return an armed cell whose controller supports force feedback; nothing is started."""
    bench = RegulatorBench(BOTH_HOSTS)
    bench.robot = bench.robot.replaced(**record_of(T_TURNED).as_dict())
    bench.pass_s(0.1)
    return bench


# --- a start --------------------------------------------------------------------------------------


def start(**fields: Any) -> ForceStartRequest:
    """Return a start request."""
    return ForceStartRequest.from_dict(fields)


def task(text: str, frame: Any = "tool", **others: Any) -> ForceStartRequest:
    """Return the request of a task."""
    return ForceStartRequest(task=parse_task(text, frame, others.pop("pose", None)), **others)


def built(**changes: Any) -> ForceStartRequest:
    """Return the request of a task whose x axis no text describes: a program builds it."""
    whole = parse_task("z=force:5")
    x, *others = whole.axes
    return ForceStartRequest(task=whole.replaced(axes=(x.replaced(**changes), *others)))


STARTS = [
    (start(law="iron"), "malformed", "law: must be plain or adaptive, found 'iron'"),
    (start(host="controller", axes=RZ_HELD), "host", "axes: host controller cannot lock"),
    (start(setpoint_N=5.0, axes=X_ONLY), "axes", "(x, frame base) exclude it"),
    (start(setpoint_N=5.0, axes=X_ONLY, frame="tool", mode="both"), "axes", "set point of 5 N"),
    (start(setpoint_N=5.0, axes=Z_HELD, law="adaptive"), "axes", "x,y,rx,ry,rz"),
    (task("z=force:5", setpoint_N=5.0), "malformed", "belong to the axes of the task"),
    (task("z=force:5", axes=(False,) * 6), "malformed", "belong to the axes of the task"),
    (task("z=force:5", "pose"), "malformed", "frame pose needs the pose"),
    (task("z=force:5", "base", pose=FRAME), "malformed", "the others have none"),
    (task("x=compliant", "path"), "malformed", "x of frame path"),
    (built(setpoint=2.0), "malformed", "control held has no set point"),
    (built(mass=2.0), "malformed", "mass, damping and stiffness need control compliant"),
    (task("z=force:5 x=held,deviation=2"), "malformed", "control held has no deviation_max"),
    (task("z=force:39 x=force:39"), "setpoint", "force.setpoint_max_N"),
    (task("rz=torque:9e3"), "setpoint", "torque set point"),
    (task("z=compliant", host="controller"), "host", "axis z: host controller has no control"),
    (task("z=force:5,speed=9", host="controller"), "host", "has no speed_max for single"),
    (task("z=force:5", "path", host="controller"), "host", "cannot follow a path"),
    (task("z=force:5", "pose", pose=FRAME, host="controller"), "host", "frame pose"),
    (task("z=force:5", "sensor", host="controller"), "host", "can hold base axes only"),
    (task("z=force:5 rx=torque:0", host="controller"), "host", "turns them away"),
]


@pytest.mark.parametrize(("asked", "code", "text"), STARTS)
def test_a_start_that_cannot_run_is_refused_by_name(bench, asked, code, text) -> None:
    """Nothing starts, and what runs goes on."""
    reply = bench.start(asked)
    assert (reply.accepted, reply.code) == (False, code)
    assert text in reply.text
    bench.step()
    assert_stopped(bench, "stopped")
    assert bench.start(POSITION).accepted
    assert bench.start(asked).code == code
    bench.step()
    assert (bench.published().mode, bench.published().setpoint_N) == ("position", 0.0)


@pytest.mark.parametrize(
    "asked",
    [
        start(axes=RZ_HELD),
        start(axes=X_ONLY),
        start(axes=Z_HELD, mode="orientation", setpoint_N=5.0),  # its set point is not used
        start(setpoint_N=CELL.force.setpoint_max_N),
        task("x=force:0 y=force:0 z=force:5", "sensor", host="controller"),  # no axis is held
        task("rx=compliant"),
    ],
)
def test_what_comes_close_to_a_refusal_is_accepted(bench: RegulatorBench, asked: Any) -> None:
    """On the PC, at set point 0, without a press, and at the limit itself."""
    assert bench.start(asked).accepted


def test_a_set_point_above_the_cells_is_refused_with_both_numbers(bench: RegulatorBench) -> None:
    """Value and limit are in the reply."""
    limit_N = CELL.force.setpoint_max_N
    reply = bench.start(start(setpoint_N=limit_N + 0.1))
    assert (reply.code, reply.value, reply.limit) == ("setpoint", limit_N + 0.1, limit_N)


def test_an_unavailable_host_is_refused() -> None:
    """The refusal names the available hosts."""
    bench = RegulatorBench()
    bench.pass_s(0.1)
    reply = bench.start(start(host="controller"))
    assert (reply.code, "offers pc" in reply.text) == ("host", True)


@pytest.mark.parametrize(
    ("status", "code", "text"),
    [
        ({"state": "BOOT"}, "not_armed", "the arbiter is BOOT: arm first"),
        ({"state": "IDLE"}, "not_armed", "the arbiter is IDLE: arm first"),
        ({"state": "HOLDING"}, "not_armed", "the arbiter is HOLDING: arm first"),
        ({"state": "FAULT"}, "not_armed", "the arbiter is FAULT: arm first"),
        ({"armed_for": "jog"}, "not_armed", "armed for jog alone: hold, then arm for all"),
        ({"armed_for": "back_off"}, "not_armed", "armed for backing off alone"),
        ({"state": "ACTIVE", "commander": "operator"}, "busy", "the operator commands the arm"),
    ],
)
def test_a_start_needs_an_arbiter_that_permits_it(bench, status, code, text) -> None:
    """Armed for all, and without a move that a start would make jump."""
    bench.arbiter = ArbiterStatus.from_dict({"state": "ARMED", "lease": 3} | status)
    bench.step()
    reply = bench.start()
    assert (reply.accepted, reply.code) == (False, code)
    assert text in reply.text


@pytest.mark.parametrize(
    ("topic", "code", "text"),
    [
        (topics.WRENCH, "stale", "wrench stale"),
        (topics.ROBOT_STATE, "stale", "robot/state stale"),
        (topics.ARBITER_STATUS, "not_armed", "the arbiter is silent"),
    ],
)
def test_a_start_needs_fresh_inputs(bench: RegulatorBench, topic, code, text) -> None:
    """The refusal names the stale input."""
    bench.silent = {topic.key}
    bench.pass_s(CELL.stale_after_s(topic) + 0.1)
    reply = bench.start()
    assert (reply.accepted, reply.code) == (False, code)
    assert text in reply.text


def test_no_force_control_starts_with_axes_that_are_not_checked(bench: RegulatorBench) -> None:
    """Another calibration may be in use since the arm was armed; a turn needs the torques, too."""
    bench.wrench = bench.wrench.replaced(torques_checked=False, calibration="5eed")
    bench.step()
    for asked in (start(mode="both"), task("rx=compliant"), task("rz=torque:0.1")):
        reply = bench.start(asked)
        assert (reply.accepted, reply.code) == (False, "axes_unproved")
        assert "the torques are not checked with calibration 5eed" in reply.text
    assert bench.start(POSITION).accepted
    bench.wrench = bench.wrench.replaced(axes_checked=False)
    bench.step()
    reply = bench.start(POSITION)
    assert (reply.accepted, reply.code) == (False, "axes_unproved")
    assert "the sensor are not checked with calibration 5eed" in reply.text


# --- a path ---------------------------------------------------------------------------------------


def point(x_m: float, z_m: float = 0.0) -> tuple[float, float, float]:
    """Return a point at an offset from the tool."""
    x, y, z = (T_TCP.translation + np.array([x_m, 0.0, z_m])).tolist()
    return (x, y, z)


PRESS = start(setpoint_N=5.0, axes=Z_ONLY, frame="tool")
FREE, ADAPTIVE = start(setpoint_N=5.0), PRESS.replaced(law="adaptive")
NEAR, FAR = record_of(T_TCP).replaced(position_m=point(0.01)), point(1.0)
TURNED = record_of(T_TCP * pin.SE3(pin.utils.rotate("x", 2.0), np.zeros(3)))
POINTS = PathRequest(points_m=(point(0.01),))
PATHS = [
    (start(host="controller"), [], POINTS, "host", "host controller cannot follow a path"),
    (ADAPTIVE.replaced(axes=(True, False, True) * 2), [], POINTS, "axes", "an external push"),
    (
        ADAPTIVE.replaced(frame="base", axes=(False, True, True) * 2),
        [],
        POINTS,
        "axes",
        "frame tool",
    ),
    (PRESS, [], POINTS.replaced(speed_m_s=0.2), "setpoint", "above force.speed_max_m_s"),
    (PRESS, [], POINTS.replaced(points_m=(point(0.01, -5.0), FAR)), "workspace", "point 2: "),
    (PRESS, [], PathRequest(poses=(NEAR, NEAR.replaced(position_m=FAR))), "workspace", "point 2: "),
    (PRESS, [], PathRequest(poses=(NEAR, TURNED)), "setpoint", "pose 2 is turned by 115 degrees"),
    (PRESS, [], POINTS.replaced(poses=(NEAR,)), "setpoint", "points or poses, not both"),
    (PRESS, [POINTS], PathRequest(poses=(NEAR,), append=True), "setpoint", "a path of points"),
    (FREE, [], PathRequest(poses=(NEAR,)), "axes", "the force controls every axis"),
]


@pytest.mark.parametrize(("asked", "before", "path", "code", "text"), PATHS)
def test_a_path_that_cannot_be_followed_is_refused_by_name(
    bench: RegulatorBench, asked: Any, before: Any, path: PathRequest, code: str, text: str
) -> None:
    """Each with what is wrong, and what is left of the path stays; a stop is always accepted."""
    assert bench.ask(topics.FORCE_PATH, path).code == "not_armed"
    assert bench.start(asked).accepted
    for each in before:
        assert bench.ask(topics.FORCE_PATH, each).accepted
    left_m = bench.published().path_left_m
    reply = bench.ask(topics.FORCE_PATH, path)
    assert (reply.accepted, reply.code) == (False, code)
    assert text in reply.text
    assert bench.published().path_left_m == left_m
    if code != "host":
        assert bench.ask(topics.FORCE_PATH, PathRequest()).accepted


def test_points_are_refused_after_the_regulator_stopped(bench: RegulatorBench) -> None:
    """A latched failure follows no path."""
    assert bench.start(POSITION).accepted
    bench.silent = {topics.WRENCH.key}
    bench.pass_s(0.2)
    assert not bench.published().valid
    assert bench.ask(topics.FORCE_PATH, POINTS).code == "not_armed"


@pytest.mark.parametrize("kind", ["points_m", "poses"])
def test_the_number_of_pending_points_is_limited(bench: RegulatorBench, kind: str) -> None:
    """The last one fits, the next one is refused with both numbers; a replacement is accepted."""
    assert bench.start(PRESS).accepted
    places = [point(1e-4 * number) for number in range(1, 31)]
    if kind == "points_m":
        more = PathRequest(points_m=tuple(places), append=True)
    else:
        poses = tuple(NEAR.replaced(position_m=place) for place in places)
        more = PathRequest(poses=poses, append=True)
    for _ in range(MOST_PATH_POINTS // 30):
        assert bench.ask(topics.FORCE_PATH, more).accepted
    reply = bench.ask(topics.FORCE_PATH, more)
    assert (reply.code, reply.value, reply.limit) == ("busy", MOST_PATH_POINTS + 30, 600)
    assert bench.ask(topics.FORCE_PATH, more.replaced(append=False)).accepted
