"""The program that ships, executed: its commands and numbers, on the arm and in reports."""

from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest

from common.motion.frames import rotation_between
from controller.packet import VecInt
from controller.packet_table import (
    COUNTER_SPAN,
    ID_FIRST,
    Bank,
    CentreParam,
    Com,
    Status,
    unpack_status,
)
from tests.fakes.controller_talk import (
    JOINT_SPEED,
    LIMITS,
    MOTION,
    SCALES,
    SEGMENT,
    Talk,
    push,
)

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
        (Com.MOVE_POSE, (0, 0, -99_999, 0, 90_000, 0)),
        (Com.MOVE_JOINTS, (60_000, 0, -22_500, 0, -22_500, 0)),
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
    talk.live(0.3, beat=True)
    assert np.allclose(joints_deg(talk), HOME_DEG, atol=0.01)
    assert (talk.closed, talk.machine.stops) == (False, [])
    go(talk, Com.MOVE_POSE, talk.shifted_vec(z=5.0))
    assert not talk.status & Status.TARGET_REFUSED


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
    *((Com.LIMITS, Bank.SEGMENT, but(SEGMENT, 0, ms)) for ms in (0, 1_001)),
    *((Com.LIMITS, Bank.SEGMENT, but(SEGMENT, 1, speed)) for speed in (-1, 1_001)),  # 100 mm/s
    *((Com.LIMITS, Bank.JOINT_SPEED, but(JOINT_SPEED, k, 0)) for k in range(6)),
]


def settings_of(talk: Talk) -> list[float]:
    """Everything that commands 5, 6 and 10 set."""
    names = ["fm.v", *(f"fm.{kind}[{k}]" for kind in ("kp", "ki") for k in range(1, 7))]
    names += [f"fm.{name}" for name in ("lstep", "lturn", "lspeed", "ltravel", "lforce", "wd")]
    names += [f"fm.{name}" for name in ("lcos", "ltorque", "lset", "scos", "lfast")]
    names += ["fm.tmove", "fm.vmin", *(f"fm.jmax[{k}]" for k in range(1, 7))]
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


OTHER: VecInt = (20, 200, 100, 10, 100, 5)
PUSH: VecInt = (1100, -1200, 1300, 1400, -1500, 1600)  # 11 N, -12 N, ..., 1.6 N m


def timed_heights(talk: Talk, speeds: VecInt, z_mm: float = 60.0) -> np.ndarray:
    """Heights above the start in mm, one each millisecond, of a motion in z."""
    talk.do(Com.SPEEDS, 0, speeds)
    z, heights = talk.height_mm(), list[float]()
    talk.machine.after_tick.append(lambda: heights.append(talk.height_mm() - z))
    talk.send(Com.MOVE_POSE, 0, talk.shifted_vec(z=z_mm))
    talk.wait(lambda: talk.height_mm() - z > z_mm - 0.05, 20.0)
    talk.machine.after_tick.pop()
    return np.array(heights)


def duration_s(heights: np.ndarray, from_mm: float, to_mm: float) -> float:
    """Return the time of the arm from one height to another."""
    return float(np.argmax(heights >= to_mm) - np.argmax(heights >= from_mm)) * 1e-3


def one_hot(index: int, value: int) -> VecInt:
    """Six numbers, one of them not zero."""
    a, b, c, d, e, f = (value * (k == index) for k in range(6))
    return (a, b, c, d, e, f)


# --- command 5 ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("modular", "mechanical", "monitor", "expected_mm_s"),
    [(100, 100, 100, 100), (50, 100, 100, 50), (100, 40, 100, 40), (30, 200, 50, 30)],
)
def test_speed_is_mechanical_times_modular_times_monitor_speed(
    modular: int, mechanical: int, monitor: int, expected_mm_s: float
) -> None:
    """Measured on the arm; the limits of command 10 (50 mm/s) are none for it."""
    talk = Talk()
    talk.hello()
    talk.pendant.monitor_speed(monitor)
    heights = timed_heights(talk, (10_000, 10_000, modular * 100, mechanical * 10, 0, 0))
    assert 30.0 / duration_s(heights, 15.0, 45.0) == pytest.approx(expected_mm_s, rel=0.02)


