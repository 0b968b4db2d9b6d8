"""The program that ships, executed: every fault code of its README."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from controller.packet import Packet, VecInt, encode
from controller.packet_table import ID_FIRST, Com, Status
from sim.controller.behaviour import Behaviour
from sim.controller.network import LOOPBACK
from tests.fakes.controller import PORT
from tests.fakes.controller_talk import (
    HELLO_PARAM,
    LIMITS,
    LOWER,
    MOTION,
    NO_TCP,
    SCALES,
    SET_UP,
    TEXT,
    Talk,
    moving,
    still,
    with_peer,
)

README = (Path(__file__).resolve().parents[3] / "controller" / "README.md").read_text("utf-8")
HELLO = encode(Packet(ID_FIRST, Com.HELLO, HELLO_PARAM, SCALES))
TOOL = pin.SE3(pin.utils.rotate("x", 0.3), np.array([0.01, -0.02, 0.15]))


# --- every fault of the README --------------------------------------------------------------------


def silence(talk: Talk) -> None:
    """Send nothing for half a second."""
    moving(talk).live(0.5)


def no_wrench(talk: Talk) -> None:
    """Beats, but one wrench only."""
    talk.hello()
    talk.start_feedback(1)
    talk.send(Com.WRENCH)
    talk.live(0.6, beat=True)


def hold_on_the_pendant(talk: Talk) -> None:
    """A person turns HOLD."""
    moving(talk).pendant.hold()
    talk.live(0.3, beat=True)


def letters(talk: Talk) -> None:
    """63 characters that are no packet."""
    moving(talk).write(b"HOLD!!! " * 8)
    talk.live(0.1)


def full_ring(talk: Talk) -> None:
    """The robot program waits behind a motion while settings pour in."""
    moving(talk, 150.0)
    for _ in range(5):  # more than a controller takes ahead
        talk.move_up(60.0)
    talk.live(0.2, beat=True)
    for _ in range(70):
        talk.send(Com.GAINS, 0)
    talk.wait(lambda: talk.closed, 2.0, beat=False)


def farther_than_allowed(talk: Talk) -> None:
    """2 mm of travel."""
    talk.hello(limits=(*LIMITS[:3], 100, *LIMITS[4:]))
    yielding(talk, (0, 0, 1000, 0, 0, 0))


def pressed_too_hard(talk: Talk) -> None:
    """A ceiling of 8 N, and 10 N."""
    talk.hello(limits=(*LIMITS[:4], 800, LIMITS[5]))
    yielding(talk, (0, 0, 1000, 0, 0, 0))


def beyond_the_reach(talk: Talk) -> None:
    """Nearly stretched, and pulled farther; the travel of command 10 would allow it."""
    talk.hello(limits=(50, 1000, 500, 99_999, 5_000, 250))
    talk.do(Com.SPEEDS, 0, (10_000, 10_000, 10_000, 5_000, 0, 0))
    talk.send(Com.MOVE_POSE, 0, talk.shifted_vec(y=315.0))
    talk.wait(lambda: talk.T_mm.translation[1] > 475.0 + 314.9)
    yielding(talk, (0, 3000, 0, 0, 0, 0))


def yielding(talk: Talk, vec: VecInt) -> None:
    """Force feedback yields to a wrench until it ends, at most for 6.4 s."""
    talk.start_feedback(1, gains_i=(0, 50_000, 50_000, 0, 0, 0))
    for _ in range(320):
        talk.send(Com.WRENCH, 0, vec)
        talk.live(0.02)
        if talk.value("fm.mode") == 0:
            break


def tool_of_another_program(talk: Talk) -> None:
    """Another program sets TOOL while `fm.main` runs."""
    talk.hello()
    talk.robot.T_flange_tcp = TOOL
    talk.do(Com.MOVE_POSE, 0, talk.shifted_vec(z=10.0))


def pose_that_does_not_fit(talk: Talk) -> None:
    """A long TOOL of another program and a fine scale: z is below -99999 units."""
    talk.hello()
    talk.hang_up()
    talk.live(0.1)
    talk.robot.T_flange_tcp = pin.SE3(np.eye(3), np.array([0.0, 0.0, 1.6]))
    talk.greet(scales=(99, *SCALES[1:]))
    talk.wait(lambda: talk.received(Com.HEALTH))
    assert not talk.received(Com.POSE)
    assert not talk.received(Com.JOINTS)


def port_that_is_taken(talk: Talk) -> None:
    """Another process has the port; it is tried again until it is free."""
    talk.wait(lambda: PORT in talk.machine.tcp.listening, beat=False)
    talk.machine.tcp.end_listen(PORT)
    talk.network.listen(PORT)
    talk.live(2.5)


def receiver_aborted(talk: Talk) -> None:
    """PCABORT 2: at the terminal."""
    moving(talk).machine.control.tasks[2].set_state("idle")
    talk.live(0.7, beat=True)


def before_its_limits(talk: Talk) -> None:
    """A motion on a connection on which one bank of command 10 is missing."""
    talk.hello(limits=None)
    talk.send(Com.LIMITS, 0, LIMITS)
    for bank, vec in SET_UP[1:]:
        talk.send(Com.LIMITS, bank, vec)
    talk.send(Com.TCP, 0, NO_TCP)
    talk.do(Com.MOVE_POSE, 0, talk.shifted_vec(z=10.0))


def out_of_the_box(talk: Talk) -> None:
    """A floor 5 mm below the flange, and 10 mm down."""
    floor = talk.shifted_vec(z=-5.0)[2]
    talk.hello(lower=(*LOWER[:2], floor, 0, 0, 0))
    talk.do(Com.MOVE_POSE, 0, talk.shifted_vec(z=-10.0))


def turned_too_far(talk: Talk) -> None:
    """10 degrees are allowed."""
    talk.hello(motion=(5_000, *MOTION[1:]))
    talk.do(Com.MOVE_BY_JOINTS, 0, (0, 0, 0, 0, 0, 11 * SCALES[2]))


def leap_of_a_stream(talk: Talk) -> None:
    """21 mm; 20 are allowed."""
    talk.hello()
    talk.do(Com.SET_POINT, 0, talk.shifted_vec(z=21.0))


def faster_than_allowed(talk: Talk) -> None:
    """1000.1 mm/s."""
    talk.hello()
    talk.do(Com.SPEEDS, 0, (10_000, 10_000, 10_000, 10_001, 0, 0))


def client_from_elsewhere(talk: Talk) -> None:
    """Another address than the PC's."""
    talk.dial((192, 168, 0, 11))
    talk.write(HELLO)
    talk.live(0.2)


