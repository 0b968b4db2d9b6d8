"""The gateway's socket, on real sockets: it reconnects, it watches, and it never raises."""

import errno
import os
import socket
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from common.clock import NS_PER_S
from common.errors import RemoteProtocolError
from common.packet import PACKET_CHARS, Packet, encode
from common.packet_table import Com, Status
from services.gateway.dialogue import Dialogue
from services.gateway.link import Link, LinkSettings
from services.gateway.reports import Event, HealthReport, HelloReceived, JointReport, PoseReport
from services.gateway.scales import Scales
from tests.fakes.controller import FakeController

PATIENCE_S = 5.0


class Peer:
    """A listening socket that does nothing by itself."""

    def __init__(self) -> None:
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.listener.settimeout(PATIENCE_S)
        self.port: int = self.listener.getsockname()[1]

    def accept(self) -> socket.socket:
        """Take the connection that waits."""
        client, _ = self.listener.accept()
        client.settimeout(PATIENCE_S)
        return client


@pytest.fixture
def peer() -> Iterator[Peer]:
    """A listening socket."""
    peer = Peer()
    yield peer
    peer.listener.close()


@pytest.fixture
def deaf() -> Iterator[socket.socket]:
    """A port that is taken and does not listen."""
    with socket.socket() as reserved:
        reserved.bind(("127.0.0.1", 0))
        yield reserved


class Driver:
    """Polls a link until something is seen, as the service's loop does."""

    def __init__(self, port: int, **settings: float) -> None:
        defaults = {"pause_first_s": 0.01, "pause_longest_s": 0.05}
        self.link = Link(LinkSettings("127.0.0.1", port, **(defaults | settings)))
        self.data = b""
        self.opened = 0
        self.lost: list[str] = []

    def poll(self) -> None:
        """Poll once and keep what came."""
        news = self.link.poll(time.monotonic_ns())
        self.opened += news.opened
        self.data += news.data
        if news.lost:
            self.lost.append(news.lost)

    def until(self, seen: Callable[[], object]) -> None:
        """Poll until a condition holds."""
        give_up = time.monotonic() + PATIENCE_S
        while not seen():
            assert time.monotonic() < give_up, (self.opened, self.lost, self.link.last_fault)
            self.poll()
            time.sleep(0.0005)

    def send(self, data: bytes) -> bool:
        """Send now."""
        return self.link.send(data, time.monotonic_ns())

    def close(self) -> None:
        """End."""
        self.link.close("test over", time.monotonic_ns())


def connected(peer: Peer, **settings: float) -> tuple[Driver, socket.socket]:
    """A link that is open, and its other end."""
    driver = Driver(peer.port, **settings)
    driver.until(lambda: driver.opened)
    return driver, peer.accept()


def test_bytes_go_both_ways(peer: Peer) -> None:
    """What is sent arrives, what arrives is told once."""
    driver, client = connected(peer)
    assert driver.send(b"abc")
    assert client.recv(10) == b"abc"
    client.sendall(b"xyz")
    driver.until(lambda: driver.data == b"xyz")
    assert (driver.opened, driver.lost) == (1, [])
    driver.close()
    client.close()


def test_nagle_is_off(peer: Peer) -> None:
    """A set point must not wait for the acknowledgement of the one before."""
    driver, client = connected(peer)
    assert driver.link._socket is not None
    assert driver.link._socket.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
    driver.close()
    client.close()


def test_a_controller_that_is_not_there_yet_is_waited_for(deaf: socket.socket) -> None:
    """Refused connections are tried again, and nothing is raised or reported as lost."""
    driver = Driver(deaf.getsockname()[1])
    driver.until(lambda: os.strerror(errno.ECONNREFUSED) in driver.link.last_fault)
    assert not driver.send(b"x")
    deaf.listen()
    driver.until(lambda: driver.opened)
    assert driver.lost == []
    driver.close()


def test_the_pause_between_attempts_doubles_until_the_controller_greets(
    deaf: socket.socket,
) -> None:
    """0.1, 0.2, 0.4 ... up to the longest; short again after a good hello. On a virtual clock."""
    link = Link(
        LinkSettings("127.0.0.1", deaf.getsockname()[1], pause_first_s=0.1, pause_longest_s=0.4)
    )
    pauses_s: list[float] = []
    for now_ns in range(0, 2_000_000_000, 10_000_000):
        until_ns = link._next_attempt_ns
        link.poll(now_ns)
        if link._next_attempt_ns != until_ns:
            pauses_s.append((link._next_attempt_ns - now_ns) / NS_PER_S)
        if len(pauses_s) == 4:
            link.greeted()
    assert pauses_s[:6] == pytest.approx([0.1, 0.2, 0.4, 0.4, 0.1, 0.2])