@pytest.mark.parametrize(("accel", "decel"), [(1_000, 10_000), (10_000, 1_000)])
def test_acceleration_and_deceleration_are_each_its_own(accel: int, decel: int) -> None:
    """10 % of one makes that end of the motion slow, and not the other."""
    talk = Talk()
    talk.hello()
    heights = timed_heights(talk, (accel, decel, 10_000, 1_000, 0, 0), 60.0)
    first, last = duration_s(heights, 0.1, 6.0), duration_s(heights, 54.0, 59.9)
    slow, quick = (first, last) if accel < decel else (last, first)
    assert slow > 0.17
    assert quick < 0.1


@pytest.mark.parametrize(("axis", "turn_deg"), [("x", 25.0), ("y", -25.0), ("z", 60.0)])
def test_a_turn_on_the_spot_takes_its_angle_times_the_lever(axis: str, turn_deg: float) -> None:
    """One degree counts as 1.75 mm, whatever AS makes of MM/S without travel."""
    talk = Talk()
    talk.hello()
    talk.do(Com.SPEEDS, 0, (10_000, 10_000, 10_000, 500, 0, 0))
    T = talk.T_mm  # upside down it is its own inverse
    go(talk, Com.MOVE_POSE, talk.pose_vec(T * pin.SE3(pin.utils.rotate("x", 0.3), np.zeros(3))))
    T = talk.T_mm
    goal = pin.SE3(T.rotation @ pin.utils.rotate(axis, np.radians(turn_deg)), T.translation)
    sent = talk.send(Com.MOVE_POSE, 0, talk.pose_vec(goal))
    talk.wait(lambda: talk.taken == sent and talk.robot.queue.busy)
    took_s = talk.wait(lambda: not talk.robot.queue.busy)
    assert took_s == pytest.approx(abs(turn_deg) * 1.75 / 50.0, rel=0.1)
    assert np.linalg.norm(rotation_between(talk.T_mm.rotation, goal.rotation)) < 1e-3


def test_a_long_travel_with_a_small_turn_keeps_the_speed_of_the_travel() -> None:
    """The turn gets time of its own only where it takes longer."""
    talk = Talk()
    talk.hello()
    talk.do(Com.SPEEDS, 0, (10_000, 10_000, 10_000, 500, 0, 0))
    T = talk.T_mm
    goal = T * pin.SE3(pin.utils.rotate("z", np.radians(10.0)), np.array([0.0, 0.0, -50.0]))
    moved_mm = lambda: float(np.linalg.norm(talk.T_mm.translation - T.translation))  # noqa: E731
    talk.send(Com.MOVE_POSE, 0, talk.pose_vec(goal))
    talk.wait(lambda: moved_mm() > 10.0)
    assert talk.wait(lambda: moved_mm() > 40.0) == pytest.approx(0.6, rel=0.05)


@pytest.mark.parametrize("joint", range(6))
def test_joint_motions_take_the_time_of_the_flange_or_of_the_joint(joint: int) -> None:
    """At 50 mm/s: the arc of the flange, or 1.75 mm for a degree of the joint if that is more."""
    talk = Talk()
    talk.hello()
    talk.send(Com.MOVE_JOINTS, 0, (2_500, 1_250, -20_000, 2_500, -20_000, 2_500))
    talk.live(3.5, beat=True)
    q, turn = talk.robot.q, np.radians(np.where(np.arange(6) == joint, 12.0, 0.0))
    flange = talk.robot.kinematics.flange_pose
    points = [flange(q + share * turn).translation for share in np.linspace(0.0, 1.0, 50)]
    arc_mm = 1e3 * sum(float(np.linalg.norm(b - a)) for a, b in pairwise(points))
    talk.send(Com.MOVE_BY_JOINTS, 0, one_hot(joint, 12 * SCALES[2]))
    talk.wait(lambda: talk.robot.queue.busy)
    took_s = talk.wait(lambda: not talk.robot.queue.busy)
    assert took_s == pytest.approx(max(arc_mm, 12.0 * 1.75) / 50.0, rel=0.08, abs=0.03)


