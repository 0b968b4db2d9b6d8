"""The whole gateway: the bus at one end, a controller on a real socket at the other."""

from collections.abc import Iterator
from typing import Any

import pytest

from common.motion.convert import record_of
from controller.packet_table import Com, Status
from tests.contract.rig import pose_goal, shifted
from tests.fakes.gateway_cell import GatewayCell, a_cell_on_sockets

pytestmark = pytest.mark.realtime

MOTION = (
    Com.MOVE_POSE, Com.MOVE_JOINTS, Com.MOVE_BY_JOINTS, Com.SET_POINT, Com.WRENCH, Com.FEEDBACK,
)  # fmt: skip


@pytest.fixture
def cell() -> Iterator[GatewayCell]:
    """Yield a connected cell."""
    with a_cell_on_sockets() as cell:
        cell.rig.connect()
        yield cell


def test_a_gateway_without_a_controller_reports_it_at_its_rate() -> None:
    """The state is not valid, has the address, and is published at its rate."""
    with a_cell_on_sockets() as cell:
        cell.controller.tantrums.greet = False
        cell.rig.until(lambda: len(cell.rig.states) > 20, within_s=1.0)
        assert not cell.rig.state.valid
        assert cell.rig.state.reason == cell.rig.service.fault
        assert not cell.rig.state.link.connected


def test_after_hello_the_controller_gets_hold_and_limits(cell: GatewayCell) -> None:
    """Nothing else is sent without permission, and this does not latch the controller."""
    cell.rig.advance(1.2)  # longer than the watchdog
    sent = [packet.com for packet in cell.controller.of(*Com)]
    assert sent == [Com.HELLO, Com.HOLD, *[Com.LIMITS] * 6, Com.TCP]
    assert (cell.controller.connections, cell.controller.errors) == (1, [])
    assert cell.controller.robot.watchdog_s == pytest.approx(1.0)


def test_permission_is_the_heartbeat(cell: GatewayCell) -> None:
    """With permission command 12 is sent; after a hold one 8 and nothing more."""
    cell.rig.arm()
    cell.rig.until(lambda: len(cell.controller.of(Com.HEARTBEAT)) >= 5)
    cell.rig.send_hold()
    cell.rig.until(lambda: cell.rig.state.hold_reason)
    cell.rig.advance(0.1)
    sent = len(cell.controller.received)
    cell.rig.advance(0.2)
    assert len(cell.controller.received) == sent
    assert cell.controller.received[-1].packet.com == Com.HOLD


def test_status_bits_of_the_controller_are_published(cell: GatewayCell) -> None:
    """Every status bit has its name in robot/state."""
    cell.controller.robot.status &= ~Status.TEACH_LOCK_OFF
    cell.reports_pass()
    status = cell.rig.state.status
    bits = status.kawasaki
    assert bits is not None
    assert (bits.motor_power, bits.teach_lock_off) == (True, False)
    assert (status.ready, status.held) == (False, True)
    assert [fault.code for fault in status.faults] == ["robot_lock"]


@pytest.mark.parametrize(
    ("bit", "on", "message"),
    [
        (Status.MOTOR_POWER, False, "motors are off"),
        (Status.PROGRAM_RUNNING, False, "program is not running"),
        (Status.ERROR, True, "reports an error"),
    ],
)
def test_a_controller_that_is_not_ready_ends_the_lease(
    cell: GatewayCell, bit: Status, on: bool, message: str
) -> None:
    """The gateway checks the bits itself; when they are good again, the lease stays ended."""
    cell.rig.arm()
    cell.controller.robot.status ^= bit
    cell.rig.until(lambda: message in cell.rig.state.hold_reason)
    cell.controller.robot.status ^= bit
    cell.rig.advance(0.2)
    assert message in cell.rig.state.hold_reason


@pytest.mark.parametrize("ending", ["close", "reset", "garbage"])
def test_a_lost_link_ends_in_hold_and_stays_there(cell: GatewayCell, ending: str) -> None:
    """It reconnects, holds and waits for a new lease; the motion does not continue."""
    rig = cell.rig
    rig.arm()
    start = rig.T
    rig.send("goal", goal=pose_goal(1, shifted(start, z_m=0.1)))
    rig.until(lambda: rig.T.translation[2] > start.translation[2] + 0.005)
    if ending == "garbage":
        cell.controller.write(b"000000 garbage")
    else:
        cell.controller.drop(reset=ending == "reset")
    rig.until(lambda: not rig.state.valid)
    assert (rig.state.goal.state, rig.state.link.connected) == ("refused", False)
    rig.until(lambda: rig.state.valid)
    assert rig.state.hold_reason
    assert rig.state.link.reconnects == 1
    assert rig.state.link.errors == (ending == "garbage")
    assert rig.is_at_rest()
    stopped = rig.T
    assert stopped.translation[2] < start.translation[2] + 0.09
    motions = len(cell.controller.of(*MOTION))
    rig.advance(0.2)  # the old lease still commands its goal
    assert len(cell.controller.of(*MOTION)) == motions
    rig.arm()
    rig.send("goal", goal=pose_goal(2, shifted(stopped, z_m=-0.005)))
    rig.until(lambda: rig.state.goal.id == 2 and rig.state.goal.state == "done")


