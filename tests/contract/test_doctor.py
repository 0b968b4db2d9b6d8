"""Visit of `forcemesh doctor` to a controller, on real sockets: results and side effects."""

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from itertools import pairwise

import numpy as np
import pytest

from cli.doctor.link import Visit, VisitTimeouts, visit_controller
from controller.packet import PACKET_CHARS, Packet, PacketReader, encode
from controller.packet_table import ID_FIRST, Com, Scales, greeting
from sim.controller.behaviour import Behaviour
from sim.controller.network import SocketNetwork, SocketStream
from tests.chaos.common_net import free_port
from tests.fakes.controller import RunningController
from tests.fakes.controller_talk import TEXT

pytestmark = pytest.mark.realtime

SHORT = VisitTimeouts(connect_s=0.5, hello_s=0.5, reports_s=0.5, watch_s=1.2, confirm_s=0.5)
SCALES = Scales()


def served(text: str = TEXT) -> RunningController:
    """Return a controller with a program, on a socket."""
    return RunningController(text, behaviour=Behaviour(), network=SocketNetwork(port=0))


def visit(port: int, patience: VisitTimeouts = SHORT) -> Visit:
    """Visit a port of this machine."""
    return visit_controller("127.0.0.1", port, SCALES, patience)


def test_a_visit_reads_all_reports_and_leaves_the_controller_unchanged() -> None:
    """Pose, joints, health, rates, round trip; held, not latched, nothing armed, nothing moved."""
    with served() as controller:
        before = controller.machine.robot.q
        found = visit(controller.port)
        assert (found.opened, found.hello_outcome) == ("open", "answered")
        found_reports = found.reports
        assert found_reports is not None
        assert found_reports.held
        assert found_reports.broken == ""
        assert found_reports.pose is not None
        assert found_reports.health is not None
        assert found_reports.sender_hz is not None
        assert 5.0 < found_reports.sender_hz <= 125.0
        assert found_reports.loop_hz is not None
        assert found_reports.round_trip is not None
        assert found_reports.longest_gap_s is not None
        assert found_reports.longest_gap_s >= 1.0 / found_reports.sender_hz
        assert controller.wait_for(lambda: controller.value("fm.link") == 0)
        assert (controller.value("fm.lat"), controller.value("fm.arm")) == (
            controller.value("fm.lack"), 0,
        )  # fmt: skip
        assert np.allclose(controller.machine.robot.q, before, atol=1e-5)


@pytest.fixture
def received(monkeypatch: pytest.MonkeyPatch) -> list[bytes]:
    """The bytes that controllers receive from now on."""
    data: list[bytes] = []
    receive = SocketStream.receive

    def recorded(stream: SocketStream, most: int) -> bytes | None:
        came = receive(stream, most)
        data.extend([came] if came else [])
        return came

    monkeypatch.setattr(SocketStream, "receive", recorded)
    return data


def test_a_visit_sends_nothing_but_hello_heartbeat_and_hold(received: list[bytes]) -> None:
    """Behind each heartbeat, which arms the watchdog, a hold follows in the same write."""
    with served() as controller:
        visit(controller.port)
        assert controller.wait_for(lambda: controller.value("fm.link") == 0)
    coms = [packet.com for packet in PacketReader().feed(b"".join(received))]
    assert coms[0] == Com.HELLO
    assert set(coms[1:]) == {Com.HEARTBEAT, Com.HOLD}
    assert {after for com, after in pairwise(coms) if com == Com.HEARTBEAT} == {Com.HOLD}
    assert coms[-1] == Com.HOLD


@contextmanager
def closed_port() -> Iterator[int]:
    """Yield a closed port."""
    yield free_port()


@contextmanager
def full_port() -> Iterator[int]:
    """Yield a port whose backlog is full: it does not answer, like a machine that is off."""
    with ExitStack() as stack:
        listener = stack.enter_context(socket.socket())
        listener.bind(("127.0.0.1", 0))
        listener.listen(0)
        for _ in range(3):
            filler = stack.enter_context(socket.socket())
            filler.setblocking(False)
            filler.connect_ex(listener.getsockname())
        yield listener.getsockname()[1]