# --- commands 6, 4, 11, 10 ------------------------------------------------------------------------


@pytest.mark.parametrize("axis", range(6))
@pytest.mark.parametrize("kind", ["proportional", "integral"])
def test_each_gain_is_of_its_own_axis_and_kind(axis: int, kind: str) -> None:
    """All six components push; only the one with a gain moves the arm, on or about its axis."""
    talk = Talk()
    talk.hello()
    scale = (SCALES[3], SCALES[4])[axis // 3]
    load = PUSH[axis] / scale
    mode = 1 + axis // 3
    times = 25 if kind == "proportional" else 125
    if kind == "proportional":
        talk.start_feedback(mode, gains_p=one_hot(axis, 100_000 if axis > 2 else 25_000))
        expected = load * (0.2 if axis > 2 else 0.05)
    else:
        talk.start_feedback(mode, gains_i=one_hot(axis, 5_000 if axis > 2 else 500))
        expected = load * (1.0 if axis > 2 else 0.1) * 2.5  # seconds
    push(talk, 3, (0,) * 6)
    start = talk.T_mm
    push(talk, times, PUSH)
    push(talk, 8, PUSH if kind == "proportional" else (0,) * 6)
    moved = np.zeros(6)
    moved[:3] = talk.T_mm.translation - start.translation
    moved[3:] = np.degrees(rotation_between(start.rotation, talk.T_mm.rotation))
    assert np.allclose(moved, expected * np.eye(6)[axis], atol=0.03 + 0.04 * abs(expected))


def test_all_scales_are_those_of_the_hello() -> None:
    """Poses, joints, speeds, limits, wrench and TCP in other units, and back."""
    talk = Talk()
    motion = (35_000, 100_000, 400, 2_000, 5_000, 0)
    talk.hello(scales=OTHER, limits=(20, 200, 250, 4_000, 500, 330), motion=motion)
    assert [talk.value(f"fm.{n}") for n in ("lset", "lfast")] == pytest.approx([20.0, 1000.0])
    names = ("lstep", "lturn", "lspeed", "ltravel", "lforce", "wd")
    limits = [talk.value(f"fm.{name}") for name in names]
    assert limits == pytest.approx([1.0, 1.0, 50.0, 200.0, 50.0, 0.33])
    talk.do(Com.SPEEDS, 0, (10_000, 10_000, 10_000, 400, 0, 0))
    assert talk.value("fm.v") == pytest.approx(80.0)
    goal = pin.SE3(talk.T_mm.rotation @ pin.utils.rotate("x", 0.1), talk.T_mm.translation + 12.0)
    talk.do(Com.MOVE_POSE, 0, talk.pose_vec(goal, OTHER))
    talk.live(1.5, beat=True)
    assert np.allclose(talk.T_mm.translation, goal.translation, atol=0.05)
    assert np.linalg.norm(rotation_between(talk.T_mm.rotation, goal.rotation)) < 2e-4
    assert np.abs(np.subtract(talk.last(Com.POSE).vec, talk.pose_vec(talk.T_mm, OTHER))).max() <= 1
    angles = np.degrees(talk.robot.q) * OTHER[2]
    assert np.abs(np.subtract(talk.last(Com.JOINTS).vec, angles)).max() <= 0.6
    talk.do(Com.TCP, CentreParam.CENTRE, (0, 0, 2_400, 0, 0, 0))
    talk.start_feedback(3, gains_p=(0, 0, 10_000, 100_000, 0, 0))
    push(talk, 3, (0,) * 6)
    start = talk.T_mm
    push(talk, 25, (0, 0, 200, 100, 0, 0))  # 20 N, 1 N m
    tcp = np.array([0.0, 0.0, 120.0])
    assert (talk.T_mm.act(tcp) - start.act(tcp))[2] == pytest.approx(0.4, abs=0.02)
    turned = np.degrees(rotation_between(start.rotation, talk.T_mm.rotation))
    assert turned[0] == pytest.approx(0.2, abs=0.01)


# --- 101, 102, 103 --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "joints_deg",
    [(40.0, 10.0, -70.0, 25.0, -60.0, 100.0), (-120.0, -20.0, -110.0, -35.0, 50.0, -200.0)],
)
def test_reports_are_the_pose_and_the_joints_rounded_to_a_unit(
    joints_deg: tuple[float, ...],
) -> None:
    """Signs of all kinds, six digits and five; 101 and 102 report the pose and the joints."""
    talk = Talk()
    talk.hello()
    talk.do(Com.SPEEDS, 0, (10_000, 10_000, 10_000, 10_000, 0, 0))
    a, b, c, d, e, f = (round(angle * SCALES[2]) for angle in joints_deg)
    talk.send(Com.MOVE_JOINTS, 0, (a, b, c, d, e, f))
    talk.live(3.0, beat=True)
    assert np.allclose(np.degrees(talk.robot.q), joints_deg, atol=0.01)
    assert np.abs(np.subtract(talk.last(Com.JOINTS).vec, (a, b, c, d, e, f))).max() <= 2
    units = np.degrees(talk.robot.q) * SCALES[2]
    assert np.abs(np.subtract(talk.last(Com.JOINTS).vec, units)).max() <= 0.6
    assert np.abs(np.subtract(talk.last(Com.POSE).vec, talk.pose_vec(talk.T_mm))).max() <= 1