def test_the_first_set_point_is_the_measured_pose(cell: GatewayCell) -> None:
    """This holds after every hold and reconnect, exactly to the unit, for any stream."""
    rig = cell.rig
    for _ in range(2):
        rig.arm()
        assert rig.is_at_rest()
        cell.controller.received.clear()
        measured = cell.controller.robot.pose_vec()
        rig.send("setpoint", pose=record_of(shifted(rig.T, z_m=0.002)))
        rig.until(lambda: cell.controller.of(Com.SET_POINT))
        assert cell.controller.of(Com.SET_POINT)[0].vec == measured
        cell.controller.drop()
        rig.until(lambda: not rig.state.valid)
        rig.connect()


def test_a_controller_that_answers_is_connected_without_a_pause(cell: GatewayCell) -> None:
    """Pauses grow over failed attempts, not over connections that worked."""
    for lost in range(1, 5):
        cell.controller.drop()
        cell.rig.until(lambda: not cell.rig.state.valid)
        started_ns = cell.rig.clock.now_ns()
        cell.rig.connect()
        assert cell.rig.state.link.reconnects == lost
        assert cell.rig.clock.now_ns() - started_ns < 600_000_000  # the fourth would be 800 ms


def test_a_new_process_does_not_continue_the_ids_of_the_old_one() -> None:
    """Otherwise it would take reports about old commands for its own."""
    with a_cell_on_sockets() as cell, a_cell_on_sockets() as other:
        for one in (cell, other):
            one.rig.connect()
        assert cell.controller.of(Com.HELLO)[0].id != other.controller.of(Com.HELLO)[0].id


def test_a_frozen_controller_is_detected_before_its_socket_closes(cell: GatewayCell) -> None:
    """A stale pose is not published as a fresh one: not valid, and the lease is ended."""
    cell.rig.arm()
    cell.controller.tantrums.frozen = True
    cell.rig.until(lambda: not cell.rig.state.valid, within_s=1.0)
    assert "old" in cell.rig.state.reason
    cell.controller.tantrums.frozen = False
    cell.rig.until(lambda: cell.rig.state.valid)
    assert cell.rig.state.hold_reason


@pytest.mark.parametrize(
    ("tantrum", "message"),
    [
        ({"greeting": 1}, "protocol 1, this gateway 3: load controller/forcemesh.as"),
        ({"greeting": 3002}, "arm 2, the cell file's gateway.arm is 1"),
        ({"scales": (60, 500, 250, 100, 1000, 10)}, "position_per_mm asked 50, has 60"),
    ],
)
def test_a_controller_that_does_not_agree_is_reported(
    tantrum: dict[str, object], message: str
) -> None:
    """robot/state has the version, arm or scale, and nothing is commanded."""
    with a_cell_on_sockets() as cell:
        for name, value in tantrum.items():
            setattr(cell.controller.tantrums, name, value)
        cell.rig.until(lambda: message in cell.rig.state.reason)
        assert set(cell.coms()) == {Com.HELLO}


def test_a_slow_controller_is_valid() -> None:
    """At 15 Hz the state is valid and a stream is followed, one set point at a time."""
    with a_cell_on_sockets(rate_hz=15.0, **{"rates.robot_hz": 15}) as cell:
        rig = cell.rig
        rig.connect()
        rig.arm()
        start = rig.T
        for step in range(1, 101):
            rig.send("setpoint", pose=record_of(shifted(start, z_m=1e-4 * step)))
            rig.advance(0.008)
        rig.until(lambda: abs(rig.T.translation[2] - start.translation[2] - 0.01) < 2e-4)
        assert len(cell.controller.of(Com.SET_POINT)) < 25
        assert rig.state.hold_reason == ""


def test_set_points_that_are_too_fast_are_refused(cell: GatewayCell) -> None:
    """Each step is small; together they are faster than the cell's speed limit."""
    cell.rig.arm()
    start = cell.rig.T
    for step in range(1, 50):
        cell.rig.send("setpoint", pose=record_of(shifted(start, z_m=0.002 * step)))
        cell.rig.advance(0.004)
        if cell.rig.state.hold_reason:
            break
    assert cell.rig.state.hold_code in ("acceleration", "rate", "tracking")


def test_a_value_that_does_not_fit_holds_with_the_reason() -> None:
    """Nothing is clipped: 99 units per millimetre reach no further than -1010 mm."""
    wide: dict[str, Any] = {"limits.workspace_min_m": [-2.0, -2.0, -2.0], "limits.tether_m": 5.0}
    wide["gateway.position_per_mm"] = 99
    with a_cell_on_sockets(**wide) as cell:
        cell.rig.connect()
        cell.rig.arm()
        cell.rig.send("goal", goal=pose_goal(1, shifted(cell.rig.T, x_m=-1.5)))
        cell.rig.until(lambda: "the packet holds -1010.09" in cell.rig.state.hold_reason)
        assert cell.controller.of(*MOTION) == []
