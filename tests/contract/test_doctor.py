"""Visit of `forcemesh doctor` to a controller, on real sockets: results and side effects."""

import socket
import threading

import numpy as np
import pytest

from cli.doctor.link import Visit, VisitTimeouts, visit_controller
from controller.packet_table import Com, Scales, Status
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
