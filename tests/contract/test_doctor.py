"""Visit of `forcemesh doctor` to a controller, on real sockets: results and side effects."""

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager

import numpy as np
import pytest

from cli.doctor.link import Visit, VisitTimeouts, visit_controller
from controller.packet_table import Com, Scales, Status
from tests.chaos.common_net import free_port
from tests.fakes.controller import FakeController

pytestmark = pytest.mark.realtime

SHORT = VisitTimeouts(connect_s=0.5, hello_s=0.5, reports_s=0.5, watch_s=1.2, confirm_s=0.5)
SCALES = Scales()


def visit(port: int, patience: VisitTimeouts = SHORT) -> Visit:
    """Visit a port of this machine."""
    return visit_controller("127.0.0.1", port, SCALES, patience)


def test_a_visit_reads_all_reports_and_leaves_the_controller_unchanged() -> None:
    """Pose, joints, health, rates, round trip; held, not latched, nothing armed, nothing moved."""
    with FakeController(rate_hz=50.0) as controller:
        before = controller.robot.joint_rad.copy()
        found = visit(controller.port)
        assert (found.opened, found.hello_outcome) == ("open", "answered")
        found_reports = found.reports
        assert found_reports is not None
        assert found_reports.held
        assert found_reports.broken == ""
        assert found_reports.pose is not None
        assert found_reports.health is not None
        assert found_reports.sender_hz is not None
        assert 5.0 < found_reports.sender_hz <= 51.0
        assert found_reports.loop_hz is not None
        assert found_reports.round_trip is not None
        assert found_reports.longest_gap_s is not None
        assert found_reports.longest_gap_s >= 1.0 / found_reports.sender_hz
        assert controller.wait_for(lambda: controller.errors == ["closed by the gateway"])
        assert not controller.robot.status & Status.WATCHDOG_LATCHED
        assert not controller._armed
        assert np.array_equal(controller.robot.joint_rad, before)


def test_a_visit_sends_nothing_but_hello_heartbeat_and_hold() -> None:
    """Behind each heartbeat, which arms the watchdog, a hold follows in the same write."""
    with FakeController() as controller:
        visit(controller.port)
        coms = [packet.com for packet in controller.of(*Com)]
    assert coms[0] == Com.HELLO
    assert coms[1::2] == [Com.HEARTBEAT] * (len(coms) // 2)
    assert coms[2::2] == [Com.HOLD] * (len(coms) // 2)
    assert len(coms) > 5


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


def test_a_second_client_gets_no_answer() -> None:
    """The controller serves one client: the second one waits in the backlog of the port."""
    with FakeController() as controller, socket.create_connection(("127.0.0.1", controller.port)):
        assert controller.wait_for(lambda: controller.connections == 1)
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


@pytest.mark.parametrize("how", ["drop", "garbage", "frozen"])
def test_a_controller_that_breaks_off_is_reported(how: str) -> None:
    """Closed, no packet, or silent in the middle: the earlier results are kept."""
    with FakeController(rate_hz=50.0) as controller:

        def spoil() -> None:
            controller.wait_for(lambda: len(controller.of(Com.HEARTBEAT)) > 3)
            if how == "drop":
                controller.drop()
            elif how == "garbage":
                controller.write(b"x" * 63)
            controller.tantrums.frozen = how == "frozen"

        thread = threading.Thread(target=spoil)
        thread.start()
        found_reports = visit(controller.port).reports
        thread.join()
    assert found_reports is not None
    assert found_reports.pose is not None
    assert not found_reports.held
    assert bool(found_reports.broken) == (how != "frozen")
