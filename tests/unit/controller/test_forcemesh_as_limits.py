"""The program that ships, executed: permitted motion by the banks of command 10."""

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
import pytest

from controller.packet import ZERO_VEC, VecInt
from controller.packet_table import CentreParam, Com, Status
from tests.fakes.controller_talk import (
    LIMITS,
    LOWER,
    MOTION,
    NO_TCP,
    SCALES,
    SET_UP,
    UPPER,
    Talk,
    push,
    with_peer,
)

TCP: VecInt = (500, -250, 8000, 0, 0, 0)
TCP_MM = np.array([10.0, -5.0, 160.0])
ALL = (
    (Com.LIMITS, 0, LIMITS),
    *((Com.LIMITS, int(bank), vec) for bank, vec in SET_UP),
    (Com.TCP, 0, NO_TCP),
)
NOT_SET_UP, BOX, TURN, LEAP, SPEED = 13, 14, 15, 16, 17


def ready(
    tcp: VecInt = NO_TCP,
    motion: VecInt = MOTION,
    lower: VecInt = LOWER,
    upper: VecInt = UPPER,
) -> Talk:
    """Greeted, set up, 100 mm/s."""
    talk = Talk()
    talk.hello(tcp=tcp, motion=motion, lower=lower, upper=upper)
    talk.do(Com.SPEEDS, 0, (10_000, 10_000, 10_000, 1_000, 0, 0))
    return talk


def walled(lower: Sequence[float], upper: Sequence[float], y_mm: float = 0.0) -> Talk:
    """A TCP below the flange, and walls so many mm around where it is at the start."""
    at = Talk().T_mm.act(TCP_MM) + np.array([0.0, y_mm, 0.0])
    corners = []
    for away in (-np.array(lower), np.array(upper)):
        x, y, z = (round(float(value)) for value in (at + away) * SCALES[0])
        corners.append((x, y, z, 0, 0, 0))
    return ready(TCP, lower=corners[0], upper=corners[1])


def along(axis: int, value: int) -> VecInt:
    """Return six numbers of a packet, one of which is not zero."""
    x, y, z = (value if each == axis else 0 for each in range(3))
    return (x, y, z, 0, 0, 0)


def refused(talk: Talk, com: Com, vec: VecInt) -> int:
    """Send a motion; return the fault that refuses it, and 0 when the arm went."""
    q = talk.robot.q
    sent = talk.send(com, 0, vec)
    talk.wait(lambda: talk.taken == sent)
    talk.live(0.7, beat=True)
    fault = int(talk.value("fm.refd"))
    if talk.status & Status.TARGET_REFUSED:
        assert talk.fault == fault
        assert np.allclose(talk.robot.q, q, atol=2e-4)
        return fault
    assert fault == 0
    return 0


# --- before everything has come -------------------------------------------------------------------


@pytest.mark.parametrize("missing", range(len(ALL)))
def test_nothing_moves_before_every_bank_and_the_tcp_have_come(missing: int) -> None:
    """Any one is missing: every motion is refused; it comes, and the arm moves."""
    talk = Talk()
    talk.hello(limits=None)
    for number, (com, param, vec) in enumerate(ALL):
        if number != missing:
            talk.do(com, param, vec)
    for com, vec in (
        (Com.MOVE_POSE, talk.shifted_vec(z=5.0)),
        (Com.SET_POINT, talk.shifted_vec(z=5.0)),
        (Com.MOVE_BY_JOINTS, (250, 0, 0, 0, 0, 0)),
        (Com.FEEDBACK, ZERO_VEC),
    ):
        assert refused(talk, com, vec) == NOT_SET_UP
    assert talk.status & Status.HELD
    talk.do(*ALL[missing])
    assert refused(talk, Com.MOVE_POSE, talk.shifted_vec(z=5.0)) == 0


def test_limits_are_sent_once() -> None:
    """A packet whose command or Param was spoilt changes none of them; the next connection may."""
    talk = ready()
    names = ("ltravel", "lfast", "b[1]", "b[4]", "lcos", "wd", "lforce", "tmove", "jmax[1]")
    before = [talk.value(f"fm.{name}") for name in names]
    for com, param, _ in ALL:
        talk.do(com, param, (1000, 2000, 3000, 4000, 5000, 150))
        assert talk.status & Status.TARGET_REFUSED
        assert [talk.value(f"fm.{name}") for name in names] == before
    assert refused(talk, Com.MOVE_POSE, talk.shifted_vec(z=5.0)) == 0
    talk.hang_up()
    talk.live(0.3)
    talk.hello(limits=None)
    assert refused(talk, Com.MOVE_POSE, talk.shifted_vec(z=5.0)) == NOT_SET_UP
    talk.set_up()
    assert refused(talk, Com.MOVE_POSE, talk.shifted_vec(z=5.0)) == 0


