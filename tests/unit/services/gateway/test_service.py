"""The gateway as a whole: bus on one side, a controller on a real socket on the other."""

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
    """A connected cell."""
    with a_cell_on_sockets() as cell:
        cell.rig.connect()
        yield cell


def test_a_gateway_without_a_controller_says_so_at_its_rate() -> None:
    """Not valid, with the address, as often as the state would come."""
    with a_cell_on_sockets() as cell:
        cell.controller.tantrums.greet = False
        cell.rig.until(lambda: len(cell.rig.states) > 20, within_s=1.0)
        assert not cell.rig.state.valid
        assert cell.rig.state.reason == cell.rig.service.fault
        assert not cell.rig.state.link.connected


def test_after_hello_the_controller_gets_hold_and_limits(cell: GatewayCell) -> None:
    """And nothing else, for as long as there is no permission; and that does not latch it."""
    cell.rig.advance(1.2)  # longer than the watchdog
    sent = [packet.com for packet in cell.controller.of(*Com)]
    assert sent == [Com.HELLO, Com.HOLD, *[Com.LIMITS] * 4, Com.TCP]
    assert (cell.controller.connections, cell.controller.errors) == (1, [])
    assert cell.controller.robot.watchdog_s == pytest.approx(1.0)


def test_permission_is_the_heartbeat(cell: GatewayCell) -> None:
    """Under permission 12 comes; after a hold one 8, and silence."""
    cell.rig.arm()
    cell.rig.until(lambda: len(cell.controller.of(Com.HEARTBEAT)) >= 5)
    cell.rig.say_hold()
    cell.rig.until(lambda: cell.rig.state.hold_reason)
    cell.rig.advance(0.1)
    sent = len(cell.controller.received)
    cell.rig.advance(0.2)
    assert len(cell.controller.received) == sent
    assert cell.controller.received[-1].packet.com == Com.HOLD


def test_the_lights_of_the_controller_are_passed_on(cell: GatewayCell) -> None:
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
    ("bit", "on", "words"),
    [
        (Status.MOTOR_POWER, False, "motors are off"),
        (Status.PROGRAM_RUNNING, False, "program is not running"),
        (Status.ERROR, True, "reports an error"),
    ],
)
def test_a_controller_that_is_not_fit_ends_the_lease(
    cell: GatewayCell, bit: Status, on: bool, words: str
) -> None:
    """The gateway looks at the bits itself; when they are good again, the lease stays dead."""
    cell.rig.arm()
    cell.controller.robot.status ^= bit
    cell.rig.until(lambda: words in cell.rig.state.hold_reason)
    cell.controller.robot.status ^= bit
    cell.rig.advance(0.2)
    assert words in cell.rig.state.hold_reason


@pytest.mark.parametrize("how", ["close", "reset", "garbage"])
def test_a_lost_link_ends_in_hold_and_stays_there(cell: GatewayCell, how: str) -> None:
    """Reconnect, hold, wait for a new lease; what was under way does not go on."""
    rig = cell.rig
    rig.arm()
    start = rig.T
    rig.say("goal", goal=pose_goal(1, shifted(start, z_m=0.1)))
    rig.until(lambda: rig.T.translation[2] > start.translation[2] + 0.005)
    if how == "garbage":
        cell.controller.write(b"000000 garbage")
    else:
        cell.controller.drop(reset=how == "reset")
    rig.until(lambda: not rig.state.valid)
    assert (rig.state.goal.state, rig.state.link.connected) == ("refused", False)
    rig.until(lambda: rig.state.valid)
    assert rig.state.hold_reason
    assert rig.state.link.reconnects == 1
    assert rig.state.link.errors == (how == "garbage")
    assert rig.is_at_rest()
    stopped = rig.T
    assert stopped.translation[2] < start.translation[2] + 0.09
    motions = len(cell.controller.of(*MOTION))
    rig.advance(0.2)  # the old lease still commands its goal
    assert len(cell.controller.of(*MOTION)) == motions
    rig.arm()
    rig.say("goal", goal=pose_goal(2, shifted(stopped, z_m=-0.005)))
    rig.until(lambda: rig.state.goal.id == 2 and rig.state.goal.state == "done")


def test_the_first_set_point_is_the_measured_pose(cell: GatewayCell) -> None:
    """After every hold and reconnect, to the unit, whatever the stream wants."""
    rig = cell.rig
    for _ in range(2):
        rig.arm()
        assert rig.is_at_rest()
        cell.controller.received.clear()
        measured = cell.controller.robot.pose_vec()
        rig.say("setpoint", pose=record_of(shifted(rig.T, z_m=0.002)))
        rig.until(lambda: cell.controller.of(Com.SET_POINT))
        assert cell.controller.of(Com.SET_POINT)[0].vec == measured
        cell.controller.drop()
        rig.until(lambda: not rig.state.valid)
        rig.connect()


