"""Force feedback in the controller as the gateway runs it, on the virtual clock.

tests/fakes/gateway_world.py checks each packet.
"""

from typing import Any

import pytest

from common.motion.limits import LEVER_M
from controller.packet import PACKET_CHARS, Packet
from controller.packet_table import FEEDBACK_BITS, Com, FeedbackSwitch
from forcemesh.messages import Feedback, Gains, Vec3, WrenchAtTcp
from services.gateway.driver import CENTRE_STEP_M, slow_setpoint
from tests.fakes.gateway_world import FaultyController, GatewayWorld

GAINS = Gains(force_p_m_per_N=(1e-5, 1e-5, 1e-5))
MORE = Gains(force_p_m_per_N=(2e-5, 2e-5, 2e-5))
STOP = (Com.FEEDBACK, int(FeedbackSwitch.STOP))


class FeedbackCell:
    """A gateway that runs force feedback."""

    def __init__(self) -> None:
        """Arm, and run feedback in mode position."""
        self.world = GatewayWorld()
        self.controller = self.world.controller
        self.world.lease += 1
        self.run()
        assert (Com.FEEDBACK, int(FeedbackSwitch.POSITION)) in self.controller.notes
        assert self.world.gateway.verdict.command is not None

    def run(self, mode: Any = "position", lever_m: Vec3 = (0.0, 0.0, 0.0), **more: Any) -> None:
        """Command feedback for a tenth of a second, under the permission of a loop host."""
        feedback = Feedback(mode=mode, lever_m=lever_m, gains=more.pop("gains", GAINS))
        for _ in range(10):
            command = self.world.permitted("feedback", feedback=feedback)
            assert command.permission is not None
            permission = command.permission.replaced(**more)
            self.world.send(command.replaced(permission=permission))
            self.world.live(5)

    def commands_after(self, mode: Any = "position", **changes: Any) -> list[tuple[Com, int]]:
        """Continue with changed content; return the resulting commands."""
        self.controller.notes.clear()
        self.run(mode, **changes)
        return self.controller.notes


@pytest.fixture
def cell() -> FeedbackCell:
    """Return a gateway that runs force feedback in mode position."""
    return FeedbackCell()


def test_unchanged_feedback_sends_each_wrench_once_and_nothing_else(cell: FeedbackCell) -> None:
    """The controller integrates the samples: the same sample again would count twice."""
    before = len(cell.controller.wrenches)
    assert cell.commands_after() == []
    assert 5 <= len(cell.controller.wrenches) - before <= 50
    world = cell.world
    world.wrench = None
    world.live(10)
    before = len(cell.controller.wrenches)
    feedback = Feedback(mode="position", gains=GAINS)
    for _ in range(3):
        world.send(world.permitted("feedback", feedback=feedback))
        world.live(2)
    assert len(cell.controller.wrenches) == before
    assert world.gateway.verdict.hold_code == ""


def test_changed_gains_are_sent_while_feedback_runs(cell: FeedbackCell) -> None:
    """The changed set is sent; force feedback does not stop for it."""
    assert cell.commands_after(gains=MORE) == [(Com.GAINS, 0)]


def test_the_centre_of_rotation_is_updated_in_steps(cell: FeedbackCell) -> None:
    """TCP plus lever: a significant move of the centre is one command; a smaller one is none."""
    assert cell.commands_after(lever_m=(0.5 * CENTRE_STEP_M, 0.0, 0.0)) == []
    assert cell.commands_after(lever_m=(2.0 * CENTRE_STEP_M, 0.0, 0.0)) == [(Com.TCP, 1)]
    sent = next(chars for chars in cell.controller.sent[::-1] if chars[7:13] == b"000011")
    assert len(sent) == PACKET_CHARS
    assert sent[14:41] == b"000001 000300 000000 008000"
    assert cell.commands_after(lever_m=(2.4 * CENTRE_STEP_M, 0.0, 0.0)) == []


def test_feedback_explains_motion_from_its_start_on() -> None:
    """An arm that moves without is a fault."""
    world = GatewayWorld()
    driver = world.gateway.driver
    assert not driver.explains_motion
    world.lease += 1
    world.send(world.permitted("feedback", feedback=Feedback(mode="position", gains=GAINS)))
    world.live()
    assert driver.explains_motion