def connection_error_that_stands(talk: Talk) -> None:
    """The cable is pulled on a controller on which that ends the programs."""
    hardware = talk.machine.hardware
    hardware.behaviour = hardware.behaviour.model_copy(update={"tcp_error_stands": True})
    moving(talk).stream.reset()
    talk.live(3.0)


FAULTS: dict[int, Callable[[Talk], None]] = {
    1: silence,
    2: no_wrench,
    3: hold_on_the_pendant,
    4: letters,
    5: full_ring,
    6: farther_than_allowed,
    7: pressed_too_hard,
    8: tool_of_another_program,
    9: beyond_the_reach,
    10: pose_that_does_not_fit,
    11: port_that_is_taken,
    12: receiver_aborted,
    13: before_its_limits,
    14: out_of_the_box,
    15: turned_too_far,
    16: leap_of_a_stream,
    17: faster_than_allowed,
    18: client_from_elsewhere,
    19: connection_error_that_stands,
}
LATCHED = {1, 2, 3}
CLOSED = {*LATCHED, 4, 5, 12, 18, 19}  # the connection ends with these
UNGREETED = {11, 18}  # no client has sent a hello
RESTARTED = {12, 19}  # a silence may come first, and a program that is started again latches


def found(talk: Talk) -> float:
    """The fault of a hold, or else why the last target was refused."""
    return float(talk.value("fm.fault") or talk.value("fm.refd"))


