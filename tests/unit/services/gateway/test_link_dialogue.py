"""Dialogue and link together, with the fake controller on a real socket."""

import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from controller.packet_table import Com, Status
from forcemesh.errors import RemoteProtocolError
from services.gateway.dialogue import Dialogue
from services.gateway.link import Link, LinkSettings
from services.gateway.reports import Event, HealthReport, HelloReceived, JointReport, PoseReport
from services.gateway.scales import Scales
from tests.fakes.controller import FakeController
from tests.fakes.dialogues import KEPT

pytestmark = pytest.mark.realtime

PATIENCE_S = 5.0


class Talk:
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
        """Poll, feed, send what is due."""
        now_ns = time.monotonic_ns()
        news = self.link.poll(now_ns)
        if news.opened:
            self.link.send(self.dialogue.connected(now_ns), now_ns)
        if news.lost:
            self.faults.append(news.lost)
        try:
            events = self.dialogue.feed(news.data, now_ns) if news.data else []
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

    def until(self, seen: Callable[[], object], *, permitted: bool = True) -> None:
        """Step until a condition holds."""
        give_up = time.monotonic() + PATIENCE_S
        while not seen():
            assert time.monotonic() < give_up, (self.faults, self.controller.errors)
            self.step(permitted=permitted)
            time.sleep(0.001)

    def last(self, kind: type[Event]) -> Event:
        """The newest event of a kind."""
        return next(event for event in reversed(self.events) if isinstance(event, kind))


@pytest.fixture
def talk() -> Iterator[Talk]:
    """A greeted connection to a fake controller."""
    with FakeController() as controller:
        talk = Talk(controller)
        talk.until(lambda: any(isinstance(event, JointReport) for event in talk.events))
        yield talk
        talk.link.close("test over", 0)


def test_pose_joints_and_health_come_in(talk: Talk) -> None:
    """The three endless reports, and the pose is the one of the arm."""
    talk.until(lambda: any(isinstance(event, HealthReport) for event in talk.events))
    assert isinstance(talk.events[0], HelloReceived)
    report = talk.last(PoseReport)
    assert isinstance(report, PoseReport)
    p_true = talk.controller.T_base_flange.translation
    assert abs(report.T_base_flange.translation - p_true).max() < 2e-5


@pytest.mark.parametrize("tantrum", [{"chop": True}, {"merge": 7}, {"chop": True, "merge": 5}])
def test_reports_survive_any_cutting(talk: Talk, tantrum: dict[str, int]) -> None:
    """Pieces of 1 to 60 bytes and bursts of many packets make no difference."""
    for name, value in tantrum.items():
        setattr(talk.controller.tantrums, name, value)
    seen = len(talk.events)
    talk.until(lambda: len(talk.events) > seen + 50)
    assert talk.faults == []


def test_garbage_closes_the_link_and_the_next_connection_is_clean(talk: Talk) -> None:
    """One bad packet: no guessing of a new start, a new hello instead."""
    talk.controller.write(b"xyz")
    talk.until(lambda: talk.faults)
    assert "xyz" in talk.faults[0]
    greetings = sum(isinstance(event, HelloReceived) for event in talk.events)
    talk.until(
        lambda: sum(isinstance(event, HelloReceived) for event in talk.events) > greetings
    )  # fmt: skip
    assert len(talk.faults) == 1


def test_a_setpoint_moves_the_arm_to_where_it_says(talk: Talk) -> None:
    """Command 13 in millimetres and O, A, T: 10 mm along y, and nothing else."""
    target = talk.controller.T_base_flange
    target.translation = target.translation + np.array([0.0, 0.010, 0.0])

    def there() -> bool:
        talk.dialogue.offer_setpoint(target)
        error = talk.controller.T_base_flange.actInv(target)
        return bool(abs(error.homogeneous - np.eye(4)).max() < 1e-4)

    talk.until(there)
    assert talk.controller.errors == []


def test_the_watchdog_of_the_controller_sees_missing_permission(talk: Talk) -> None:
    """Without permission no heartbeat goes out, so the controller stops by itself and latches."""
    target = talk.controller.T_base_flange
    talk.dialogue.offer_setpoint(target)
    talk.until(lambda: talk.controller.of(Com.SET_POINT))
    talk.until(lambda: talk.controller.errors, permitted=False)
    assert talk.controller.errors == ["watchdog"]
    assert talk.controller.robot.status & Status.WATCHDOG_LATCHED
    talk.until(lambda: len(talk.faults) == 1, permitted=False)


def test_heartbeats_keep_the_controller_alive(talk: Talk) -> None:
    """With permission and nothing to say, command 12 comes every 40 ms."""
    talk.until(lambda: len(talk.controller.of(Com.HEARTBEAT)) >= 12)
    assert talk.controller.errors == []


def test_no_more_than_one_setpoint_waits_in_the_controller(talk: Talk) -> None:
    """A robot program that takes nothing gets nothing more."""
    talk.controller.tantrums.stalled = True
    target = talk.controller.T_base_flange

    def beats() -> int:
        talk.dialogue.offer_setpoint(target)
        return len(talk.controller.of(Com.HEARTBEAT))

    talk.until(lambda: beats() >= 5)
    assert len(talk.controller.of(Com.SET_POINT)) == 1
    talk.controller.tantrums.stalled = False
    talk.until(lambda: beats() and len(talk.controller.of(Com.SET_POINT)) >= 3)


def test_a_second_gateway_gets_no_answer(talk: Talk) -> None:
    """The controller serves one connection; the second one waits in vain and holds."""
    second = Talk(talk.controller, silent_after_s=0.1)
    second.until(lambda: second.faults)
    assert second.events == []
    assert "silent" in second.faults[0]
    assert talk.faults == []
    second.link.close("test over", 0)
