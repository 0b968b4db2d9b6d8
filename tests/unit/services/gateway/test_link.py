"""The gateway's socket on a real one: the kernel's count of what the peer has not acknowledged."""

import socket
import time

import pytest

from controller.packet import PACKET_CHARS
from services.gateway.link import Link, LinkEvents, LinkSettings

PACKET = b"x" * PACKET_CHARS
PATIENCE_S = 5.0


@pytest.mark.realtime
def test_a_peer_that_stops_to_read_ends_the_connection_and_one_that_reads_does_not() -> None:
    """Set points must not accumulate in the kernel."""
    with socket.socket() as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        port = listener.getsockname()[1]
        link = Link(LinkSettings("127.0.0.1", port, stalled_after_s=0.1, silent_after_s=60.0))
        client, read, events = None, b"", LinkEvents()
        started_s = time.monotonic()
        while not events.lost:
            age_s = time.monotonic() - started_s
            assert age_s < PATIENCE_S, link.last_fault
            events = link.poll(time.monotonic_ns())
            if events.opened:
                client, _ = listener.accept()
            link.send(PACKET, time.monotonic_ns())
            if client is not None and age_s < 0.4:
                assert events.lost == ""
                read += client.recv(4096)
                time.sleep(0.002)
        assert "not acknowledged for" in events.lost
        assert read[:PACKET_CHARS] == PACKET
        assert client is not None
        client.close()
