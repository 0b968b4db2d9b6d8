"""The program that ships, executed: force feedback, and segments that a planner can bear."""

import random

import numpy as np
import pinocchio as pin
import pytest

from common.motion.frames import rotation_between
from controller.packet import VecInt
from controller.packet_table import CentreParam, Com, Status
from sim.controller.behaviour import Behaviour, pessimistic
from tests.fakes.controller import QUICK
from tests.fakes.controller_talk import LIMITS, SEGMENT, TEXT, Talk, push

TCP_MM = np.array([0.0, 0.0, 160.0])
AT_TCP: VecInt = (0, 0, 8000, 0, 0, 0)
TURN_X: VecInt = (0, 0, 0, 1000, 0, 0)


def running(
    mode: int,
    *,
    gains_p: VecInt = (0,) * 6,
    gains_i: VecInt = (0,) * 6,
    limits: VecInt = LIMITS,
    behaviour: Behaviour = QUICK,
) -> Talk:
    """Force feedback runs, about a TCP 160 mm below the flange, with one zero wrench received."""
    talk = Talk(behaviour)
    talk.hello(limits=limits)
    talk.send(Com.TCP, CentreParam.CENTRE, AT_TCP)
    talk.start_feedback(mode, gains_p=gains_p, gains_i=gains_i)
    push(talk, 2)
    return talk


def tcp_mm(T: pin.SE3) -> np.ndarray:
    """Return the position of the TCP."""
    return np.array(T.act(TCP_MM))


# --- the law --------------------------------------------------------------------------------------


def test_a_long_turn_about_a_slanted_axis_stays_about_that_axis() -> None:
    """Rotations are composed: 20 degrees about (1, 1, 1) and back end where they began."""
    talk = running(2, gains_i=(0, 0, 0, 20_000, 20_000, 20_000))
    start = talk.T_mm
    push(talk, 170, (0, 0, 0, 1700, 1700, 1700))
    turned = np.degrees(rotation_between(start.rotation, talk.T_mm.rotation))
    assert np.linalg.norm(turned) > 20.0
    assert np.allclose(turned / np.linalg.norm(turned), np.ones(3) / 3**0.5, atol=0.01)
    assert np.allclose(tcp_mm(talk.T_mm), tcp_mm(start), atol=0.05)
    push(talk, 170, (0, 0, 0, -1700, -1700, -1700))
    push(talk, 10)
    left = np.degrees(rotation_between(start.rotation, talk.T_mm.rotation))
    assert (
        np.linalg.norm(left) < 1.0
    )  # four iterations of 0.24 degrees, of 340; which ones is chance


@pytest.mark.parametrize(
    "behaviour", [Behaviour(step_s=4e-4), pessimistic(QUICK.step_s)], ids=["slow", "pessimistic"]
)
def test_the_law_does_not_depend_on_the_speed_of_the_controller(behaviour: Behaviour) -> None:
    """The integral goes over the time that passed, coarse as TIMER may be."""
    talk = running(1, gains_i=(0, 0, 1000, 0, 0, 0), behaviour=behaviour)
    for _ in range(5):
        talk.send(Com.WRENCH, 0, (0, 0, 1000, 0, 0, 0))
        talk.live(0.1)
    z = talk.height_mm()
    for _ in range(20):
        talk.send(Com.WRENCH, 0, (0, 0, 1000, 0, 0, 0))
        talk.live(0.1)
    assert talk.height_mm() - z == pytest.approx(4.0, abs=0.3)


# --- limits ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", [1, 2, 3])
def test_an_iteration_goes_no_farther_than_step_and_speed_allow(mode: int) -> None:
    """A gain that is far too high is a slow ramp of the flange, not a jump.

    The limit is the flange's: 160 mm above the TCP it has its own travel when it turns.
    """
    limits = (10, 100, 50, 10_000, 5_000, 250)  # 0.2 mm, 0.2 degrees, 5 mm/s
    vec = (0, 0, 3000 * (mode & 1), 3000 * (mode >> 1), 0, 0)
    talk = running(mode, gains_i=(450_000,) * 6, limits=limits)
    push(talk, 3, vec)
    start = talk.T_mm
    push(talk, 25, vec)
    travel = float(np.linalg.norm(talk.T_mm.translation - start.translation))
    assert 1.2 < travel < 2.6  # 0.5 s at 5 mm/s
    turned = np.degrees(np.linalg.norm(rotation_between(start.rotation, talk.T_mm.rotation)))
    assert turned < 0.5 * 5.0 / 1.75 * 1.1
    assert (turned > 0.3) == (mode > 1)
    risen = float(tcp_mm(talk.T_mm)[2] - tcp_mm(start)[2])
    assert (risen > 0.5) == (mode != 2)