# --- the box --------------------------------------------------------------------------------------


@pytest.mark.parametrize("com", [Com.MOVE_POSE, Com.SET_POINT])
@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [-1, 1])
def test_a_target_outside_the_box_is_refused_on_every_side(com: Com, axis: int, sign: int) -> None:
    """Walls 10 mm around the TCP: 9 mm is let through, 11 mm is not."""
    talk = walled((10.0,) * 3, (10.0,) * 3)
    start = talk.T_mm
    for travel_mm, fault in ((11.0, BOX), (9.0, 0)):
        travel = sign * travel_mm * np.eye(3)[axis]
        vec = talk.pose_vec(pin.SE3(start.rotation, start.translation + travel))
        assert refused(talk, com, vec) == fault
    assert (talk.T_mm.translation - start.translation)[axis] == pytest.approx(9.0 * sign, abs=0.1)


def test_it_is_the_tcp_that_has_to_stay_in_the_box() -> None:
    """A turn of the flange in its place swings the tool out; the TCP of command 11/1 is another."""
    talk = walled((20.0,) * 3, (20.0,) * 3)
    start = talk.T_mm
    talk.do(Com.TCP, CentreParam.CENTRE, NO_TCP)
    for turn_deg, fault in ((10.0, BOX), (6.0, 0)):
        R = start.rotation @ pin.utils.rotate("x", np.radians(turn_deg))
        vec = talk.pose_vec(pin.SE3(R, start.translation))
        assert refused(talk, Com.MOVE_POSE, vec) == fault


def test_joints_are_judged_by_the_end_and_the_path_of_the_tool() -> None:
    """JT1 swings the tool aside; from -30 to 30 degrees it passes outside, and ends inside."""
    outward = (500.0, 500.0, 500.0)
    talk = walled(outward, (500.0, -34.0, 500.0))  # at 0 degrees the TCP is 34 mm outside
    talk.do(Com.SPEEDS, 0, (10_000, 10_000, 10_000, 5_000, 0, 0))
    assert refused(talk, Com.MOVE_BY_JOINTS, (-30 * 250, 0, 0, 0, 0, 0)) == 0  # back in
    talk.live(1.0, beat=True)
    assert refused(talk, Com.MOVE_BY_JOINTS, (30 * 250, 0, 0, 0, 0, 0)) == BOX
    assert refused(talk, Com.MOVE_BY_JOINTS, (60 * 250, 0, 0, 0, 0, 0)) == BOX
    assert refused(talk, Com.MOVE_BY_JOINTS, (5 * 250, 0, 0, 0, 0, 0)) == 0


def test_from_outside_it_may_go_back_in_and_nowhere_else() -> None:
    """The TCP is 15 mm below the floor, as after a limit was set anew: up, but no deeper."""
    talk = walled((100.0, 100.0, -15.0), (100.0,) * 3)
    assert refused(talk, Com.MOVE_POSE, talk.shifted_vec(z=-1.0)) == BOX
    assert refused(talk, Com.MOVE_POSE, talk.shifted_vec(x=5.0, z=-0.1)) == BOX
    assert refused(talk, Com.MOVE_POSE, talk.shifted_vec(x=101.0, z=5.0)) == BOX
    for _ in range(4):
        assert refused(talk, Com.MOVE_POSE, talk.shifted_vec(z=5.0)) == 0
    assert refused(talk, Com.MOVE_POSE, talk.shifted_vec(z=-6.0)) == BOX


@pytest.mark.parametrize("mode", [1, 3])
@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [-1, 1])
def test_force_feedback_that_comes_to_the_box_ends_in_hold(mode: int, axis: int, sign: int) -> None:
    """Every iteration is judged: pushed against a wall 3 mm away, with 200 mm of travel."""
    far, near = [100.0] * 3, [3.0 if each == axis else 100.0 for each in range(3)]
    talk = walled(far, near) if sign > 0 else walled(near, far)
    talk.start_feedback(mode, gains_i=along(axis, 5_000))
    start_mm = talk.T_mm.translation.copy()
    push(talk, 60, along(axis, 1000 * sign))
    assert talk.fault == BOX
    assert talk.status & Status.HELD
    assert 2.0 < sign * (talk.T_mm.translation - start_mm)[axis] < 3.1


# --- turns ----------------------------------------------------------------------------------------


