"""Digits of reports spoilt on their way to the gateway: what is planned is bounded all the same.

101 and 102 have no checksum either. In the middle of a motion a wrong report ends it or is passed
over. A stream begins at the reported pose, so a report that is wrong there sends a wrong first set
point; the controller judges it by where the arm really is, and takes it only within a set point's
step. What is judged is what the program plans, not only how far the arm comes: the next right
report would mend that, and hide that a wrong motion was taken.
"""

import os
import random
from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest

from common.motion.convert import record_of
from controller.packet import FRAME_STRIDE, PACKET_CHARS
from services.gateway.service import set_point_step
from tests.contract.rig import shifted
from tests.fakes.hostile_cell import HostileCell
from tests.fakes.hostile_stream import Rewrite

DOWN = "to_gateway"
PLACES = [k for k in range(PACKET_CHARS) if k % FRAME_STRIDE != FRAME_STRIDE - 1]
FLIPS = [(com, place, char) for com in (b"000101", b"000102")
         for place in PLACES for char in b"0123456789-"]  # fmt: skip
ASIDE_M = 1e-3  # of the straight way up, on which the arm goes anyway
ASIDE_RAD = 2e-3
STEP_MARGIN = 1.1
BLEND = 1.5
SAMPLE, PARTS = 3, 8
EVERY = bool(os.environ.get("EVERY_FLIP"))  # hours
EVERY_S, LONG_S = 6 * 3600, 300
random.Random(5).shuffle(FLIPS)


class Spoilt:
    """Spoils reports of a kind in one place: the next one, or all from now on."""

    def __init__(self, com: bytes, place: int, char: Callable[[int], int], *, all_: bool) -> None:
        self.com, self.place, self.char, self.all = com, place, char, all_
        self.done = False

    def __call__(self, packet: bytes) -> bytes:
        """Return the packet as it is passed on."""
        if packet[7:13] != self.com or (self.done and not self.all):
            return packet
        self.done = True
        spoilt = self.char(packet[self.place])
        return packet[: self.place] + bytes([spoilt]) + packet[self.place + 1 :]


def other(digit: int) -> int:
    """Return the next digit; a sign becomes a digit."""
    return ord("0123456789"[(digit - ord("0") + 1) % 10])


def within(cell: HostileCell, first: tuple[int, int], far_m: float, far_rad: float) -> bool:
    """Tell whether all that was planned and commanded since then is near the way straight up."""
    robot, limits = cell.machine.robot, cell.rig.cell.limits
    T_first = robot.pose_of(cell.commands[first[0]])
    way = [robot.pose_of(q) for q in cell.commands[first[0] :]]
    aside = [T_first.actInv(T) for T in way + cell.planned[first[1] :]]
    up_m = np.array([T_first.rotation @ T.translation for T in aside])
    steps_m = np.linalg.norm(np.diff([T.translation for T in way], axis=0), axis=1)
    return bool(
        np.linalg.norm(up_m[:, :2], axis=1).max() < far_m
        and -far_m < up_m[:, 2].min()
        and up_m[:, 2].max() < 0.06 + far_m
        and max(np.linalg.norm(pin.log3(T.rotation)) for T in aside) < far_rad
        and steps_m.max() < BLEND * limits.speed_m_s * 1e-3
    )


def spoil_in_motion(motion: str, com: bytes, place: int, char: int) -> None:
    """The arm goes up: 60 mm as a goal or a stream, or as long as a force pushes."""
    cell = HostileCell()
    cell.begin(motion)
    first = len(cell.commands), len(cell.planned)
    cell.network.strike(DOWN, Rewrite(turn=Spoilt(com, place, lambda _: char, all_=False)))
    cell.rig.advance(0.4)
    assert within(cell, first, ASIDE_M, ASIDE_RAD)
    cell.assert_obeys_after_arming()


def begin_spoilt(com: bytes, place: int, char: Callable[[int], int]) -> HostileCell:
    """Begin a stream where the arm is said to be, every report spoilt in one place; judge it.

    The regulator too begins at the reported pose, so nothing on the PC can see that it is wrong.
    """
    cell = HostileCell()
    cell.rig.connect()
    cell.rig.arm()
    first = len(cell.commands) - 1, len(cell.planned)
    spoilt = Spoilt(com, place, char, all_=True)
    cell.network.strike(DOWN, Rewrite(turn=spoilt))
    cell.rig.advance(0.1, lambda: spoilt.done)
    cell.rig.advance(0.05)
    cell.rig.say("setpoint", pose=record_of(shifted(cell.rig.T, z_m=0.002)))
    cell.rig.advance(0.4)
    section = cell.rig.cell.gateway
    assert section is not None
    step_m, step_rad = set_point_step(cell.rig.cell, section)
    assert within(cell, first, STEP_MARGIN * step_m + ASIDE_M, STEP_MARGIN * step_rad + ASIDE_RAD)
    return cell


def set_points(cell: HostileCell) -> list[str]:
    """Return the set points that the program has taken from its ring."""
    return [packet.chars for packet in cell.taken if packet.chars[7:13] == "000013"]


def spoil(com: bytes, place: int, char: int) -> None:
    """In every motion, and at the beginning of a stream."""
    for motion in ("goal", "stream", "feedback"):
        spoil_in_motion(motion, com, place, char)
    begin_spoilt(com, place, lambda _: char)


def test_a_report_that_is_wrong_by_less_than_a_step_begins_a_stream_there() -> None:
    """So the spoilt reports do get in: the first set point is what was reported, not the truth."""
    cell = begin_spoilt(b"000101", place_of(field=0, digit=3), other)
    assert set_points(cell)[0].split()[3] == "000100"  # 2 mm
    assert len(cell.planned) > 2


@pytest.mark.parametrize("digit", [1, 2])
@pytest.mark.parametrize("field", range(6))
def test_a_stream_begins_no_farther_than_a_step_from_where_the_arm_is(
    field: int, digit: int
) -> None:
    """The next digit in hundreds and tens of millimetres, and in tens of degrees and degrees."""
    begin_spoilt(b"000101", place_of(field, digit), other)


@pytest.mark.parametrize("field", range(4))
def test_the_controller_alone_refuses_to_begin_at_a_pose_it_is_not_at(field: int) -> None:
    """200 mm or 20 degrees: everybody else believes the report, and lets the set point through."""
    cell = begin_spoilt(b"000101", place_of(field, digit=1), other)
    assert set_points(cell)
    assert "the controller refused a set point" in cell.rig.state.hold_reason


def place_of(field: int, digit: int) -> int:
    """Return where a digit of one of the six numbers stands in a packet."""
    return (3 + field) * FRAME_STRIDE + digit


@pytest.mark.parametrize("number", range(SAMPLE))
def test_a_spoilt_digit_of_a_report_moves_nothing_that_should_not(number: int) -> None:
    """One of the numbers' first digits, in one of the situations."""
    flips = [flip for flip in FLIPS if flip[1] > 20 and flip[1] % FRAME_STRIDE < 3]
    spoil_in_motion(("goal", "stream", "feedback")[number], *flips[number])


@pytest.mark.long
@pytest.mark.timeout(EVERY_S if EVERY else LONG_S)
@pytest.mark.parametrize("part", range(PARTS))
def test_no_spoilt_digit_of_a_report_moves_anything_that_should_not(part: int) -> None:
    """A digit of a field of 101 or 102, everywhere; `make flips` spoils every one in turn."""
    for flip in FLIPS[part::PARTS] if EVERY else FLIPS[part : part + 1]:
        spoil(*flip)