def test_no_fault_of_the_readme_and_of_the_program_is_left_out_here() -> None:
    """Three lists, one set of numbers: of holds, and of refused targets."""
    codes = {int(code) for code in re.findall(r"(?:fm\.refd|\.bad|fm\.fault)=(\d+)", TEXT)}
    documented = set(
        map(int, re.findall(r"^\| (\d+) \|", README.split("## Faults")[1], re.MULTILINE))
    )
    assert set(FAULTS) == documented == codes - {0}


@pytest.mark.parametrize("code", FAULTS, ids=lambda code: FAULTS[code].__name__)
def test_each_fault_has_its_number_and_stops_the_arm(code: int, behaviour: Behaviour) -> None:
    """Held or never moved; latched and closed where the README has it, and only there."""
    talk = Talk(behaviour, text=with_peer(*LOOPBACK))
    FAULTS[code](talk)
    assert found(talk) == code
    assert still(talk)
    assert found(talk) == code
    assert talk.value("fm.mode") == 0
    if code not in UNGREETED | RESTARTED:
        assert (talk.value("fm.lat") != talk.value("fm.lack")) == (code in LATCHED)
    if code in CLOSED:
        talk.wait(lambda: talk.closed, 2.0, beat=False)
    elif code != 11:
        assert not talk.closed
        assert talk.fault == code


@pytest.mark.parametrize("code", sorted(CLOSED - {3}))  # 3: fm.main itself has ended
def test_a_fault_that_closed_the_connection_is_reported_to_the_next_one(code: int) -> None:
    """README: it stays until the next motion or start."""
    talk = Talk(text=with_peer(*LOOPBACK))
    FAULTS[code](talk)
    talk.wait(lambda: talk.closed, 2.0, beat=False)
    if talk.machine.control.held:
        talk.pendant.run()
    talk.hello(limits=None)
    assert talk.fault == code
    talk.set_up()
    talk.move_up(5.0)
    talk.live(1.0, beat=True)
    assert talk.fault == 0


@pytest.mark.parametrize("component", range(6))
@pytest.mark.parametrize("frame", ["T_flange_tcp", "T_base_shift"])
def test_each_component_of_tool_and_base_is_checked(frame: str, component: int) -> None:
    """1 mm or 1 degree of any of them would put the arm somewhere else: fault 8, nothing moves."""
    talk = Talk()
    talk.hello()
    shift = np.where(np.arange(6) == component, (*[1e-3] * 3, *[np.radians(1.0)] * 3), 0.0)
    setattr(talk.robot, frame, pin.SE3(pin.rpy.rpyToMatrix(shift[3:]), shift[:3]))
    q, target = talk.robot.q, talk.shifted_vec(z=10.0)
    talk.do(Com.MOVE_POSE, 0, target)
    talk.wait(lambda: talk.fault == 8, 1.0)
    talk.live(0.5, beat=True)
    assert np.allclose(talk.robot.q, q, atol=1e-4)
    setattr(talk.robot, frame, pin.SE3.Identity())
    z = talk.height_mm()
    talk.send(Com.HOLD)
    talk.send(Com.MOVE_POSE, 0, target)
    talk.wait(lambda: talk.height_mm() > z + 9.9)
    assert talk.status & Status.HELD == 0


@pytest.mark.parametrize("axis", range(3))
def test_no_pose_is_sent_when_any_coordinate_does_not_fit(axis: int) -> None:
    """No number is ever clipped: 103 reports 10, and nothing else comes."""
    talk = Talk()
    talk.hello()
    talk.robot.T_base_shift = pin.SE3(np.eye(3), 3.0 * np.eye(3)[axis])  # a BASE 3 m away
    talk.wait(lambda: talk.fault == 10, 1.0, beat=False)
    before = len(talk.received(Com.POSE)), len(talk.received(Com.JOINTS))
    talk.live(0.5)
    assert (len(talk.received(Com.POSE)), len(talk.received(Com.JOINTS))) == before