def test_one_sample_has_one_counter_and_each_eighth_a_103() -> None:
    """101, 102 with the same Param, in this order; 240 counters; 60 a second or more."""
    talk = Talk()
    talk.hello()
    start_s, before = talk.now_s, len(talk.received(Com.POSE))
    talk.live(7.0)
    kinds = [packet.com for packet in talk.inbox if packet.com != Com.HELLO]
    poses, joints = talk.received(Com.POSE), talk.received(Com.JOINTS)
    assert "".join({101: "p", 102: "j", 103: "h"}[kind] for kind in kinds).replace("pj", "") == (
        "h" * len(talk.received(Com.HEALTH))
    )
    assert all(p.param == j.param for p, j in zip(poses, joints, strict=False))
    counters = [unpack_status(p.param)[0] for p in poses]
    assert all((b - a) % COUNTER_SPAN == 1 for a, b in pairwise(counters))
    assert len(poses) > COUNTER_SPAN
    assert len(poses) / len(talk.received(Com.HEALTH)) == pytest.approx(8.0, abs=0.3)
    assert 60 < (len(poses) - before) / (talk.now_s - start_s) < 125


def test_health_reports_age_of_the_wrench_queue_monitor_speed_and_held_id() -> None:
    """Each in its place; the last number is one while any address may connect."""
    talk = Talk()
    talk.hello()
    talk.pendant.monitor_speed(37.5)
    talk.send(Com.WRENCH)
    talk.live(0.2, beat=True)
    young = talk.last(Com.HEALTH).vec
    held = talk.send(Com.HOLD)
    talk.live(1.0)
    old = talk.last(Com.HEALTH).vec
    assert 50 < young[1] < 200
    assert 1050 < old[1] < 1250
    assert old[0] > young[0]
    assert (young[2:], old[2:]) == ((0, 3_750, 0, 1), (0, 3_750, held - ID_FIRST, 1))
    assert talk.status & Status.HELD