# --- start and stop -------------------------------------------------------------------------------


def test_motions_are_refused_while_it_runs() -> None:
    """Two masters of one arm are none."""
    talk = running(1)
    before = talk.robot.q.copy()
    for com in (Com.MOVE_POSE, Com.MOVE_JOINTS, Com.MOVE_BY_JOINTS):
        sent = talk.send(com, 0, (50, 0, 0, 0, 0, 0))
        push(talk, 5)
        assert talk.taken == sent
        assert talk.status & Status.TARGET_REFUSED
    assert np.allclose(talk.robot.q, before, atol=1e-4)
    assert talk.status & Status.POSITION_FEEDBACK


def test_stop_ends_both_and_the_arm_may_move_again() -> None:
    """Without a hold: HELD does not show."""
    talk = running(3, gains_i=(0, 0, 1000, 10_000, 0, 0))
    push(talk, 40, (0, 0, 1000, 2000, 0, 0))
    talk.send(Com.FEEDBACK, 2)
    talk.live(0.2, beat=True)
    assert not int(talk.status) >> 5 & 3
    assert not talk.status & Status.HELD
    before, stopped = talk.robot.q.copy(), talk.T_mm
    push(talk, 10, (0, 0, 1000, 0, 0, 0))
    assert np.allclose(talk.robot.q, before, atol=1e-4)
    talk.start_feedback(3)  # its travel counts anew, from where the arm is
    push(talk, 8)
    assert talk.status & Status.ORIENTATION_FEEDBACK
    assert np.allclose(talk.T_mm.homogeneous, stopped.homogeneous, atol=0.02)
    talk.send(Com.FEEDBACK, 2)
    talk.live(0.2, beat=True)
    z = talk.height_mm()
    talk.move_up(5.0)
    talk.live(1.0, beat=True)
    assert talk.height_mm() - z == pytest.approx(5.0, abs=0.1)


@pytest.mark.parametrize("wait_s", [0.0, 0.004, 0.02])
def test_a_start_right_after_a_stop_runs_alone(wait_s: float) -> None:
    """The mode of before is gone, however soon the next one comes."""
    talk = running(1)
    push(talk, 5)
    talk.send(Com.FEEDBACK, 2)
    talk.live(wait_s)
    talk.send(Com.FEEDBACK, 1)
    push(talk, 8)
    assert int(talk.status) >> 5 & 3 == 2


def test_a_stop_voids_a_start_that_still_waits() -> None:
    """The receiver does the stop at once, the robot program the start later: stop wins."""
    talk = Talk()
    talk.hello()
    talk.move_up(60.0, speed_mm_s=50.0)
    talk.move_up(-60.0, speed_mm_s=50.0)  # the robot program waits to hand this over
    talk.send(Com.FEEDBACK, 0)
    talk.send(Com.FEEDBACK, 2)
    talk.live(4.0, beat=True)
    assert not int(talk.status) >> 5 & 3


# --- the point that it turns about ----------------------------------------------------------------


def farthest_travel(talk: Talk, point_mm: np.ndarray, times: int = 50) -> float:
    """Turn, and return how far a point of the flange frame went at most [mm]."""
    start: pin.SE3 = talk.T_mm
    farthest = 0.0
    for _ in range(times):
        push(talk, 1, TURN_X)
        travel = talk.T_mm.act(point_mm) - start.act(point_mm)
        farthest = max(farthest, float(np.linalg.norm(travel)))
    turned = np.degrees(rotation_between(start.rotation, talk.T_mm.rotation))
    assert turned[0] == pytest.approx(0.04 * times, rel=0.1)
    return farthest


