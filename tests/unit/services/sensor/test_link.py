"""Connections to a sensor on real sockets: its stream over UDP, its page over HTTP."""

import socket
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread

import pytest

from forcemesh.clock import NS_PER_S
from services.sensor.link import (
    FETCH_AGAIN_S,
    REOPEN_AFTER,
    REPEAT_REQUEST_S,
    PageFetch,
    ReceivedDatagrams,
    UdpLink,
)
from services.sensor.netft_page import PATH
from services.sensor.rdt import RdtCommand, request
from tests.unit.services.sensor.test_netft_page import PAGE

pytestmark = pytest.mark.realtime

PATIENCE_S = 20.0
START = request(RdtCommand.START)
ASK_NS = round(REPEAT_REQUEST_S * NS_PER_S)


@pytest.fixture
def sensor() -> Iterator[socket.socket]:
    """Yield the sensor's end."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as wire:
        wire.bind(("127.0.0.1", 0))
        wire.settimeout(PATIENCE_S)
        yield wire


@pytest.fixture
def link(sensor: socket.socket) -> Iterator[UdpLink]:
    """Yield a link to the sensor that has sent no request yet."""
    made = UdpLink("127.0.0.1", sensor.getsockname()[1], ask_after_s=0.01)
    yield made
    made.close()


def received(link: UdpLink, now_ns: int) -> ReceivedDatagrams:
    """Return the next datagrams; loopback delivers them within moments."""
    give_up_s = time.monotonic() + PATIENCE_S
    while not (found := link.poll(now_ns)).datagrams:
        assert time.monotonic() < give_up_s
    return found


def test_a_stream_is_requested_once_and_stopped_at_the_end(
    link: UdpLink, sensor: socket.socket
) -> None:
    """Datagrams of other addresses are dropped, empty and long ones passed on with their age."""
    assert link.poll(1).asked
    data, client = sensor.recvfrom(64)
    assert data == START
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.sendto(b"of another sender", client)
    for part in (b"", b"x" * 1400):
        sensor.sendto(part, client)
    found = received(link, 2)
    while len(found.datagrams) < 2:
        found.datagrams.extend(received(link, 2).datagrams)
    assert found.datagrams == [b"", b"x" * 1400]
    assert (found.since_ns, found.asked, link.requests) == (1, False, 1)
    link.close()
    assert sensor.recv(64) == request(RdtCommand.STOP)


def test_an_unanswered_request_is_repeated_and_at_last_from_a_new_socket(
    link: UdpLink, sensor: socket.socket
) -> None:
    """After a change of the host's address the old socket would receive nothing."""
    for count in range(REOPEN_AFTER + 1):
        assert link.poll(count * ASK_NS).unanswered == count + 1
        assert not link.poll(count * ASK_NS + ASK_NS - 1).asked
    clients = [sensor.recvfrom(64)[1] for _ in range(REOPEN_AFTER + 1)]
    assert len(set(clients)) == 2
    assert set(clients[:-1]) == {clients[0]}
    sensor.sendto(b"a record", clients[-1])
    assert received(link, (REOPEN_AFTER + 1) * ASK_NS - 1).datagrams == [b"a record"]


class SensorPage(BaseHTTPRequestHandler):
    """A web server of a sensor; the test sets its answer."""

    answer = (404, "")

    def do_GET(self) -> None:
        """Send the page."""
        status, text = self.answer if self.path == PATH else (404, "")
        self.send_response(status)
        self.end_headers()
        self.wfile.write(text.encode())

    def log_message(self, *_: object) -> None:
        """Log nothing."""


def test_the_page_is_fetched_until_it_arrives_and_again_after_a_clear() -> None:
    """Meanwhile the fault names the address and the error: of the network, of HTTP, of the text."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), SensorPage)
    fetch = PageFetch("127.0.0.1", server.server_address[1])
    thread = Thread(target=server.serve_forever, args=(0.02,))
    thread.start()
    now_ns = 1

    def poll_until(fault: str = "", serial: str = "") -> None:
        nonlocal now_ns
        give_up_s = time.monotonic() + PATIENCE_S
        while True:
            read = fetch.poll(now_ns)
            if (fault and fault in fetch.fault) or (read and read.serial == serial):
                return
            assert time.monotonic() < give_up_s, fetch.fault
            time.sleep(0.01)
            now_ns += round(FETCH_AGAIN_S * 0.5e9)

    try:
        poll_until(fault=f"{PATH}: HTTP 404")
        SensorPage.answer = (200, "no page")
        poll_until(fault="cfgfu")
        SensorPage.answer = (200, PAGE)
        poll_until(serial="FT27462")
        fetch.clear()
        assert fetch.fault == "not read yet"
        SensorPage.answer = (200, PAGE.replace("FT27462", "FT00002"))
        poll_until(serial="FT00002")
    finally:
        server.shutdown()
        thread.join()
        server.server_close()
    fetch.clear()
    poll_until(fault="refused")