@pytest.mark.parametrize(("place", "opened"), [(closed_port, "refused"), (full_port, "silent")])
def test_a_closed_port_and_no_answer_are_distinguished(
    place: Callable[[], AbstractContextManager[int]], opened: str
) -> None:
    """Refused at once, or silence until the time-out."""
    with place() as port:
        found = visit(port)
    assert found.opened == opened
    assert found.reports is None
    assert (found.opened_s >= SHORT.connect_s) == (opened == "silent")


def test_an_unresolved_name_and_an_unreachable_host_are_distinguished() -> None:
    """The text of the operating system is kept."""
    unresolved = visit_controller("no such host", 49152, SCALES, SHORT)
    assert unresolved.opened == "unresolved"
    assert unresolved.opened_detail
    unreachable = visit_controller("255.255.255.255", 49152, SCALES, SHORT)
    assert unreachable.opened == "unreachable"
    assert unreachable.opened_detail


def test_a_second_client_gets_no_answer() -> None:
    """The controller serves one client: the second one waits in the backlog of the port."""
    with served() as controller, socket.create_connection(("127.0.0.1", controller.port)):
        assert controller.wait_for(lambda: controller.machine.tcp.sockets)
        found = visit(controller.port)
        assert (found.opened, found.hello_outcome, found.hello) == ("open", "silent", None)
        assert found.hello_s >= SHORT.hello_s


@pytest.mark.parametrize(
    ("answer", "greeted"), [(b"", "closed"), (b"HTTP/1.1 400 " * 10, "garbled")]
)
def test_another_program_on_the_port_is_no_controller(answer: bytes, greeted: str) -> None:
    """A program that closes, and a program with another protocol."""

    def serve() -> None:
        client, _ = listener.accept()
        with client:
            client.recv(63)
            client.sendall(answer)

    with socket.create_server(("127.0.0.1", 0)) as listener:
        thread = threading.Thread(target=serve)
        thread.start()
        found = visit(listener.getsockname()[1])
        thread.join()
    assert (found.opened, found.hello_outcome, found.reports) == ("open", greeted, None)
    assert found.hello_detail


@pytest.mark.parametrize(
    ("now", "then", "param", "first_scale"),
    [("1003000+fm.num", "1002000+fm.num", 2001, 50), ("fm.sp=.v[3]", "fm.sp=60", 3001, 60)],
)
def test_version_and_scales_are_reported_although_they_end_the_visit(
    now: str, then: str, param: int, first_scale: int, received: list[bytes]
) -> None:
    """The hello is kept for the report; nothing more is sent."""
    assert TEXT.count(now) == 1
    with served(TEXT.replace(now, then)) as controller:
        found = visit(controller.port)
        assert (found.hello_outcome, found.reports) == ("answered", None)
        assert found.hello is not None
        assert (found.hello.param, found.hello.vec[0]) == (param, first_scale)
    assert [packet.com for packet in PacketReader().feed(b"".join(received))] == [Com.HELLO]


def test_a_controller_that_greets_and_reports_nothing_has_no_rate() -> None:
    """No sample, no pose, no round trip: unknown, not zero."""

    def greet() -> None:
        client, _ = listener.accept()
        with client:
            client.sendall(encode(Packet(ID_FIRST, Com.HELLO, greeting(1), SCALES.vec)))
            while client.recv(1000):
                pass

    with socket.create_server(("127.0.0.1", 0)) as listener:
        thread = threading.Thread(target=greet)
        thread.start()
        found_reports = visit(listener.getsockname()[1]).reports
        thread.join()
    assert found_reports is not None
    assert (
        found_reports.pose,
        found_reports.sender_hz,
        found_reports.round_trip,
        found_reports.held,
    ) == (None, None, None, False)


@pytest.mark.parametrize("how", ["drop", "garbage", "frozen"])
def test_a_controller_that_breaks_off_is_reported(how: str, received: list[bytes]) -> None:
    """Closed, no packet, or silent in the middle: the earlier results are kept."""
    with served() as controller:

        def spoil() -> None:
            controller.wait_for(lambda: len(b"".join(received)) > 8 * PACKET_CHARS)
            controller.is_frozen = True
            (stream,) = controller.machine.tcp._streams.values()
            if how == "drop":
                stream.close()
            elif how == "garbage":
                stream.send(b"x" * 63)

        thread = threading.Thread(target=spoil)
        thread.start()
        found_reports = visit(controller.port).reports
        thread.join()
    assert found_reports is not None
    assert found_reports.pose is not None
    assert not found_reports.held
    assert bool(found_reports.broken) == (how != "frozen")
