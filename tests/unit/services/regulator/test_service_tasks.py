"""Tasks per axis through the service: refusals, both loop hosts, changes, the frame of a path."""

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.motion.convert import pose_of, record_of, vec3
from forcemesh import topics
from forcemesh.force_task import parse_task
from forcemesh.messages import ZERO3, RegulatorTarget
from forcemesh.requests import ForceStartRequest, PathRequest
from services.regulator import admittance
from services.regulator.admittance import AdmittanceSettings
from services.regulator.axis_task import IDENTITY, AxisTask
from services.regulator.law import start_at
from services.regulator.task_request import first_setpoint, next_setpoint, ramped, request_task
from services.regulator.tcp_path import advance, path_along, tangent_frame
from tests.fakes.arbiter_world import T_START
from tests.fakes.bench import CELL
from tests.fakes.law_input import mode_input
from tests.fakes.regulator_bench import BOTH_HOSTS, PERIOD_S, FollowingBench, RegulatorBench
from tuning.gain_rule import tune

POSE = record_of(pin.SE3(pin.utils.rotate("z", 0.5), np.array([0.4, 0.0, 0.2])))


def request(text: str, frame: Any = "tool", **others: Any) -> ForceStartRequest:
    """Return the request of a task."""
    pose = others.pop("pose", None)
    return ForceStartRequest(task=parse_task(text, frame, pose), **others)


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


def test_the_controller_gets_set_points_in_base_and_gains_of_free_axes() -> None:
    """A held axis has gain zero; while one is held it turns about the TCP."""
    bench = RegulatorBench(BOTH_HOSTS)
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


# --- hand guiding -------------------------------------------------------------------------------

SETTINGS = AdmittanceSettings.of(CELL)
PRESS = ForceStartRequest(mode="position", setpoint_N=5.0, axes=(False, False, True) * 2)
SPEED = CELL.force.speed_max_m_s
coordinates = st.floats(-0.05, 0.05).map(lambda x: round(x, 4))
points = st.lists(st.tuples(*[coordinates] * 3).map(np.array), min_size=1, max_size=6)


# --- hand guiding ---------------------------------------------------------------------------------


def guided(force_N, seconds: float, share: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Return the travel and the last speed under a force of each period, in base axes."""
    law, memory = start_at(T_START), admittance.begin(T_START, T_START, None, SETTINGS)
    before = T_START.translation
    for number in range(round(seconds / PERIOD_S)):
        force = vec3(np.array(force_N(number * PERIOD_S)))
        sample = mode_input(force, motion=law, gain_share=share)
        before = law.T_base_tcp.translation
        memory, law = admittance.step(memory, sample, SETTINGS)
    speed = (law.T_base_tcp.translation - before) / PERIOD_S
    return law.T_base_tcp.translation - T_START.translation, speed


@settings(max_examples=8)
@given(st.tuples(*[st.floats(-1.0, 1.0)] * 3), st.floats(0.0, 1.0))
def test_a_residual_force_never_moves_a_tool_without_a_hand(direction, share) -> None:
    """With the largest bias that the preflight accepts nothing moves; after a push it stops."""
    length = max(float(np.linalg.norm(direction)), 1e-9)
    bias_N = np.array(direction) / length * CELL.force.idle_max_N * share * 0.999
    assert np.linalg.norm(guided(lambda _: bias_N, 0.5)[0]) < 1e-12
    after_push = guided(
        lambda t: bias_N + (20.0 if t < 0.2 else 0.0) * np.array(direction) / length, 4.0
    )
    assert np.linalg.norm(after_push[1]) < 1e-4


def test_it_yields_more_to_a_hand_than_the_gain_rule_and_never_too_fast() -> None:
    """At 10 N several times the plain law's speed; at 100 N the cell's speed limit."""
    _, speed = guided(lambda _: (0.0, 10.0, 0.0), 1.0)
    assert speed[1] > 3.0 * tune(CELL).force_i_m_per_Ns * 10.0 or speed[1] >= 0.99 * SPEED
    _, fastest = guided(lambda _: (60.0, 80.0, 0.0), 1.0)
    assert np.linalg.norm(fastest) == pytest.approx(SPEED, rel=1e-6)
    assert fastest[1] / fastest[0] == pytest.approx(80.0 / 60.0, rel=1e-6)


def test_a_gain_share_damps_it_more() -> None:
    """A hand that pushes steadily moves the tool more slowly."""
    speeds = [guided(lambda _: (8.0, 0.0, 0.0), 2.0, share)[1][0] for share in (1.0, 0.5, 0.25)]
    assert speeds[0] > speeds[1] > speeds[2] > 0.0
    assert speeds[2] < 0.6 * speeds[0]


@pytest.mark.parametrize("stiffness_N_m", [2e3, 2e4])
def test_a_contact_stiffer_than_a_hand_is_damped_at_once(stiffness_N_m: float) -> None:
    """Pushed with 10 N into a wall through the loop's delay: it comes to rest without bouncing."""
    late = round((CELL.loop_delay_s - CELL.filter.lowpass_s) / PERIOD_S)
    law, memory = start_at(T_START), admittance.begin(T_START, T_START, None, SETTINGS)
    places = [T_START.copy()] * (late + 1)
    forces = []
    for number in range(800):
        deep_m = max(0.0, float(T_START.translation[2] - 0.002 - places[0].translation[2]))
        forces.append(stiffness_N_m * deep_m)
        force_N = (0.0, 0.0, forces[-1] - (10.0 if number < 600 else 0.0))
        sample = mode_input(force_N, motion=law, T_measured=places[0])
        memory, law = admittance.step(memory, sample, SETTINGS)
        places = [*places[1:], law.T_base_tcp]
    resting = np.array(forces[400:600])
    assert resting.std() < 0.5
    assert resting.mean() == pytest.approx(10.0, abs=SETTINGS.plain.deadband_N + 0.5)


# --- a path ---------------------------------------------------------------------------------------


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