@pytest.mark.parametrize("mode", [1, 2, 3])
def test_a_new_centre_moves_nothing(mode: int) -> None:
    """In the middle of a turn and of a displacement: the arm stays where it is."""
    talk = running(mode, gains_i=(0, 0, 1000, 10_000, 0, 0))
    push(talk, 25, (0, 0, 1000, 1000, 0, 0))
    push(talk, 10)
    before = talk.T_mm
    sent = talk.send(Com.TCP, CentreParam.CENTRE, (1250, -500, 8300, 0, 0, 0))
    push(talk, 10)
    assert talk.taken == sent
    assert not talk.status & Status.TARGET_REFUSED
    assert np.allclose(talk.T_mm.homogeneous, before.homogeneous, atol=2e-3)


def test_it_turns_about_the_newest_centre() -> None:
    """First the TCP stays, then a point 25 mm off it; and again the TCP."""
    talk = running(2, gains_i=(0, 0, 1000, 10_000, 0, 0))
    push(talk, 5, TURN_X)
    assert farthest_travel(talk, TCP_MM) < 0.05
    talk.do(Com.TCP, CentreParam.CENTRE, (0, 1250, 8000, 0, 0, 0))
    assert farthest_travel(talk, np.array([0.0, 25.0, 160.0])) < 0.05
    talk.do(Com.TCP, CentreParam.CENTRE, AT_TCP)
    assert farthest_travel(talk, TCP_MM) < 0.05


def test_travel_counts_on_from_the_start() -> None:
    """A centre that moves does not give back used travel: 3 mm of travel, fault 6."""
    talk = running(3, gains_i=(0, 0, 2500, 0, 0, 0), limits=(50, 1000, 500, 150, 5_000, 250))
    z = talk.height_mm()
    for turn in range(20):
        push(talk, 2, (0, 0, 1000, 0, 0, 0))
        talk.send(Com.TCP, CentreParam.CENTRE, (0, 50 * turn, 8000, 0, 0, 0))
    assert talk.fault == 6
    assert talk.height_mm() - z < 3.3


FAST: VecInt = (10_000, 10_000, 10_000, 2_000, 0, 0)  # 200 mm/s
LEAST_S = SEGMENT[0] * 1e-3


def strict(**other: object) -> Behaviour:
    """Return a controller that stops with E1117."""
    return QUICK.model_copy(update={"least_segment_s": LEAST_S, **other})


def stream(talk: Talk, seed: int) -> np.ndarray:
    """Send set points 0.01 to 1 mm apart, 5 to 20 ms each; return where the last one is [mm]."""
    draw = random.Random(seed)
    start = talk.T_mm
    position = start.translation.copy()
    talk.send(Com.SPEEDS, 0, FAST)
    for _ in range(200):
        length_mm = 10.0 ** draw.uniform(-2.0, 0.0)
        position = position + length_mm * np.array([0.0, 0.0, draw.choice((-1, 1, 1))])
        if talk.value("fm.rh") == talk.value("fm.rt"):  # as the gateway: the newest, one at a time
            talk.send(Com.SET_POINT, 0, talk.pose_vec(pin.SE3(start.rotation, position)))
        talk.live(draw.uniform(0.005, 0.02), beat=True)
    talk.send(Com.SET_POINT, 0, talk.pose_vec(pin.SE3(start.rotation, position)))
    talk.live(1.0, beat=True)
    return position


def press(talk: Talk, seed: int, mode: int = 3) -> None:
    """Run force feedback with wrenches that change at random, every 4 to 20 ms."""
    draw = random.Random(seed)
    gains: VecInt = (100_000,) * 6  # 0.2 mm/N, 0.2 deg/(N m)
    talk.start_feedback(mode, gains_p=gains, gains_i=(1_000,) * 6)
    for _ in range(150):
        force = [round(draw.gauss(0.0, 300.0)) for _ in range(3)]
        torque = [round(draw.gauss(0.0, 500.0)) for _ in range(3)]
        talk.send(Com.WRENCH, 0, (*force, *torque))  # type: ignore[arg-type]
        talk.live(draw.uniform(0.004, 0.02))


