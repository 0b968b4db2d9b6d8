"""Corrupted digits of reports to the gateway: the planned motion stays bounded.

101 and 102 have no checksum either. During a motion a wrong report ends it or is ignored. A stream
begins at the reported pose, so a wrong report there sends a wrong first set point; the controller
compares it with its measured pose and accepts it only within a set point's step. The planned motion
of the program is judged, not only the travel of the arm: the next correct report would correct the
travel and hide that a wrong motion was accepted.
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
from tests.contract.hostile import HostileCell
from tests.contract.rig import shifted
from tests.fakes.hostile_stream import Rewrite

DOWN = "to_gateway"
PLACES = [k for k in range(PACKET_CHARS) if k % FRAME_STRIDE != FRAME_STRIDE - 1]
FLIPS = [(com, place, char) for com in (b"000101", b"000102")
         for place in PLACES for char in b"0123456789-"]  # fmt: skip
ASIDE_M = 1e-3  # from the straight path up, which is the commanded motion
ASIDE_RAD = 2e-3
STEP_MARGIN = 1.1
BLEND = 1.5
PARTS = 8
EVERY = bool(os.environ.get("EVERY_FLIP"))  # hours
EVERY_S, LONG_S = 6 * 3600, 300
random.Random(5).shuffle(FLIPS)


class Spoilt:
    """Corrupts reports of a kind in one digit: the next one, or all from now on."""

    def __init__(self, com: bytes, place: int, char: Callable[[int], int], *, all_: bool) -> None:
        self.com, self.place, self.char, self.all = com, place, char, all_
        self.done = False

    def __call__(self, packet: bytes) -> bytes:
        """Return the packet to pass on."""
        if packet[7:13] != self.com or (self.done and not self.all):
            return packet
        self.done = True
        spoilt = self.char(packet[self.place])
        return packet[: self.place] + bytes([spoilt]) + packet[self.place + 1 :]


def other(digit: int) -> int:
    """Return the next digit; a sign becomes a digit."""
    return ord("0123456789"[(digit - ord("0") + 1) % 10])


def is_near_path(cell: HostileCell, first: tuple[int, int], far_m: float, far_rad: float) -> bool:
    """Return whether planned and commanded poses since `first` are near the straight path up."""
    robot, limits = cell.machine.robot, cell.rig.cell.limits
    T_first = robot.pose_of(cell.commands[first[0]])
    commanded = [robot.pose_of(q) for q in cell.commands[first[0] :]]
    aside = [T_first.actInv(T) for T in commanded + cell.planned[first[1] :]]
    up_m = np.array([T_first.rotation @ T.translation for T in aside])
    steps_m = np.linalg.norm(np.diff([T.translation for T in commanded], axis=0), axis=1)
    return bool(
        np.linalg.norm(up_m[:, :2], axis=1).max() < far_m
        and -far_m < up_m[:, 2].min()
        and up_m[:, 2].max() < 0.06 + far_m
        and max(np.linalg.norm(pin.log3(T.rotation)) for T in aside) < far_rad
        and steps_m.max() < BLEND * limits.speed_m_s * 1e-3
    )


def spoil_in_motion(motion: str, com: bytes, place: int, char: int) -> None:
    """Move up by 60 mm as a goal or a stream, or while a force pushes, and corrupt reports."""
    cell = HostileCell()
    cell.begin(motion)
    first = len(cell.commands), len(cell.planned)
    cell.network.strike(DOWN, Rewrite(turn=Spoilt(com, place, lambda _: char, all_=False)))
    cell.rig.advance(0.4)
    assert is_near_path(cell, first, ASIDE_M, ASIDE_RAD)
    cell.assert_obeys_after_arming()


def begin_spoilt(com: bytes, place: int, char: Callable[[int], int]) -> HostileCell:
    """Begin a stream at a reported pose that is corrupted in one digit, and judge it.

    The regulator begins at the reported pose too, so no process on the PC can detect the error.
    """
    cell = HostileCell()
    cell.rig.connect()
    cell.rig.arm()
    first = len(cell.commands) - 1, len(cell.planned)
    spoilt = Spoilt(com, place, char, all_=True)
    cell.network.strike(DOWN, Rewrite(turn=spoilt))
    cell.rig.advance(0.1, lambda: spoilt.done)
    cell.rig.advance(0.05)
    cell.rig.send("setpoint", pose=record_of(shifted(cell.rig.T, z_m=0.002)))
    cell.rig.advance(0.4)
    section = cell.rig.cell.gateway
    assert section is not None
    step_m, step_rad = set_point_step(cell.rig.cell, section)
    assert is_near_path(
        cell, first, STEP_MARGIN * step_m + ASIDE_M, STEP_MARGIN * step_rad + ASIDE_RAD
    )
    return cell


def spoil(com: bytes, place: int, char: int) -> None:
    """Corrupt reports in every motion and at the beginning of a stream."""
    for motion in ("goal", "stream", "feedback"):
        spoil_in_motion(motion, com, place, char)
    begin_spoilt(com, place, lambda _: char)


@pytest.mark.parametrize("digit", [1, 2])
@pytest.mark.parametrize("field", range(6))
def test_a_stream_begins_no_farther_than_a_step_from_where_the_arm_is(
    field: int, digit: int
) -> None:
    """The next digit in hundreds and tens of millimetres, and in tens of degrees and degrees.

    200 mm or 20 degrees are refused by the controller alone: all other checks use the report.
    """
    cell = begin_spoilt(b"000101", (3 + field) * FRAME_STRIDE + digit, other)
    if digit == 1 and field < 4:
        assert [packet for packet in cell.taken if packet.chars[7:13] == "000013"]
        assert "the controller refused a set point" in cell.rig.state.hold_reason


@pytest.mark.long
@pytest.mark.timeout(EVERY_S if EVERY else LONG_S)
@pytest.mark.parametrize("part", range(PARTS))
def test_no_corrupted_digit_of_a_report_causes_a_wrong_motion(part: int) -> None:
    """A digit of a field of 101 or 102, everywhere; in the nightly run every one in turn."""
    for flip in FLIPS[part::PARTS] if EVERY else FLIPS[part : part + 1]:
        spoil(*flip)
