"""One digit of one report spoilt on its way to the gateway: what moves is bounded all the same.

101 and 102 have no checksum either. In the middle of a motion a wrong report ends it or is passed
over; a stream that begins right at a wrong pose goes there by one set point's step at most, and the
controller judges that step by where the arm really is.
"""

import os
import random

import numpy as np
import pytest

from common.convert import record_of
from common.packet import FRAME_STRIDE, PACKET_CHARS
from services.gateway.service import STEP_MARGIN, set_point_step
from tests.contract.rig import shifted
from tests.fakes.hostile_cell import HostileCell
from tests.fakes.hostile_stream import Rewrite

DOWN = "to_gateway"
PLACES = [k for k in range(PACKET_CHARS) if k % FRAME_STRIDE != FRAME_STRIDE - 1]
FLIPS = [(com, place, char) for com in (b"000101", b"000102")
         for place in PLACES for char in b"0123456789-"]  # fmt: skip
ASIDE_M = 1e-3  # of the straight way up, on which the arm goes anyway
BLEND = 1.5
SAMPLE, PARTS = 4, 8
EVERY = bool(os.environ.get("EVERY_FLIP"))  # hours
EVERY_S, LONG_S = 6 * 3600, 300
random.Random(5).shuffle(FLIPS)


class Once:
    """Spoils the next report of a kind, and no other."""

    def __init__(self, com: bytes, place: int, char: int) -> None:
        self.com, self.place, self.char, self.done = com, place, char, False

    def __call__(self, packet: bytes) -> bytes:
        """Return the packet as it is passed on."""
        if self.done or packet[7:13] != self.com:
            return packet
        self.done = True
        return packet[: self.place] + bytes([self.char]) + packet[self.place + 1 :]


def judge(cell: HostileCell, first: int, far_m: float) -> None:
    """Every commanded pose since then: near the way straight up, and no faster than is allowed."""
    robot, limits = cell.machine.robot, cell.rig.cell.limits
    way = np.array([robot.pose_of(q).translation for q in cell.commands[first:]])
    aside_m = np.linalg.norm((way - way[0])[:, :2], axis=1).max()
    below_m = (way[0] - way)[:, 2].max()
    assert max(aside_m, below_m) < far_m
    assert (way - way[0])[:, 2].max() < 0.06 + far_m
    steps_m = np.linalg.norm(np.diff(way, axis=0), axis=1)
    assert steps_m.max() < BLEND * limits.speed_m_s * 1e-3


def spoil_in_motion(motion: str, com: bytes, place: int, char: int) -> None:
    """The arm goes up: 60 mm as a goal or a stream, or as long as a force pushes."""
    cell = HostileCell()
    cell.begin(motion)
    first = len(cell.commands)
    cell.network.strike(DOWN, Rewrite(turn=Once(com, place, char)))
    cell.rig.advance(0.4)
    judge(cell, first, ASIDE_M)
    cell.assert_obeys_after_arming()


def spoil_at_the_beginning(com: bytes, place: int, char: int) -> None:
    """The report from which a stream is seeded: a step at most, whatever it said."""
    cell = HostileCell()
    cell.rig.connect()
    cell.rig.arm()
    start, first = cell.rig.T, len(cell.commands)
    turn = Once(com, place, char)
    cell.network.strike(DOWN, Rewrite(turn=turn))
    cell.rig.advance(0.1, lambda: turn.done)
    cell.rig.say("setpoint", pose=record_of(shifted(start, z_m=0.002)))
    cell.rig.advance(0.4)
    section = cell.rig.cell.gateway
    assert section is not None
    judge(cell, first, STEP_MARGIN * set_point_step(cell.rig.cell, section)[0] + ASIDE_M)


def spoil(flip: tuple[bytes, int, int]) -> None:
    """In every motion, and at the beginning of a stream."""
    for motion in ("goal", "stream", "feedback"):
        spoil_in_motion(motion, *flip)
    spoil_at_the_beginning(*flip)


@pytest.mark.parametrize("number", range(SAMPLE))
def test_a_spoilt_digit_of_a_report_moves_nothing_that_should_not(number: int) -> None:
    """One of the numbers' first digits, in one of the situations."""
    flips = [flip for flip in FLIPS if flip[1] > 20 and flip[1] % FRAME_STRIDE < 3]
    if number == SAMPLE - 1:
        spoil_at_the_beginning(*flips[number])
    else:
        spoil_in_motion(("goal", "stream", "feedback")[number], *flips[number])


@pytest.mark.long
@pytest.mark.timeout(EVERY_S if EVERY else LONG_S)
@pytest.mark.parametrize("part", range(PARTS))
def test_no_spoilt_digit_of_a_report_moves_anything_that_should_not(part: int) -> None:
    """A digit of a field of 101 or 102, everywhere; `make flips` spoils every one in turn."""
    for flip in FLIPS[part::PARTS] if EVERY else FLIPS[part : part + 1]:
        spoil(flip)