def test_turns_count_from_the_first_motion_after_a_hold() -> None:
    """20 degrees are allowed: 15 and 10 in the same direction are too many; a hold begins anew."""
    talk = ready(motion=(20 * SCALES[1], *MOTION[1:]))
    by = 250
    assert refused(talk, Com.MOVE_BY_JOINTS, (0, 0, 0, 0, 0, 15 * by)) == 0
    assert refused(talk, Com.MOVE_BY_JOINTS, (0, 0, 0, 0, 0, 10 * by)) == TURN
    assert refused(talk, Com.MOVE_BY_JOINTS, (0, 0, 0, 0, 0, -30 * by)) == 0
    assert refused(talk, Com.MOVE_BY_JOINTS, (0, 0, 0, 0, 0, -6 * by)) == TURN
    talk.send(Com.HOLD)
    talk.live(0.3)
    assert refused(talk, Com.MOVE_BY_JOINTS, (0, 0, 0, 0, 0, -15 * by)) == 0


def test_a_pose_that_is_turned_too_far_is_refused_at_any_position() -> None:
    """Also when its O, A, T stand for a small difference of numbers: the rotation counts."""
    talk = ready(motion=(20 * SCALES[1], *MOTION[1:]))
    start = talk.T_mm
    for axis in "xyz":
        for turn_deg, fault in ((21.0, TURN), (-21.0, TURN), (19.0, 0)):
            R = start.rotation @ pin.utils.rotate(axis, np.radians(turn_deg))
            vec = talk.pose_vec(pin.SE3(R, start.translation))
            assert refused(talk, Com.MOVE_POSE, vec) == fault


# --- set points -----------------------------------------------------------------------------------


def test_a_set_point_is_measured_from_the_one_before_and_the_first_from_the_arm() -> None:
    """20 mm: 19 and 19 more pass; 21 does not, and the next is measured from the last good one."""
    talk = ready()
    start = talk.T_mm
    faults = {21.0: LEAP, 19.0: 0, 38.0: 0, 60.0: LEAP, 17.0: LEAP, 57.0: 0}
    for travel_mm, fault in faults.items():
        at = pin.SE3(start.rotation, start.translation + np.array([0.0, 0.0, travel_mm]))
        sent = talk.send(Com.SET_POINT, 0, talk.pose_vec(at))
        talk.live(0.3, beat=True)
        assert talk.taken == sent
        assert talk.value("fm.refd") == fault
    talk.live(1.0, beat=True)
    assert talk.height_mm() - start.translation[2] == pytest.approx(57.0, abs=0.1)


@pytest.mark.parametrize("between", ["goal", "joints", "hold", "feedback"])
def test_after_anything_else_a_stream_begins_where_the_arm_is(between: str) -> None:
    """Not where the stream before it ended, 50 mm away."""
    talk = ready()
    assert refused(talk, Com.SET_POINT, talk.shifted_vec(z=15.0)) == 0
    there = talk.shifted_vec()
    if between == "hold":
        talk.send(Com.HOLD)
    if between == "joints":
        assert refused(talk, Com.MOVE_BY_JOINTS, (0, 0, 1000, 0, 0, 0)) == 0
    elif between == "feedback":
        talk.start_feedback(1, gains_i=(0, 0, 20_000, 0, 0, 0))
        push(talk, 60, (0, 0, 1000, 0, 0, 0))
        talk.send(Com.FEEDBACK, 2)
    else:
        assert refused(talk, Com.MOVE_POSE, talk.shifted_vec(z=50.0)) == 0
    talk.live(0.3, beat=True)
    moved = talk.height_mm() - there[2] / SCALES[0]
    assert abs(moved) > 20.5
    assert refused(talk, Com.SET_POINT, there) == LEAP
    assert refused(talk, Com.SET_POINT, talk.shifted_vec(z=5.0)) == 0


def test_set_points_may_not_turn_far_either() -> None:
    """10 degrees from one to the next."""
    talk = ready()
    start = talk.T_mm
    for turn_deg, fault in ((11.0, LEAP), (9.0, 0), (18.0, 0), (30.0, LEAP)):
        R = start.rotation @ pin.utils.rotate("x", np.radians(turn_deg))
        assert refused(talk, Com.SET_POINT, talk.pose_vec(pin.SE3(R, start.translation))) == fault


# --- speed ----------------------------------------------------------------------------------------


