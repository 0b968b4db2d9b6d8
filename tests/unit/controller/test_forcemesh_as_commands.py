"""The program that ships, executed: motions, speeds, settings, and refusals."""

import numpy as np
import pytest

from common.motion.frames import rotation_between
from controller.packet import VecInt
from controller.packet_table import Bank, Com, Status
from tests.fakes.controller_talk import LIMITS, MOTION, SCALES, Talk

MOVE = (Com.MOVE_BY_JOINTS, (250, 0, 0, 0, 0, 0))
HOME_DEG = np.array([0.0, 0.0, -90.0, 0.0, -90.0, 0.0])
TURN = (Com.MOVE_POSE, (0, 23_750, 18_850, 0, 90_000, 30_000))  # home, turned by 120 degrees
FULL: VecInt = (10_000, 10_000, 10_000, 1_000, 0, 0)  # 100 mm/s


def ready(speeds: VecInt = FULL) -> Talk:
    """Greeted, with speeds set."""
    talk = Talk()
    talk.hello()
    talk.do(Com.SPEEDS, 0, speeds)
    return talk


def go(talk: Talk, com: Com, vec: VecInt, limit_s: float = 20.0) -> float:
    """Send a motion, wait until it is taken and the arm stands; return how long it took [s]."""
    sent = talk.send(com, 0, vec)
    took_s = talk.wait(lambda: talk.taken == sent)
    if talk.status & Status.TARGET_REFUSED:
        return took_s
    took_s += talk.wait(lambda: talk.robot.queue.busy, 2.0)
    return took_s + talk.wait(lambda: not talk.robot.moving, limit_s)


def joints_vec(degrees: np.ndarray) -> VecInt:
    """Joint angles in packet units."""
    a, b, c, d, e, f = (round(float(angle) * SCALES[2]) for angle in degrees)
    return (a, b, c, d, e, f)


def joints_deg(talk: Talk) -> np.ndarray:
    """Joint angles of the arm."""
    return np.degrees(talk.robot.q)


# --- command 1 ------------------------------------------------------------------------------------


def test_a_pose_is_reached_on_a_straight_line() -> None:
    """Command 1: the flange stays within 0.1 mm of the line, and keeps its axes."""
    talk = ready()
    start = talk.T_mm
    travel = np.array([30.0, -20.0, 10.0])
    off: list[float] = []

    def watch() -> None:
        moved = talk.T_mm.translation - start.translation
        off.append(float(np.linalg.norm(np.cross(moved, travel / np.linalg.norm(travel)))))

    talk.machine.after_tick.append(watch)
    go(talk, Com.MOVE_POSE, talk.shifted_vec(*travel))
    assert np.allclose(talk.T_mm.translation - start.translation, travel, atol=0.05)
    assert max(off) < 0.1
    assert np.linalg.norm(rotation_between(start.rotation, talk.T_mm.rotation)) < 1e-3


# --- commands 2 and 3 -----------------------------------------------------------------------------


def test_relative_joint_angles_add_up_from_where_the_motion_before_has_ended() -> None:
    """Two in a row, sent at once: each counts from the end of the one before."""
    talk = ready((10_000, 10_000, 10_000, 5_000, 0, 0))
    travel = np.array([4.0, -5.0, 6.0, -7.0, 8.0, -9.0])
    talk.send(Com.MOVE_BY_JOINTS, 0, joints_vec(travel))
    go(talk, Com.MOVE_BY_JOINTS, joints_vec(0.5 * travel))
    assert np.allclose(joints_deg(talk), HOME_DEG + 1.5 * travel, atol=0.01)


def test_relative_joint_angles_after_a_hold_count_from_where_the_arm_was_stopped() -> None:
    """Not from the target of the braked motion."""
    talk = ready()
    talk.send(Com.MOVE_BY_JOINTS, 0, joints_vec(np.array([30.0, 0, 0, 0, 0, 0])))
    talk.wait(lambda: joints_deg(talk)[0] > 5.0)
    talk.send(Com.HOLD)
    talk.live(0.5)
    stopped = joints_deg(talk)
    assert stopped[0] < 15.0
    travel = np.array([-2.0, 0, 0, 0, 0, 1.0])
    go(talk, Com.MOVE_BY_JOINTS, joints_vec(travel))
    assert np.allclose(joints_deg(talk), stopped + travel, atol=0.01)