def test_a_controller_that_greets_is_not_kept_waiting(cell: GatewayCell) -> None:
    """Pauses grow over failed attempts, not over connections that worked."""
    for lost in range(1, 5):
        cell.controller.drop()
        cell.rig.until(lambda: not cell.rig.state.valid)
        started_ns = cell.rig.clock.now_ns()
        cell.rig.connect()
        assert cell.rig.state.link.reconnects == lost
        assert cell.rig.clock.now_ns() - started_ns < 600_000_000  # the fourth would be 800 ms


def test_a_new_process_does_not_go_on_with_the_ids_of_the_old_one() -> None:
    """Or it would take reports about its predecessor's commands for its own."""
    with a_cell_on_sockets() as cell, a_cell_on_sockets() as other:
        for one in (cell, other):
            one.rig.connect()
        assert cell.controller.of(Com.HELLO)[0].id != other.controller.of(Com.HELLO)[0].id


def test_a_frozen_controller_is_noticed_before_its_socket_is(cell: GatewayCell) -> None:
    """A stale pose is not passed on as a fresh one: not valid, and the lease is dead."""
    cell.rig.arm()
    cell.controller.tantrums.frozen = True
    cell.rig.until(lambda: not cell.rig.state.valid, within_s=1.0)
    assert "old" in cell.rig.state.reason
    cell.controller.tantrums.frozen = False
    cell.rig.until(lambda: cell.rig.state.valid)
    assert cell.rig.state.hold_reason


@pytest.mark.parametrize(
    ("tantrum", "words"),
    [
        ({"greeting": 1}, "protocol 1, this gateway 2: load controller/forcemesh.as"),
        ({"greeting": 2002}, "arm 2, the cell file's gateway.arm is 1"),
        ({"scales": (60, 500, 250, 100, 1000, 10)}, "position_per_mm asked 50, has 60"),
    ],
)
def test_a_controller_that_does_not_agree_is_named(tantrum: dict[str, object], words: str) -> None:
    """robot/state says which version, arm or scale, and nothing is commanded."""
    with a_cell_on_sockets() as cell:
        for name, value in tantrum.items():
            setattr(cell.controller.tantrums, name, value)
        cell.rig.until(lambda: words in cell.rig.state.reason)
        assert set(cell.coms()) == {Com.HELLO}


def test_a_slow_controller_is_not_a_dead_one() -> None:
    """15 Hz: the state is valid, a stream is followed, one set point at a time."""
    with a_cell_on_sockets(rate_hz=15.0, **{"rates.robot_hz": 15}) as cell:
        rig = cell.rig
        rig.connect()
        rig.arm()
        start = rig.T
        for step in range(1, 101):
            rig.say("setpoint", pose=record_of(shifted(start, z_m=1e-4 * step)))
            rig.advance(0.008)
        rig.until(lambda: abs(rig.T.translation[2] - start.translation[2] - 0.01) < 2e-4)
        assert len(cell.controller.of(Com.SET_POINT)) < 25
        assert rig.state.hold_reason == ""


def test_set_points_that_run_too_fast_are_refused(cell: GatewayCell) -> None:
    """Each step is small, together they are faster than the cell's speed limit."""
    cell.rig.arm()
    start = cell.rig.T
    for step in range(1, 50):
        cell.rig.say("setpoint", pose=record_of(shifted(start, z_m=0.002 * step)))
        cell.rig.advance(0.004)
        if cell.rig.state.hold_reason:
            break
    assert cell.rig.state.hold_code in ("acceleration", "rate", "tracking")


def test_a_value_that_does_not_fit_holds_with_the_reason() -> None:
    """Never clipped: 99 units per millimetre carry no further than -1010 mm."""
    wide: dict[str, Any] = {"limits.workspace_min_m": [-2.0, -2.0, -2.0], "limits.tether_m": 5.0}
    wide["gateway.position_per_mm"] = 99
    with a_cell_on_sockets(**wide) as cell:
        cell.rig.connect()
        cell.rig.arm()
        cell.rig.say("goal", goal=pose_goal(1, shifted(cell.rig.T, x_m=-1.5)))
        cell.rig.until(lambda: "the packet holds -1010.09" in cell.rig.state.hold_reason)
        assert cell.controller.of(*MOTION) == []