def test_a_speed_above_the_highest_is_refused_and_the_one_before_stays() -> None:
    """Mechanical times modular, 200 mm/s; a new limit also lowers the speed that is set."""
    talk = Talk()
    talk.hello(motion=(*MOTION[:4], 2_000, 0))
    assert talk.value("fm.v") == 50.0  # slow until command 5
    for modular, mechanical, fault in ((5_000, 4_000, 0), (10_000, 2_001, SPEED)):
        talk.do(Com.SPEEDS, 0, (10_000, 10_000, modular, mechanical, 0, 0))
        assert (talk.value("fm.refd"), talk.value("fm.v")) == (fault, 200.0)
    talk.hang_up()
    talk.live(0.3)
    talk.hello(motion=(*MOTION[:4], 500, 0))
    assert talk.value("fm.v") == 50.0


# --- the wrench and its set point -----------------------------------------------------------------


def test_the_set_point_is_the_target_of_force_feedback() -> None:
    """10 N of 10 N leave no error to follow; without the set point the arm goes up."""
    talk = ready()
    talk.start_feedback(1, gains_i=(0, 0, 1_000, 0, 0, 0))
    talk.send(Com.FORCE_SET_POINT, 0, (0, 0, 1000, 0, 0, 0))
    push(talk, 3, (0, 0, 1000, 0, 0, 0))
    z = talk.height_mm()
    push(talk, 50, (0, 0, 1000, 0, 0, 0))
    assert talk.height_mm() == pytest.approx(z, abs=0.02)
    push(talk, 50, (0, 0, 2000, 0, 0, 0))
    assert talk.height_mm() - z == pytest.approx(2.0, abs=0.15)


@pytest.mark.parametrize("end", ["hold", "stop", "hello"])
def test_a_set_point_ends_with_its_force_feedback(end: str) -> None:
    """The next force feedback begins with zero, whatever the last target was."""
    talk = ready()
    talk.start_feedback(1)
    talk.send(Com.FORCE_SET_POINT, 0, (0, 0, 1000, 0, 0, 0))
    push(talk, 3)
    if end == "hello":
        talk.hang_up()
        talk.live(0.3)
        talk.hello()
    else:
        talk.send(*((Com.HOLD, 0) if end == "hold" else (Com.FEEDBACK, 2)))
        talk.live(0.3, beat=True)
    z = talk.height_mm()
    talk.start_feedback(1, gains_i=(0, 0, 5_000, 0, 0, 0))
    push(talk, 50)
    assert talk.height_mm() == pytest.approx(z, abs=0.02)


@pytest.mark.parametrize(
    ("setpoint", "wrench", "fault"),
    [
        ((0, 0, 4000, 0, 0, 0), (0, 0, 5100, 0, 0, 0), 7),  # 51 N, though only 11 N above it
        ((0, 0, 4000, 0, 0, 0), (0, 0, 4900, 0, 0, 0), 0),
        ((0, 0, -4000, 0, 0, 0), (0, 0, 2000, 0, 0, 0), 0),  # 60 N apart, 20 N real
        ((0, 0, 5100, 0, 0, 0), (0, 0, 0, 0, 0, 0), 7),  # a set point above the ceiling
        (ZERO_VEC, (0, 0, 0, 2100, 0, 0), 7),  # 2.1 N m of 2
        (ZERO_VEC, (0, 0, 0, 0, -1900, 0), 0),
    ],
)
@pytest.mark.parametrize("mode", [1, 2, 3])
def test_the_ceilings_are_for_the_reading_itself(
    mode: int, setpoint: VecInt, wrench: VecInt, fault: int
) -> None:
    """50 N and 2 N m, in every mode, from the first wrench on."""
    talk = ready(motion=(MOTION[0], 2_000, *MOTION[2:]))
    talk.start_feedback(mode)
    talk.send(Com.FORCE_SET_POINT, 0, setpoint)
    push(talk, 2, wrench)
    talk.live(0.2, beat=True)
    assert talk.value("fm.fault") == fault
    assert bool(talk.status & Status.HELD) == bool(fault)


# --- who may connect ------------------------------------------------------------------------------


def test_only_the_pc_may_connect_when_its_address_is_set() -> None:
    """Each number of the address counts; a refused client gets nothing, the PC is served."""
    pc = (192, 168, 0, 10)
    talk = Talk(text=with_peer(*pc))
    for k in range(4):
        peer = tuple(octet + (n == k) for n, octet in enumerate(pc))
        talk.dial((peer[0], peer[1], peer[2], peer[3]))
        talk.write(b"anything")
        talk.wait(lambda: talk.closed, 1.0, beat=False)
        assert talk.inbox == []
        assert talk.value("fm.fault") == 18
    talk.dial(pc)
    talk.live(0.2)
    assert not talk.closed