def test_a_wrench_for_a_display_is_sent_at_the_rate_of_a_status() -> None:
    """While armed; every other one is left out."""
    world = GatewayWorld()
    world.gateway.driver._shows_wrench = True
    world.lease += 1
    for _ in range(200):
        world.send(world.permitted("idle"))
        world.live(5)
    assert len(world.controller.wrenches) == pytest.approx(2.0 * world.cell.rates.status_hz, abs=3)


def test_a_set_point_is_no_farther_from_the_reading_than_its_speed_allows() -> None:
    """On the line between them, as far as the integral gain moves at the speed; else unchanged."""
    gains = Gains(force_i_m_per_Ns=(0.001,) * 3, torque_i_rad_per_Nms=(0.1,) * 3)
    wrench = WrenchAtTcp(force_N=(3.0, -4.0, 0.0), torque_Nm=(0.2, 0.0, 0.0))
    feedback = Feedback(mode="position", gains=gains, setpoint_force_N=(3.0, -4.0, 8.0))
    force_N, torque_Nm = slow_setpoint(feedback.replaced(speed_m_s=0.002), wrench)
    assert force_N == pytest.approx((3.0, -4.0, 2.0))
    most_Nm = 0.002 / LEVER_M / 0.1
    assert torque_Nm == pytest.approx((0.2 - most_Nm, 0.0, 0.0))
    for fast in (feedback, feedback.replaced(speed_m_s=1.0)):
        assert slow_setpoint(fast, wrench) == (feedback.setpoint_force_N, (0.0, 0.0, 0.0))


def test_another_mode_stops_and_restarts_feedback(cell: FeedbackCell) -> None:
    """Centre, limits and gains are sent before the new start."""
    start = (Com.FEEDBACK, int(FeedbackSwitch.ORIENTATION))
    gains = [(Com.GAINS, 0), (Com.GAINS, 1)]
    assert cell.commands_after("orientation") == [STOP, (Com.TCP, 1), *gains, start]


def test_a_permission_for_the_pc_does_not_permit_the_controller(cell: FeedbackCell) -> None:
    """The lease ends with the code `host`; the controller holds."""
    assert cell.commands_after(host="pc") == [(Com.HOLD, 0)]
    assert cell.world.gateway.verdict.hold_code == "host"


def test_force_feedback_without_a_wrench_ends_the_lease(cell: FeedbackCell) -> None:
    """Without a wrench the controller would press by an old one."""
    cell.world.wrench = None
    commands = [
        one for _ in range(4) for one in cell.commands_after()
    ]  # longer than a wrench is valid
    assert commands == [(Com.HOLD, 0)]
    assert "stale" in cell.world.codes


def test_feedback_that_the_controller_ended_by_itself_needs_a_new_lease(cell: FeedbackCell) -> None:
    """Only an operator starts it again."""
    cell.controller._status &= ~FEEDBACK_BITS
    assert cell.commands_after() == [(Com.HOLD, 0)]
    assert cell.world.codes >= {"feedback"}


def test_no_set_point_is_sent_until_feedback_has_ended(cell: FeedbackCell) -> None:
    """The stop is sent first; the set point that came with it is left out."""
    world = cell.world
    cell.controller.notes.clear()
    world.send(world.permitted("setpoint", pose=world.shifted(0.0, 0.0, 0.0)))
    world.live(1)
    assert cell.controller.notes == [STOP]
    assert world.gateway.verdict.hold_code == ""
    world.send(world.permitted("setpoint"))
    world.live(2)
    assert "malformed" in world.codes  # one without a pose


class Ignoring(FaultyController):
    """Receives the start of force feedback, and continues without it."""

    def _take(self, packet: Packet) -> None:
        if packet.com == Com.FEEDBACK:
            self._id = packet.id
        else:
            super()._take(packet)


def test_a_controller_that_does_not_start_it_is_held() -> None:
    """The gateway does not wait for ever for a feedback that it has commanded."""
    world = GatewayWorld(Ignoring())
    world.lease += 1
    for _ in range(60):
        world.send(world.permitted("feedback", feedback=Feedback(mode="position", gains=GAINS)))
        world.live(10)
    assert "feedback" in world.codes
