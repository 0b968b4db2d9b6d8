"""The program that ships, executed: segments that a planner can bear (E1117)."""

import random

import numpy as np
import pinocchio as pin
import pytest

from controller.packet import VecInt
from controller.packet_table import Com, Status
from sim.controller.behaviour import Behaviour
from tests.fakes.controller_talk import LIMITS, QUICK, SEGMENT, TEXT, Talk

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
