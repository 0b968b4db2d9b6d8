"""Dialogue and link together, with the fake controller on a real socket."""

import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from controller.packet_table import Com, Scales, Status
from forcemesh.errors import RemoteProtocolError
from services.gateway.dialogue import Dialogue
from services.gateway.link import Link, LinkSettings
from services.gateway.packets import Event, HealthReport, HelloReceived, JointReport, PoseReport
from tests.fakes.controller import FakeController
from tests.fakes.dialogues import KEPT

pytestmark = pytest.mark.realtime

PATIENCE_S = 5.0


class LinkedDialogue:
    """Link and dialogue together, as the service joins them."""

    def __init__(self, controller: FakeController, silent_after_s: float = 1.5) -> None:
        self.controller = controller
        settings = LinkSettings(
            "127.0.0.1", controller.port, pause_first_s=0.01, silent_after_s=silent_after_s
        )
        self.link = Link(settings)
        self.dialogue = Dialogue(Scales())
        self.events: list[Event] = []
        self.faults: list[str] = []

    def step(self, *, permitted: bool = True) -> None:
        """Poll, process the reports, and send the due packets."""
        now_ns = time.monotonic_ns()
        received = self.link.poll(now_ns)
        if received.opened:
            self.link.send(self.dialogue.connected(now_ns), now_ns)
        if received.lost:
            self.faults.append(received.lost)
        try:
            events = self.dialogue.feed(received.data, now_ns) if received.data else []
        except RemoteProtocolError as error:
            self.link.close(str(error), now_ns)
            return
        self.events += events
        if any(isinstance(event, HelloReceived) for event in events):
            self.send(self.dialogue.set_up(KEPT, now_ns))
        self.send(self.dialogue.tick(now_ns, permitted=permitted))

    def send(self, data: bytes) -> None:
        """Send bytes of the dialogue."""
        if data:
            self.link.send(data, time.monotonic_ns())

    def until(self, condition: Callable[[], object], *, permitted: bool = True) -> None:
        """Step until a condition holds."""
        deadline_s = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < deadline_s, (self.faults, self.controller.errors)
            self.step(permitted=permitted)
            time.sleep(0.001)

    def last(self, kind: type[Event]) -> Event:
        """Return the newest event of a kind."""
        return next(event for event in reversed(self.events) if isinstance(event, kind))


@pytest.fixture
def linked() -> Iterator[LinkedDialogue]:
    """Yield a connection to a fake controller after the hellos."""
    with FakeController() as controller:
        linked = LinkedDialogue(controller)
        linked.until(lambda: any(isinstance(event, JointReport) for event in linked.events))
        yield linked
        linked.link.close("test over", 0)


def test_pose_joints_and_health_come_in(linked: LinkedDialogue) -> None:
    """The three endless reports arrive, and their pose is that of the arm."""
    linked.until(lambda: any(isinstance(event, HealthReport) for event in linked.events))
    assert isinstance(linked.events[0], HelloReceived)
    report = linked.last(PoseReport)
    assert isinstance(report, PoseReport)
    p_true = linked.controller.T_base_flange.translation
    assert abs(report.T_base_flange.translation - p_true).max() < 2e-5


@pytest.mark.parametrize("tantrum", [{"chop": True}, {"merge": 7}, {"chop": True, "merge": 5}])
def test_reports_survive_any_segmentation(linked: LinkedDialogue, tantrum: dict[str, int]) -> None:
    """Pieces of 1 to 60 bytes and bursts of many packets make no difference."""
    for name, value in tantrum.items():
        setattr(linked.controller.tantrums, name, value)
    before = len(linked.events)
    linked.until(lambda: len(linked.events) > before + 50)
    assert linked.faults == []


def test_garbage_closes_the_link_and_the_next_connection_is_clean(linked: LinkedDialogue) -> None:
    """After one bad packet is_at_target is a new hello, and no search for the next packet."""
    linked.controller.write(b"xyz")
    linked.until(lambda: linked.faults)
    assert "xyz" in linked.faults[0]
    greetings = sum(isinstance(event, HelloReceived) for event in linked.events)
    linked.until(
        lambda: sum(isinstance(event, HelloReceived) for event in linked.events) > greetings
    )  # fmt: skip
    assert len(linked.faults) == 1


def test_a_setpoint_moves_the_arm_to_its_pose(linked: LinkedDialogue) -> None:
    """Command 13 in millimetres and O, A, T: the arm moves 10 mm along y."""
    target = linked.controller.T_base_flange
    target.translation = target.translation + np.array([0.0, 0.010, 0.0])

    def is_at_target() -> bool:
        linked.dialogue.offer_setpoint(target)
        error = linked.controller.T_base_flange.actInv(target)
        return bool(abs(error.homogeneous - np.eye(4)).max() < 1e-4)

    linked.until(is_at_target)
    assert linked.controller.errors == []


def test_the_watchdog_of_the_controller_detects_missing_permission(linked: LinkedDialogue) -> None:
    """Without permission no heartbeat is sent, so the controller stops by itself and latches."""
    target = linked.controller.T_base_flange
    linked.dialogue.offer_setpoint(target)
    linked.until(lambda: linked.controller.of(Com.SET_POINT))
    linked.until(lambda: linked.controller.errors, permitted=False)
    assert linked.controller.errors == ["watchdog"]
    assert linked.controller.robot.status & Status.WATCHDOG_LATCHED
    linked.until(lambda: len(linked.faults) == 1, permitted=False)


def test_heartbeats_satisfy_the_watchdog_of_the_controller(linked: LinkedDialogue) -> None:
    """With permission and no other packet, command 12 is sent every 40 ms."""
    linked.until(lambda: len(linked.controller.of(Com.HEARTBEAT)) >= 12)
    assert linked.controller.errors == []


def test_no_more_than_one_setpoint_waits_in_the_controller(linked: LinkedDialogue) -> None:
    """A robot program that takes no packet gets no further ones."""
    linked.controller.tantrums.stalled = True
    target = linked.controller.T_base_flange

    def beats() -> int:
        linked.dialogue.offer_setpoint(target)
        return len(linked.controller.of(Com.HEARTBEAT))

    linked.until(lambda: beats() >= 5)
    assert len(linked.controller.of(Com.SET_POINT)) == 1
    linked.controller.tantrums.stalled = False
    linked.until(lambda: beats() and len(linked.controller.of(Com.SET_POINT)) >= 3)


def test_a_second_gateway_gets_no_answer(linked: LinkedDialogue) -> None:
    """The controller serves one connection; the second one times out and holds."""
    second = LinkedDialogue(linked.controller, silent_after_s=0.1)
    second.until(lambda: second.faults)
    assert second.events == []
    assert "silent" in second.faults[0]
    assert linked.faults == []
    second.link.close("test over", 0)