# --- refusals -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("com", "vec"),
    [
        (Com.MOVE_POSE, (75_000, 0, 10_000, 0, 90_000, 0)),
        (Com.MOVE_POSE, (0, 0, -99_999, 0, 90_000, 0)),
        (Com.MOVE_JOINTS, (60_000, 0, -22_500, 0, -22_500, 0)),
        (Com.MOVE_BY_JOINTS, (0, 0, -45_000, 0, 0, 0)),
        (Com.MOVE_BY_JOINTS, (0, 0, 0, 0, 0, 99_000)),
    ],
)
def test_a_target_that_cannot_be_reached_is_taken_refused_and_moves_nothing(
    com: Com, vec: VecInt
) -> None:
    """The program continues: the next target is taken, and the bit goes."""
    talk = ready()
    go(talk, com, vec)
    assert talk.status & Status.TARGET_REFUSED
    assert not talk.status & (Status.ERROR | Status.MOVING)
    talk.live(0.3, beat=True)
    assert np.allclose(joints_deg(talk), HOME_DEG, atol=0.01)
    assert (talk.closed, talk.machine.stops) == (False, [])
    z = talk.height_mm()
    go(talk, Com.MOVE_POSE, talk.shifted_vec(z=5.0))
    assert not talk.status & Status.TARGET_REFUSED
    assert talk.height_mm() - z == pytest.approx(5.0, abs=0.05)


def but(vec: VecInt, place: int, value: int) -> VecInt:
    """Six numbers, one of them another."""
    a, b, c, d, e, f = (value if k == place else number for k, number in enumerate(vec))
    return (a, b, c, d, e, f)


SPEED: VecInt = (10_000, 10_000, 10_000, 500, 0, 0)
SENSELESS = [
    *((Com.SPEEDS, 0, but(SPEED, k, 0)) for k in range(4)),
    *((Com.SPEEDS, 0, but(SPEED, k, 10_001)) for k in range(4)),  # over 100 %, over 1000 mm/s
    *((Com.GAINS, kind, but((5,) * 6, k, -1)) for k in range(6) for kind in (0, 1)),
    *((Com.LIMITS, 0, but(LIMITS, k, 0)) for k in range(5)),
    *((Com.LIMITS, 0, but(LIMITS, 5, ms)) for ms in (99, 2_001)),  # watchdog
    *((Com.LIMITS, Bank.MOTION, but(MOTION, k, 0)) for k in range(5)),
    *((Com.LIMITS, Bank.MOTION, but(MOTION, k, 90_000)) for k in (0, 3)),  # half a turn
]


def settings_of(talk: Talk) -> list[float]:
    """Everything that commands 5, 6 and 10 set."""
    names = ["fm.v", *(f"fm.{kind}[{k}]" for kind in ("kp", "ki") for k in range(1, 7))]
    names += [f"fm.{name}" for name in ("lstep", "lturn", "lspeed", "ltravel", "lforce", "wd")]
    names += [f"fm.{name}" for name in ("lcos", "ltorque", "lset", "scos", "lfast")]
    return [float(talk.value(name)) for name in names]


@pytest.mark.parametrize(("com", "param", "vec"), SENSELESS)
def test_settings_that_make_no_sense_are_taken_refused_and_change_nothing(
    com: Com, param: int, vec: VecInt
) -> None:
    """The bit is set until the next good target."""
    talk = Talk()
    talk.hello(limits=None)
    if com != Com.LIMITS:  # those are sent before all others
        talk.set_up()
    before = settings_of(talk)
    talk.do(com, param, vec)
    assert talk.status & Status.TARGET_REFUSED
    assert settings_of(talk) == before
    if com == Com.LIMITS:
        talk.set_up()
    go(talk, Com.MOVE_POSE, talk.shifted_vec(z=1.0))
    assert not talk.status & Status.TARGET_REFUSED


TOO_MUCH = {
    "limits of 50 m/s": [(Com.LIMITS, (50, 1000, 499_999, 10_000, 5_000, 250))],
    "speed of 50 m/s": [(Com.SPEEDS, (10_000, 10_000, 10_000, 499_999, 0, 0)), MOVE],
    "speed of 0.00001 mm/s": [(Com.SPEEDS, (10_000, 10_000, 1, 1, 0, 0)), MOVE],
    "a turn of more than an hour": [(Com.SPEEDS, (10_000, 10_000, 2_000, 1, 0, 0)), TURN],
}


@pytest.mark.parametrize("commands", TOO_MUCH.values(), ids=TOO_MUCH)
def test_no_number_of_a_packet_stops_the_robot_program(commands: list[tuple[Com, VecInt]]) -> None:
    """A speed that AS does not take is refused; an error stop needs a person."""
    talk = Talk()
    talk.hello(limits=None if commands[0][0] == Com.LIMITS else LIMITS)
    for com, vec in commands:
        sent = talk.send(com, 0, vec)
        talk.live(0.5, beat=True)
        assert talk.machine.stops == []
        assert talk.taken == sent