@pytest.mark.parametrize("ahead", [1, 2, 3, 4])
@pytest.mark.parametrize("accel_time_s", [0.0, 0.2])
def test_a_stream_of_any_step_is_planned_in_time_and_arrives(
    ahead: int, accel_time_s: float
) -> None:
    """No E1117; the arm ends at the last set point, though most were nothing by themselves."""
    talk = Talk(strict(motions_ahead=ahead, accel_time_s=accel_time_s, least_speed_m_s=0.0012))
    talk.hello()
    last = stream(talk, ahead)
    assert talk.machine.control.error is None
    assert talk.T_mm.translation[2] == pytest.approx(last[2], abs=0.02)


@pytest.mark.parametrize("ahead", [1, 3])
@pytest.mark.parametrize("mode", [1, 2, 3])
def test_force_feedback_of_any_wrench_is_planned_in_time(ahead: int, mode: int) -> None:
    """No E1117 in any mode."""
    talk = Talk(strict(motions_ahead=ahead, least_speed_m_s=0.0012))
    talk.hello()
    press(talk, ahead, mode)
    assert talk.machine.control.error is None
    assert talk.status & (Status.POSITION_FEEDBACK | Status.ORIENTATION_FEEDBACK)


@pytest.mark.parametrize("use", [stream, press])
def test_without_the_least_segment_the_planner_stops_with_e1117(use: object) -> None:
    """What the coalescing is for: with segments of 1 ms the same controller stops."""
    talk = Talk(strict())
    talk.hello(segment=(1, *SEGMENT[1:]))
    use(talk, 1)  # type: ignore[operator]
    assert str(talk.machine.control.error).startswith("(E1117)")


def test_the_monitor_speed_limits_the_speed_and_leaves_the_time_of_a_segment() -> None:
    """At 10 % a stream of 100 mm/s moves at most 10 % of its program speed, without E1117."""
    talk = Talk(strict())
    talk.hello()
    talk.pendant.monitor_speed(10.0)
    z, start_s = talk.height_mm(), talk.now_s
    stream(talk, 5)
    assert talk.machine.control.error is None
    assert abs(talk.height_mm() - z) <= 20.0 * (talk.now_s - start_s)


def test_the_first_target_of_force_feedback_is_near_the_arm_or_nothing_moves() -> None:
    """Fault 16: a controller that reads a compound value otherwise aims somewhere else."""
    text = TEXT.replace("POINT fm.q0=fm.r0+.m", "POINT fm.q0=fm.r0+fm.ctr")
    assert text.count("fm.r0+fm.ctr") == 2
    talk = Talk(strict(), text=text)
    talk.hello(limits=LIMITS)
    talk.send(Com.TCP, 1, (0, 0, 8_000, 0, 0, 0))
    talk.start_feedback(3, gains_i=(1_000,) * 6)
    q = talk.robot.q
    for _ in range(20):
        talk.send(Com.WRENCH, 0, (0, 0, 500, 0, 0, 0))
        talk.live(0.02)
    assert talk.value("fm.fault") == 16
    assert np.abs(talk.robot.q - q).max() < 1e-6


@pytest.mark.parametrize("ahead", [1, 4])
def test_short_motions_one_after_the_other_are_planned_in_time(ahead: int) -> None:
    """Goals of 0.3 mm at 200 mm/s, and goals between set points: each stops at its end."""
    talk = Talk(strict(motions_ahead=ahead))
    talk.hello()
    talk.send(Com.SPEEDS, 0, FAST)
    start = talk.T_mm
    for k in range(1, 9):
        pose = pin.SE3(start.rotation, start.translation + np.array([0.0, 0.0, 0.3 * k]))
        talk.send(Com.SET_POINT if k % 3 == 0 else Com.MOVE_POSE, 0, talk.pose_vec(pose))
    talk.live(2.0, beat=True)
    assert talk.machine.control.error is None
    assert talk.height_mm() - start.translation[2] == pytest.approx(2.4, abs=0.02)