@pytest.mark.parametrize("reset", [False, True])
def test_a_lost_connection_is_told_once_and_made_again(reset: bool) -> None:
    """Closed or reset by the controller: a reason, then a new connection."""
    with FakeController() as controller:
        driver = Driver(controller.port)
        driver.until(lambda: driver.opened)
        assert controller.wait_for(lambda: controller.connections == 1)
        controller.drop(reset=reset)
        driver.until(lambda: driver.opened == 2)
        assert len(driver.lost) == 1
        assert str(controller.port) in driver.lost[0]
        driver.close()


def test_half_closed_is_closed(peer: Peer) -> None:
    """A controller that says no more is gone, even if it still listened."""
    driver, client = connected(peer)
    client.shutdown(socket.SHUT_WR)
    driver.until(lambda: driver.lost)
    assert "closed by the controller" in driver.lost[0]
    assert not driver.send(b"x")
    client.close()


def test_what_came_before_the_end_is_still_told(peer: Peer) -> None:
    """The last report before the connection ended is not lost."""
    driver, client = connected(peer)
    client.sendall(b"last words")
    client.close()
    driver.until(lambda: driver.lost)
    assert driver.data == b"last words"


def test_silence_ends_the_connection(peer: Peer) -> None:
    """A controller that streams endlessly and stops is frozen: connect again, and hold."""
    driver, client = connected(peer, silent_after_s=0.05)
    driver.until(lambda: driver.lost)
    assert "silent for 0.05 s" in driver.lost[0]
    client.close()


def test_packets_that_nobody_takes_end_the_connection(peer: Peer) -> None:
    """When the peer's window is shut, set points must not pile up in our kernel."""
    peer.listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)
    driver, client = connected(peer, stalled_after_s=0.05, silent_after_s=60.0)
    packet = encode(Packet(1, 12, 0))

    def send_and_look() -> bool:
        driver.send(packet)
        return bool(driver.lost)

    driver.until(send_and_look)
    assert "not taken for" in driver.lost[0]
    client.close()


def test_a_peer_that_reads_is_never_called_stalled(peer: Peer) -> None:
    """A steady stream that is read goes on for many times the stall limit."""
    driver, client = connected(peer, stalled_after_s=0.1, silent_after_s=60.0)
    packet = encode(Packet(1, 12, 0))
    started, read = time.monotonic(), 0
    while time.monotonic() - started < 0.5:
        driver.send(packet)
        read += len(client.recv(4096))
        driver.poll()
        time.sleep(0.002)
    assert driver.lost == []
    assert read >= PACKET_CHARS
    driver.close()
    client.close()


def test_a_name_that_does_not_resolve_is_a_fault_and_not_an_exception() -> None:
    """The loop goes on; the fault says which name."""
    link = Link(LinkSettings("no such host", 1))
    link.poll(0)
    assert "no such host" in link.last_fault
    assert not link.is_open


# --- dialogue over the link, with the fake controller ---------------------------------------------


class Talk:
    """Link and dialogue together, as the service joins them."""

    def __init__(self, controller: FakeController) -> None:
        self.controller = controller
        self.link = Link(LinkSettings("127.0.0.1", controller.port, pause_first_s=0.01))
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
            self.events += self.dialogue.feed(news.data, now_ns) if news.data else []
        except RemoteProtocolError as error:
            self.link.close(str(error), now_ns)
            return
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
    """Command 1 in millimetres and O, A, T: 10 mm along y, and nothing else."""
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
    talk.until(lambda: talk.controller.of(Com.MOVE_POSE))
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
    assert len(talk.controller.of(Com.MOVE_POSE)) == 1
    talk.controller.tantrums.stalled = False
    talk.until(lambda: beats() and len(talk.controller.of(Com.MOVE_POSE)) >= 3)


def test_a_second_gateway_gets_no_answer(talk: Talk) -> None:
    """The controller serves one connection; the second one waits in vain and holds."""
    second = Driver(talk.controller.port, silent_after_s=0.1)
    second.until(lambda: second.opened)
    second.send(Dialogue(Scales()).connected(0))
    second.until(lambda: second.lost)
    assert second.data == b""
    assert talk.faults == []
    second.close()
