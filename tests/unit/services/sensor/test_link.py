"""Connections to a sensor on real sockets: its stream over UDP, its page over HTTP."""

import re
import socket
import time
from collections.abc import Iterator
from types import SimpleNamespace
from unittest.mock import Mock

import pytest

from forcemesh.clock import NS_PER_S
from services.sensor.link import (
    REOPEN_AFTER,
    REPEAT_REQUEST_S,
    PageFetch,
    ReceivedDatagrams,
    UdpLink,
)
from services.sensor.netft_page import PATH, parse
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


@pytest.mark.parametrize(
    ("status", "text", "why"),
    [(404, PAGE, "HTTP 404"), (200, "no page", "cfgfu"), (0, "", "refused"), (200, PAGE, "")],
)
def test_the_fault_of_a_page_names_the_address_and_the_error(
    status: int, text: str, why: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of the network, of HTTP, of the text; without an error there is a page until a clear."""
    answer = SimpleNamespace(status=status, reason="", read=lambda _: text.encode())
    server = Mock(request=Mock(side_effect=None if status else OSError("refused")))
    server.getresponse.return_value = answer
    monkeypatch.setattr("http.client.HTTPConnection", lambda *_, **__: server)
    fetch = PageFetch("labsensor", 80)
    fetch._fetch(1)
    shown = rf"http://labsensor:80{PATH}: .*{why}" if why else "not read yet"
    assert re.match(shown, fetch.fault)
    assert fetch._page == (None if why else parse(PAGE))
    fetch.clear()
    assert fetch.fault == "not read yet"
