"""Force feedback in the controller as the gateway runs it, on the virtual clock.

Each packet is judged: see tests/fakes/gateway_world.py.
"""

from typing import Any

import pytest

from controller.packet import Packet
from controller.packet_table import FEEDBACK_BITS, Com, FeedbackSwitch
from forcemesh.messages import Feedback, Gains, Vec3
from services.gateway.driver import CENTRE_STEP_M
from tests.fakes.gateway_world import GatewayWorld, MoodyController

GAINS = Gains(force_p_m_per_N=(1e-5, 1e-5, 1e-5))
MORE = Gains(force_p_m_per_N=(2e-5, 2e-5, 2e-5))


class Notes(MoodyController):
    """Notes every command in its order."""

    def __init__(self) -> None:
        """Nothing noted yet."""
        super().__init__()
        self.notes: list[tuple[Com, int]] = []

    def _take(self, packet: Packet) -> None:
        if packet.com not in {Com.HEARTBEAT, Com.WRENCH}:
            self.notes.append((Com(packet.com), packet.param))
        super()._take(packet)

    def end_feedback(self) -> None:
        """Let force feedback end without being asked."""
        self._status &= ~FEEDBACK_BITS


class Cell:
    """A gateway that runs force feedback."""

    def __init__(self) -> None:
        """Arm, and run it in mode position."""
        self.controller = Notes()
        self.world = GatewayWorld(self.controller)
        self.world.lease += 1
        self.run()
        assert (Com.FEEDBACK, int(FeedbackSwitch.POSITION)) in self.controller.notes
        assert self.world.gateway.verdict.command is not None

    def run(self, mode: Any = "position", lever_m: Vec3 = (0.0, 0.0, 0.0), **more: Any) -> None:
        """Command it for a tenth of a second, under the permission of a host."""
        feedback = Feedback(mode=mode, lever_m=lever_m, gains=more.pop("gains", GAINS))
        for _ in range(10):
            command = self.world.permitted("feedback", feedback=feedback)
            assert command.permission is not None
            permission = command.permission.model_copy(update=more)
            self.world.say(command.model_copy(update={"permission": permission}))
            self.world.live(5)

    def noted(self, mode: Any = "position", **changes: Any) -> list[tuple[Com, int]]:
        """Go on with something changed; return the commands that came of it."""
        self.controller.notes.clear()
        self.run(mode, **changes)
        return self.controller.notes


@pytest.fixture
def cell() -> Cell:
    """A gateway that runs force feedback in mode position."""
    return Cell()


def test_feedback_that_goes_on_says_nothing_anew(cell: Cell) -> None:
    """Only wrenches."""
    assert cell.noted() == []


def test_other_gains_are_sent_and_it_goes_on(cell: Cell) -> None:
    """The set that is another; force feedback does not stop for it."""
    assert cell.noted(gains=MORE) == [(Com.GAINS, 0)]


def test_the_point_to_turn_about_is_followed_in_steps(cell: Cell) -> None:
    """A way that matters is one command; a smaller one is none."""
    assert cell.noted(lever_m=(0.5 * CENTRE_STEP_M, 0.0, 0.0)) == []
    assert cell.noted(lever_m=(2.0 * CENTRE_STEP_M, 0.0, 0.0)) == [(Com.TCP, 1)]
    assert cell.noted(lever_m=(2.4 * CENTRE_STEP_M, 0.0, 0.0)) == []


def test_another_mode_stops_first_and_starts_anew(cell: Cell) -> None:
    """Centre, limits and gains go before the start again."""
    stop = (Com.FEEDBACK, int(FeedbackSwitch.STOP))
    start = (Com.FEEDBACK, int(FeedbackSwitch.ORIENTATION))
    gains = [(Com.GAINS, 0), (Com.GAINS, 1)]
    assert cell.noted("orientation") == [stop, (Com.TCP, 1), *gains, start]


def test_a_permission_for_the_pc_is_none_for_the_controller(cell: Cell) -> None:
    """The lease ends, under the code of the host; the controller holds."""
    assert cell.noted(host="pc") == [(Com.HOLD, 0)]
    assert cell.world.gateway.verdict.hold_code == "host"


def test_force_feedback_without_a_wrench_is_none(cell: Cell) -> None:
    """A wrench that falls silent ends the lease: the controller would press by an old one."""
    cell.world.wrench = None
    said = [one for _ in range(4) for one in cell.noted()]  # longer than a wrench is believed
    assert said == [(Com.HOLD, 0)]
    assert "stale" in cell.world.codes


def test_feedback_that_the_controller_ended_by_itself_ends_the_lease(cell: Cell) -> None:
    """Nobody starts it again but a person."""
    cell.controller.end_feedback()
    assert cell.noted() == [(Com.HOLD, 0)]
    assert cell.world.codes >= {"feedback"}
