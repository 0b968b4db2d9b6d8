"""Task frame and axes of one period: what is held does not move, limits and a centre of rotation.

Set points, springs and held axes of whole tasks: tests/scenario/test_force_axes.py.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.motion.convert import pose_of, record_of, vec3
from common.motion.frames import cross, plus, rotated, rotation_from_vector
from control.axis_task import (
    ALL,
    CELLS,
    IDENTITY,
    NONE,
    AxisTask,
    VirtualMass,
    mode_task,
)
from control.compliance import ComplianceState
from control.gain_rule import tune
from control.law import LawInput, LawMotion, start_at
from control.laws import LAWS, ControlSettings, advance
from control.monitors import MonitorSample
from forcemesh.force_task import GUIDED, parse_task
from forcemesh.messages import ZERO3, RegulatorTarget
from forcemesh.requests import ForceStartRequest
from services.regulator.task_request import first_setpoint, next_setpoint, ramped, request_task
from tests.fakes.arbiter_world import T_START
from tests.fakes.bench import CELL
from tests.fakes.law_input import DT_S, GAINS, START
from tests.fakes.regulator_bench import BOTH_HOSTS, FollowingBench, RegulatorBench

SETTINGS = ControlSettings.of(CELL, LAWS["plain"])
TORSION = VirtualMass(stiffness=10.0)
vectors = st.tuples(*[st.floats(-30.0, 30.0)] * 3)
turns = st.tuples(*[st.floats(-2.0, 2.0)] * 3)
flags = st.tuples(*[st.booleans()] * 3)


def rows_of(turn):
    """Return a rotation matrix by rows."""
    return rotation_from_vector(np.array(turn)).tolist()


def sample_of(task, force_N=ZERO3, torque_Nm=ZERO3, contact="contact"):
    """Return one sample of a tool that is already in contact."""
    motion = replace(start_at(START), contact=contact)
    return LawInput(force_N, torque_Nm, task, DT_S, GAINS, motion, START)


def commanded(sample: LawInput, state: ComplianceState | None = None) -> LawMotion:
    """Return the motion after a sample, of the plain law and of compliant axes."""
    state = state or ComplianceState.at(sample.task, START, START)
    return advance(None, state, sample, SETTINGS)[1]


def pushed(task: AxisTask, force_tool_N=ZERO3, torque_tool_Nm=ZERO3, periods=400):
    """Return the state and the last motion under a constant load in tool axes."""
    state, motion = ComplianceState.at(task, START, START), start_at(START)
    sample = sample_of(task)
    for _ in range(periods):
        R = motion.T_base_tcp.rotation
        force_N, torque_Nm = tuple(R @ force_tool_N), tuple(R @ torque_tool_Nm)
        sample = LawInput(force_N, torque_Nm, task, DT_S, GAINS, motion, motion.T_base_tcp)
        motion = commanded(sample, state)
    return state, motion, sample


@given(turns, flags, flags, vectors, vectors, vectors, st.sampled_from(["free", "contact"]))
def test_held_axes_of_any_frame_do_not_move(
    turn, yields, may_turn, force_N, torque_Nm, push_N, contact
):
    """Along and about them, for any force, torque and set point, in approach, contact and loss."""
    R = rows_of(turn)
    task = AxisTask(
        yields, may_turn, tuple(np.array(push_N) * yields), ZERO3, R_task=R, in_base=True
    )
    after = commanded(sample_of(task, force_N, torque_Nm, contact))
    moved_m = np.array(R).T @ (after.T_base_tcp.translation - START.translation)
    assert np.abs(moved_m[~np.array(yields)]).max(initial=0.0) < 1e-12


@given(turns, st.floats(0.0, 1.0))
def test_the_law_uses_deadbands_of_single_axes(turn, band) -> None:
    """Along and about axes of any frame; the errors are published beyond them."""
    R = rows_of(turn)
    bands = ((band, band, band), (band, band, band))
    task = AxisTask(ALL, ALL, ZERO3, R_task=R, in_base=True, deadbands=bands)
    load = tuple(rotated(R, (3.0, 0.0, 0.0)))
    after = commanded(sample_of(task, load, load))
    for error in (after.error_force_N, after.error_torque_Nm):
        assert np.array(R).T @ error == pytest.approx([3.0 - band, 0.0, 0.0], abs=1e-9)


@given(vectors, vectors)
def test_a_frame_with_an_origin_turns_the_tool_about_it(force_N, offset_mm) -> None:
    """The torque is the one about the origin, and the TCP moves on an arc."""
    offset_m = tuple(1e-3 * np.array(offset_mm))
    origin_m = tuple(START.translation - offset_m)
    task = AxisTask(NONE, ALL, in_base=True, R_task=rows_of(ZERO3), origin_m=origin_m)
    sample = sample_of(task, force_N, (0.5, -0.3, 0.2))
    after = commanded(sample)
    torque_Nm = plus((0.5, -0.3, 0.2), cross(offset_m, force_N))
    assert sample.task_torque_Nm() == pytest.approx(torque_Nm, abs=1e-9)
    turn = after.T_base_tcp.rotation @ START.rotation.T
    moved_m = after.T_base_tcp.translation - START.translation
    assert moved_m == pytest.approx(turn @ offset_m - offset_m, abs=1e-6)


def test_an_axis_moves_no_faster_than_its_own_limit() -> None:
    """A hand that keeps pushing moves it at that speed: a compliant one, and one under force."""
    limits = ((0.005, 0.005, None), None)
    task = AxisTask((False, True, True), compliant_along=(VirtualMass(), None, None), speeds=limits)
    _, motion, _ = pushed(task, (30.0, 30.0, 30.0), periods=250)
    moved_m = START.rotation.T @ (motion.T_base_tcp.translation - START.translation)
    assert 0.003 < moved_m[:2].min() < moved_m[:2].max() <= 0.005 * 1.0 + 1e-9 < moved_m[2]


@settings(max_examples=25)
@given(st.tuples(*[st.floats(-40.0, 40.0)] * 3), st.tuples(*[st.floats(-2.0, 2.0)] * 3))
def test_no_axis_moves_beyond_its_deviation_or_faster_than_the_cell_permits(
    force_N, torque_Nm
) -> None:
    """Neither by force control nor by compliance, and its state says so at the limit."""
    limits = ((0.002, 0.001, None), (0.01, None, 0.02))
    task = AxisTask(
        (True, False, False),
        (False, False, True),
        compliant_along=(None, VirtualMass(), VirtualMass()),
        compliant_about=(TORSION, None, None),
        deviations=limits,
    )
    state, motion, sample = pushed(task, force_N, torque_Nm)
    away_m, away_rad = state.deviation(motion.T_base_tcp, sample)
    rows = zip((*away_m, *away_rad), (*limits[0], *limits[1]), state.at_limit, strict=True)
    for away, limit, at_limit in rows:
        assert limit is None or abs(away) <= limit + 1e-6
        assert not at_limit or (limit is not None and abs(away) > 0.99 * limit)
    if abs(torque_Nm[2]) > 1.0:
        assert state.at_limit[5]


def test_the_reference_moves_with_a_path_and_stays_for_the_same_axes() -> None:
    """A changed set point keeps it; other compliant axes begin where they are."""
    spring = VirtualMass(stiffness=1000.0)
    task = AxisTask(NONE, compliant_along=(spring, None, None))
    state = ComplianceState.at(task, START, START)
    state.move(((0.0, 0.01, 0.0), (0.0, 0.0, 0.0)))
    assert state.T_reference.translation - START.translation == pytest.approx([0.0, 0.01, 0.0])
    assert state.covers(replace(task, force_N=(0.0, 0.0, 5.0)))
    assert not state.covers(replace(task, compliant_along=(None, spring, None)))
    assert not state.covers(replace(task, deviations=((0.1, None, None), CELLS)))


@pytest.mark.parametrize("mode", ["position", "orientation", "both"])
def test_a_mode_is_a_row_of_axes(mode) -> None:
    """With all axes free in tool axes; with a mask in base, the press is along base axes."""
    task = mode_task(mode, 10.0)
    moves, may_turn = mode != "orientation", mode != "position"
    assert (task.force_along, task.torque_about) == ((moves,) * 3, (may_turn,) * 3)
    assert (task.force_N, task.R_task) == ((0.0, 0.0, 10.0 * moves), None)
    only_z = (False, False, True) * 2
    task = mode_task(mode, 10.0, axes=only_z, in_base=True, press_axis=(0.6, 0.0, -0.8))
    assert task.in_base
    assert task.force_N == pytest.approx((0.0, 0.0, -8.0 * moves))


# --- tasks through the service ------------------------------------------------------------------

POSE = record_of(pin.SE3(pin.utils.rotate("z", 0.5), np.array([0.4, 0.0, 0.2])))


def request(text: str, frame: Any = "tool", **others: Any) -> ForceStartRequest:
    """Return the request of a task."""
    pose = others.pop("pose", None)
    return ForceStartRequest(task=parse_task(text, frame, pose), **others)


def test_the_target_holds_the_state_of_each_axis() -> None:
    """Of a task; a mode has none, and the mode of a task is what it controls."""
    bench = FollowingBench()
    bench.push((0.0, 0.0, 8.0))
    reply = bench.start(request("z=force:5 rx=compliant,stiffness=2", preset="gentle"))
    assert reply.accepted
    assert "frame tool, x=held y=held z=force:5" in reply.text
    bench.pass_s(0.1)
    target: RegulatorTarget = bench.published()
    assert (target.frame, target.mode, target.setpoint_N) == ("tool", "both", 5.0)
    assert [axis.control for axis in target.axes] == [
        "held", "held", "force", "compliant", "held", "held",
    ]  # fmt: skip
    assert target.axes[2].exerted == pytest.approx(8.0)
    assert bench.start(request("rx=torque:0")).accepted
    bench.pass_s(0.05)
    assert bench.published().mode == "orientation"
    assert bench.start(request("x=compliant")).accepted
    bench.pass_s(0.05)
    assert bench.published().mode == "position"
    assert bench.start(ForceStartRequest(mode="position")).accepted
    bench.pass_s(0.05)
    assert (bench.published().frame, bench.published().axes) == (None, ())


def test_the_controller_gets_set_points_in_base_and_gains_of_free_axes() -> None:
    """A held axis has gain zero; while one is held it turns about the TCP."""
    bench = RegulatorBench(BOTH_HOSTS)
    bench.push((1.0, 0.0, 8.0), (0.2, 0.1, 0.0))
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


@pytest.mark.parametrize(
    ("stiffness", "band_N", "load_N", "pulled_N"),
    [
        (1000.0, None, 12.0, 12.0 - CELL.force.idle_max_N),
        (1000.0, 0.5, 12.0, 11.5),
        (1000.0, None, CELL.force.idle_max_N, 0.0),
    ],
)
def test_the_deadband_of_a_spring_is_that_of_hand_guiding_at_rest(
    stiffness: float, band_N: float | None, load_N: float, pulled_N: float
) -> None:
    """It does not narrow in motion, unless the request has one of its own."""
    task = AxisTask(
        NONE,
        compliant_along=(VirtualMass(stiffness=stiffness), None, None),
        deadbands=((band_N, None, None), CELLS),
    )
    state, motion, sample = pushed(task, (load_N, 0.0, 0.0), periods=4000)
    away_m = state.deviation(motion.T_base_tcp, sample)[0][0]
    assert away_m == pytest.approx(pulled_N / stiffness, abs=1e-5)


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
    held = replace(nearer, force_along=(False, True, True), torque_about=(True, True, False))
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


# --- hand guiding -------------------------------------------------------------------------------

GUIDING = AxisTask(NONE, compliant_along=(VirtualMass(),) * 3)
SPEED = CELL.force.speed_max_m_s


class Guiding:
    """Hand guiding from rest; a step gives the next pose of the TCP."""

    def __init__(self, share: float = 1.0) -> None:
        """Start at rest; a share lowers the gains."""
        self.motion, self.share = start_at(T_START), share
        self.state = ComplianceState.at(GUIDING, T_START, T_START)

    def step(self, force_N: np.ndarray, T_measured: pin.SE3 | None = None) -> pin.SE3:
        """Return the next command under a force in base axes."""
        sample = LawInput(
            vec3(force_N), ZERO3, GUIDING, DT_S, GAINS, self.motion,
            T_measured or self.motion.T_base_tcp,
            gain_share=self.share,
        )  # fmt: skip
        self.motion = commanded(sample, self.state)
        return self.motion.T_base_tcp


def guided(force_N, seconds: float, share: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Return the travel and the last speed under a force of each period, in base axes."""
    guiding = Guiding(share)
    places = [
        guiding.step(np.array(force_N(number * DT_S))).translation
        for number in range(round(seconds / DT_S))
    ]
    return places[-1] - T_START.translation, (places[-1] - places[-2]) / DT_S


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
    late = round((CELL.plant.tau_s - CELL.filter.lowpass_s) / DT_S)
    guiding, places, forces = Guiding(), [T_START.copy()] * (late + 1), []
    for number in range(800):
        deep_m = max(0.0, float(T_START.translation[2] - 0.002 - places[0].translation[2]))
        forces.append(stiffness_N_m * deep_m)
        hand_N = 10.0 if number < 600 else 0.0
        T_next = guiding.step(np.array([0.0, 0.0, forces[-1] - hand_N]), places[0])
        places = [*places[1:], T_next]
    resting = np.array(forces[400:600])
    assert resting.std() < 0.5
    assert resting.mean() == pytest.approx(10.0, abs=SETTINGS.compliance.deadband_N + 0.5)


