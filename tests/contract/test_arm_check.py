"""Detections of the robot's own process while the arm moves: H22, H41 and H42."""

import random
from collections.abc import Callable

import numpy as np
import pytest

from common.motion.convert import record_of
from controller.packet_table import Scales, Status
from forcemesh.clock import ManualClock
from services.gateway.service import Gateway
from sim.controller.machine import Pendant
from tests.contract.hostile import ARM_STILL_RAD, HostileCell
from tests.contract.rig import Rig, gateway_cell, shifted
from tests.fakes.controller import PORT
from tests.fakes.hostile_stream import Reset, Rewrite
from tests.fuzz.permissive_arbiter import PermissiveController

UP, DOWN = "to_controller", "to_gateway"
REPORT_S = 0.040  # two samples of the program's sender are at most this far apart here
BRAKE_S = 0.07

PENDANT: dict[str, tuple[Callable[[Pendant], None], str]] = {
    "motors off": (lambda pendant: pendant.motor_power(on=False), "robot_motors"),
    "emergency stop": (lambda pendant: pendant.emergency_stop(), "robot_motors"),
    "teach": (lambda pendant: pendant.teach(), "robot_teach"),
    "teach lock": (lambda pendant: pendant.teach_lock(on=True), "robot_lock"),
    "hold": (lambda pendant: pendant.hold(), "robot_program"),
}
BITS = {
    Status.MOTOR_POWER: "robot_motors",
    Status.REPEAT_MODE: "robot_teach",
    Status.TEACH_LOCK_OFF: "robot_lock",
    Status.PROGRAM_RUNNING: "robot_program",
    Status.WATCHDOG_LATCHED: "robot_latched",
    Status.ERROR: "robot_error",
}


# --- H42: the controller reports that it does not execute commands --------------------------------


@pytest.mark.parametrize("motion", ["goal", "stream", "feedback"])
@pytest.mark.parametrize("what", PENDANT)
def test_what_a_person_does_at_the_pendant_stops_the_arm_under_its_own_code(
    what: str, motion: str
) -> None:
    """The program stops at once and latches; the cause is named with its next report.

    Undoing the intervention starts no motion.
    """
    act, code = PENDANT[what]
    cell = HostileCell()
    cell.begin(motion)
    act(cell.machine.pendant)
    done_ns = cell.rig.clock.now_ns()
    codes: list[str] = []

    def is_named() -> bool:
        codes.append(cell.rig.state.hold_code)
        return codes[-1] == code

    assert cell.rig.advance(1.0, is_named), cell.rig.state
    assert set(codes) <= {"", "robot_link", "robot_latched", code}
    assert codes.index(next(filter(None, codes))) <= 2e3 * REPORT_S
    assert (cell.stopped_ns(done_ns) - done_ns) / 1e9 <= BRAKE_S
    pendant = cell.machine.pendant
    pendant.release_emergency_stop()
    pendant.motor_power(on=True)
    pendant.repeat()
    pendant.teach_lock(on=False)
    cell.rig.advance(BRAKE_S)  # it may be named before the servos have settled
    q = cell.joints[-1]
    cell.rig.advance(1.0)
    assert np.abs(cell.joints[-1] - q).max() <= ARM_STILL_RAD
    assert cell.rig.state.hold_reason or not cell.rig.state.valid


@pytest.mark.parametrize("bit", BITS, ids=[str(bit.name) for bit in BITS])
def test_a_status_bit_alone_stops_the_arm_and_its_return_does_not_start_it(bit: Status) -> None:
    """Toggled in transit, so that the controller itself does not know of it."""
    cell = HostileCell()
    cell.begin("goal")

    def turn(packet: bytes) -> bytes:
        if packet[7:13] not in {b"000101", b"000102"}:
            return packet
        param = int(packet[14:20])
        return packet[:14] + b"%06d" % (param ^ int(bit)) + packet[20:]

    abuse = cell.network.strike(DOWN, Rewrite(turn=turn))
    toggled_ns = cell.rig.clock.now_ns()
    assert cell.rig.advance(2 * REPORT_S, lambda: cell.rig.state.hold_code), cell.rig.state
    assert cell.rig.state.hold_code == BITS[bit]
    cell.network.strike(DOWN, Rewrite(turn=lambda packet: packet))
    cell.rig.advance(0.3)
    assert abuse.bites
    assert (cell.stopped_ns(toggled_ns) - toggled_ns) / 1e9 <= BRAKE_S + 2 * REPORT_S
    cell.assert_stays(0.5)
    assert cell.rig.state.hold_code == BITS[bit]
    cell.assert_obeys_after_arming()


# --- H41: the arm is not where it was commanded ---------------------------------------------------


class UnresponsiveController(PermissiveController):
    """A fake controller that accepts every command and does not move."""

    def _move(self, dt_s: float) -> None:
        pass


def test_a_controller_that_accepts_set_points_and_ignores_them_is_detected() -> None:
    """20 mm/s, and the arm stands: detected by its reports, not by accepted set points."""
    wire = UnresponsiveController((0.0, 0.0, -1.5, 0.0, -1.5, 0.0))
    rig = Rig(gateway_cell(PORT), ManualClock(), lambda bus, cell: Gateway(bus, cell, wire))
    rig.connect()
    rig.arm()
    start = rig.T
    for step in range(1, 400):
        rig.send("setpoint", pose=record_of(shifted(start, z_m=8e-5 * step)))
        rig.advance(0.004)
        if rig.state.hold_code:
            break
    assert rig.state.hold_code == "tracking"
    rig.send("idle")
    rig.advance(0.3)
    assert "lease" in rig.state.hold_reason


# --- H22: the link is lost in motion, at any byte -------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_after_a_reset_at_any_byte_the_first_set_point_is_the_measured_pose(seed: int) -> None:
    """Nothing is commanded before arming; then the stream begins at the measured pose."""
    cell = HostileCell()
    cell.begin("stream")
    abuse = cell.network.strike(UP, Reset(after=random.Random(seed).randrange(300)))
    cell.rig.advance(0.6)
    assert abuse.bites
    cell.rig.connect()
    cell.assert_stays(0.3)
    sent = packets_of(cell.hops[-1].to_controller.sent)
    assert {com for com, _ in sent} == {9, 8, 10, 11}, "hello, hold, limits, TCP"
    cell.rig.arm()
    measured = packets_of(cell.hops[-1].to_gateway.sent)
    cell.rig.send("setpoint", pose=record_of(shifted(cell.rig.T, z_m=0.002)))
    cell.rig.advance(0.1)
    motions = [vec for com, vec in packets_of(cell.hops[-1].to_controller.sent) if com == 13]
    first, reported = (
        [int(frame) for frame in vec.split()]
        for vec in (motions[0], [vec for com, vec in measured if com == 101][-1])
    )
    assert first[:3] == reported[:3]
    turn = 360 * Scales().oat_per_deg  # 180 and -180 degrees are the same
    assert all((a - b) % turn == 0 for a, b in zip(first[3:6], reported[3:6], strict=True))


def packets_of(sent: bytes | bytearray) -> list[tuple[int, bytes]]:
    """Return command and vector of each whole packet."""
    whole = [bytes(sent[at : at + 63]) for at in range(0, len(sent) - 62, 63)]
    return [(int(chars[7:13]), chars[21:]) for chars in whole]