def test_a_person_may_push_a_tool_that_turns_freely_back() -> None:
    """Its work is no fault of the sensor."""
    for text, is_passive in (("z=force:5 rx=compliant", False), ("z=force:5 rx=torque:0", True)):
        task = request_task(request(text), T_START, CELL, mounting_rad=ZERO3)
        assert MonitorSample.of(sample_of(task), start_at(START)).side_trips == is_passive


LIMITED_TURN = GUIDED["position"] + " rx=compliant ry=compliant rz=compliant,deviation=0.2"
WITH_FORCE = "x=compliant y=force:0 z=compliant rx=compliant ry=compliant rz=compliant"


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(
    ("text", "stiffness_N_m", "lever_m"),
    [
        (GUIDED["both"], 5e3, 0.2),
        (GUIDED["both"], 2e4, 0.1),
        (LIMITED_TURN, 2e4, 0.1),
        (GUIDED["both"].replace("x=compliant", "x=compliant,deviation=2"), 2e4, 0.1),
        (WITH_FORCE, 2e4, 0.1),
        ("x=force:0 y=force:0 z=force:0 rx=held ry=held rz=torque:0,deviation=0.2", 2e4, 0.1),
    ],
)
def test_a_tool_that_is_guided_and_turned_rests_on_what_its_edge_touches(
    text: str, stiffness_N_m: float, lever_m: float, law: str
) -> None:
    """Found: a turn about the TCP moved the edge as well, and it bounced without coming to rest.

    And at the limit of its turn the tool drove itself into what it touched.
    """
    bench, forces_N = FollowingBench(), []
    T_begin, late = bench.poses[0], round(CELL.plant.tau_s / DT_S)
    edge_m = np.array([0.0, lever_m, 0.0])
    assert bench.start(request(text, law=law)).accepted
    bench.pass_s(0.1)
    for _ in range(600):
        T = bench.poses[max(0, len(bench.poses) - 1 - late)]
        deep_m = max(0.0, float(T_begin.actInv(T).act(edge_m)[0]) - 0.003)
        forces_N.append(stiffness_N_m * deep_m)
        force_N = T_begin.rotation @ [12.0 - forces_N[-1], 0.0, 0.0]  # a hand with 12 N
        bench.push(vec3(force_N), vec3(np.cross(T.rotation @ edge_m, force_N)))
        bench.step()
    assert bench.published().valid
    assert np.std(forces_N[400:]) < 0.5
    assert 5.0 < np.mean(forces_N[400:]) < 13.0
