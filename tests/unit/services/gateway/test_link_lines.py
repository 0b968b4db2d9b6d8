"""The gateway's socket on bad lines, on a virtual clock: every answer that a kernel may give.

test_link.py has the same on real sockets.
"""

import errno
import fcntl
import os
import socket
from collections.abc import Callable
from itertools import pairwise

import pytest

from controller.packet import PACKET_CHARS
from services.gateway.link import (
    RECEIVE_BYTES,
    TCP_RECEIVES_PER_POLL,
    Link,
    LinkEvents,
    LinkSettings,
)
from tests.fakes.scripted_socket import THERE, ScriptedSocket

MS = 1_000_000
SETTINGS = LinkSettings(*THERE)
PACKET = b"x" * PACKET_CHARS
NAME = "controller 192.168.0.2:49152: "


class Line:
    """A link and its sockets, oldest first."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Create a link without a socket."""
        self.prepare: Callable[[ScriptedSocket], object] = lambda _: None  # the next sockets
        self.sockets: list[ScriptedSocket] = []
        self.link = Link(SETTINGS)
        self.now_ns = 0
        monkeypatch.setattr(socket, "socket", self._make)
        monkeypatch.setattr(fcntl, "ioctl", lambda sock, *request: sock.outq(*request))

    def _make(self, *_family: object) -> ScriptedSocket:
        sock = ScriptedSocket()
        self.prepare(sock)
        self.sockets.append(sock)
        return sock

    @property
    def socket(self) -> ScriptedSocket:
        """Return the newest socket."""
        return self.sockets[-1]

    def poll(self, after_ms: float = 0.0) -> LinkEvents:
        """Poll after a time."""
        self.now_ns += round(after_ms * MS)
        return self.link.poll(self.now_ns)

    def send(self, data: bytes = PACKET) -> bool:
        """Send at the present time."""
        return self.link.send(data, self.now_ns)

    def opened(self) -> ScriptedSocket:
        """Connect; return the socket."""
        assert self.poll().opened
        return self.socket


@pytest.fixture
def line(monkeypatch: pytest.MonkeyPatch) -> Line:
    """Return a link that has not been polled yet."""
    return Line(monkeypatch)


# --- opening --------------------------------------------------------------------------------------


def test_the_loop_never_waits_for_the_line(line: Line) -> None:
    """The socket does not block, and Nagle delays no set point."""
    sock = line.opened()
    assert sock.timeouts_s == [0.0]
    assert sock.options == [(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)]


@pytest.mark.parametrize("done", [0, errno.EISCONN])
def test_a_slow_connection_is_opened_when_it_is_established(line: Line, done: int) -> None:
    """One socket is polled until it is connected, which is reported once."""
    line.prepare = lambda sock: sock.connects.extend([errno.EINPROGRESS, errno.EALREADY, done])
    assert [line.poll(1.0).opened for _ in range(4)] == [False, False, True, False]
    assert (len(line.sockets), line.link.connections, line.link.is_open) == (1, 1, True)


def test_an_address_that_does_not_answer_is_abandoned_after_its_time(line: Line) -> None:
    """At the limit itself it still waits; then comes a pause and a new socket. Nothing is lost."""
    line.prepare = lambda sock: sock.connects.extend([errno.EINPROGRESS] * 100)
    line.poll()
    line.poll(1e3 * SETTINGS.connect_within_s)
    assert not line.socket.closed
    assert line.poll(1e-3) == LinkEvents()
    assert line.link.last_fault == NAME + "no answer"
    assert line.socket.closed
    line.poll(1e3 * SETTINGS.pause_first_s - 1e-3)
    assert len(line.sockets) == 1
    line.poll(1e-3)
    assert len(line.sockets) == 2


@pytest.mark.parametrize("code", [errno.ECONNREFUSED, errno.EHOSTUNREACH, errno.ENETUNREACH])
def test_a_refused_connection_reports_the_cause_and_the_check(line: Line, code: int) -> None:
    """The fault has the kernel's text and the address."""
    line.prepare = lambda sock: sock.connects.append(code)
    assert line.poll() == LinkEvents()
    assert line.link.last_fault == f"{NAME}{os.strerror(code)}, is its program running?"
    assert line.socket.closed


def test_a_name_that_does_not_resolve_is_tried_again(line: Line) -> None:
    """The name service may recover later."""
    answers: list[int | OSError] = [socket.gaierror(-2, "Name or service not known"), 0]
    line.prepare = lambda sock: sock.connects.append(answers.pop(0))
    assert line.poll() == LinkEvents()
    assert "Name or service not known" in line.link.last_fault
    assert line.poll(1e3 * SETTINGS.pause_first_s).opened


def test_a_connection_to_itself_is_no_controller(line: Line) -> None:
    """TCP permits it where no server listens; the packets would return as reports."""
    line.prepare = lambda sock: setattr(sock, "own_name", THERE)
    assert line.poll() == LinkEvents()
    assert line.link.last_fault == NAME + "no server listens there"
    assert not line.send()


def test_a_connection_lost_before_the_first_poll_is_reported_by_its_first_receive(
    line: Line,
) -> None:
    """One poll reports both, opened and lost."""

    def lose(sock: ScriptedSocket) -> None:
        sock.own_name = OSError(errno.ENOTCONN, "not connected")
        sock.arrived.append(ConnectionResetError(errno.ECONNRESET, "reset by peer"))

    line.prepare = lose
    assert line.poll() == LinkEvents(opened=True, lost=NAME + "reset by peer")


# --- receiving ------------------------------------------------------------------------------------


def test_a_flood_of_data_is_limited_in_each_step(line: Line) -> None:
    """The rest stays in the kernel, without loss and in its order."""
    sock = line.opened()
    chunks = [bytes([number]) * RECEIVE_BYTES for number in range(2 * TCP_RECEIVES_PER_POLL)]
    sock.arrived.extend(chunks)
    before = sock.receives
    first = line.poll(2.0).data
    assert sock.receives - before == TCP_RECEIVES_PER_POLL
    assert first + line.poll(2.0).data == b"".join(chunks)


@pytest.mark.parametrize(
    ("end", "message"),
    [
        (b"", "closed by the controller"),
        (ConnectionResetError(errno.ECONNRESET, "reset by peer"), "reset by peer"),
        (TimeoutError("timed out"), "timed out"),
    ],
)
def test_data_before_the_end_is_reported_with_it(
    line: Line, end: bytes | OSError, message: str
) -> None:
    """The last report is read before the line is closed, and the reason comes once."""
    line.opened().arrived.extend([b"last ", b"message", end])
    assert line.poll(2.0) == LinkEvents(data=b"last message", lost=NAME + message)
    assert line.poll(2.0) == LinkEvents()
    assert not line.send()


def test_silence_ends_a_connection_and_any_byte_keeps_it(line: Line) -> None:
    """At the limit the connection stays; beyond it the controller counts as frozen."""
    sock = line.opened()
    for _ in range(3):
        assert line.poll(1e3 * SETTINGS.silent_after_s) == LinkEvents(data=b"")
        sock.arrived.append(b"y")
        assert line.poll().data == b"y"
    assert line.poll(1e3 * SETTINGS.silent_after_s + 1e-3).lost == NAME + "silent for 1.5 s"
    assert sock.closed


def test_silence_counts_from_the_opening_of_the_connection(line: Line) -> None:
    """A slow connection is not closed for the time of its opening."""
    line.prepare = lambda sock: sock.connects.append(errno.EINPROGRESS)
    line.poll()
    assert line.poll(1e3 * SETTINGS.connect_within_s).opened
    assert line.poll(1e3 * SETTINGS.silent_after_s).lost == ""
    assert line.poll(1e-3).lost == NAME + "silent for 1.5 s"


# --- sending --------------------------------------------------------------------------------------


def test_without_a_connection_nothing_is_kept_for_the_next_one(line: Line) -> None:
    """A set point of an earlier connection must never reach the arm in a later one."""
    assert not line.send(b"before")
    sock = line.opened()
    sock.room = 3
    assert line.send(b"abcdef")
    sock.arrived.append(b"")
    line.poll(2.0)
    line.poll(1e3 * SETTINGS.pause_first_s)
    assert line.send(b"new")
    assert [each.taken for each in line.sockets] == [b"abc", b"new"]


def test_bytes_that_the_kernel_refuses_follow_in_their_order(line: Line) -> None:
    """Half a packet is sent, then its rest before the next one."""
    sock = line.opened()
    sock.room = 4
    assert line.send(b"abcdef")
    assert line.send(b"ghi")
    assert sock.taken == b"abcd"
    sock.room = 1 << 30
    line.poll(2.0)
    assert sock.taken == b"abcdefghi"


def test_a_line_that_breaks_while_sending_is_reported_by_the_next_poll(line: Line) -> None:
    """`send` returns False; nothing is raised, and the next poll has the reason."""
    line.opened().room = BrokenPipeError(errno.EPIPE, "Broken pipe")
    assert not line.send()
    assert line.poll(2.0) == LinkEvents(lost=NAME + "Broken pipe")
    assert line.poll(2.0) == LinkEvents()


def test_a_line_that_breaks_while_the_rest_is_sent_is_reported_at_once(line: Line) -> None:
    """The same poll reports it and does not use the closed socket."""
    sock = line.opened()
    sock.room = 1
    assert line.send()
    sock.room = ConnectionResetError(errno.ECONNRESET, "reset by peer")
    assert line.poll(2.0) == LinkEvents(lost=NAME + "reset by peer")
    assert sock.closed


# --- packets that the peer does not acknowledge ---------------------------------------------------


def stalled(line: Line, packets: int) -> ScriptedSocket:
    """Send packets that the peer's TCP does not acknowledge."""
    sock = line.opened()
    sock.confirms = False
    for _ in range(packets):
        assert line.send()
    return sock


def test_unacknowledged_packets_end_the_connection_after_their_time(line: Line) -> None:
    """Their age counts from the first one; set points must not pile up behind a closed window."""
    sock = stalled(line, packets=2)
    limit_ms = 1e3 * SETTINGS.stalled_after_s
    assert line.poll(limit_ms).lost == ""
    assert line.poll(1.0).lost == f"{NAME}{2 * PACKET_CHARS} bytes not acknowledged for 201 ms"
    assert sock.closed


def test_one_packet_in_flight_is_no_stall(line: Line) -> None:
    """An acknowledgement may be delayed for longer; the silence of the peer has its own limit."""
    stalled(line, packets=1)
    assert line.poll(1e3 * SETTINGS.silent_after_s).lost == ""


def test_bytes_that_the_kernel_has_no_room_for_count_as_unacknowledged(line: Line) -> None:
    """They wait in this process and have the age of the unacknowledged packets."""
    sock = line.opened()
    sock.room = 0
    assert line.send()
    assert line.send()
    lost = line.poll(1e3 * SETTINGS.stalled_after_s + 1.0).lost
    assert f"{2 * PACKET_CHARS} bytes not acknowledged" in lost


def test_a_peer_that_acknowledges_in_parts_is_never_stalled(line: Line) -> None:
    """The age is that of the oldest packet in flight and not of an earlier stall."""
    sock = stalled(line, packets=2)
    for _ in range(10):
        sock.confirms = True
        assert line.poll(0.6e3 * SETTINGS.stalled_after_s).lost == ""
        sock.confirms = False
        assert line.send()
        assert line.send()
        assert line.poll(0.6e3 * SETTINGS.stalled_after_s).lost == ""
        sock.arrived.append(b"y")


def test_packets_of_the_old_connection_do_not_count_for_the_new_one(line: Line) -> None:
    """Only the age of the new connection's packets counts."""
    sock = stalled(line, packets=2)
    sock.arrived.append(b"")
    assert line.poll(1.0).lost
    line.poll(1e3 * SETTINGS.stalled_after_s)
    assert line.link.is_open
    line.socket.confirms = False
    assert line.send()
    assert line.send()
    assert line.poll(1e3 * SETTINGS.stalled_after_s).lost == ""


def test_without_the_count_of_unacknowledged_bytes_the_rest_is_still_checked(
    line: Line,
) -> None:
    """Without the ioctl only the packets kept in this process count."""
    sock = stalled(line, packets=5)
    sock.outq_error = OSError(errno.ENOTTY, "no such request")
    assert line.poll(1e3 * SETTINGS.stalled_after_s + 1.0).lost == ""
    sock.room = 0
    for _ in range(2):
        assert line.send()
    assert "bytes not acknowledged" in line.poll(1e3 * SETTINGS.stalled_after_s + 1.0).lost


# --- pauses ---------------------------------------------------------------------------------------


def test_pauses_grow_to_the_longest_and_a_hello_shortens_them(line: Line) -> None:
    """0.1, 0.2, 0.4 ... 2 s: few attempts for an absent controller, a quick one after a hello."""
    line.prepare = lambda sock: sock.connects.append(errno.ECONNREFUSED)
    at_ms: list[int] = []
    for now_ms in range(9000):
        count = len(line.sockets)
        line.link.poll(now_ms * MS)
        if len(line.sockets) > count:
            at_ms.append(now_ms)
        if now_ms == 7000:
            line.link.greeted()
    pauses_ms = [after - before for before, after in pairwise(at_ms)]
    assert pauses_ms[:6] == [100, 200, 400, 800, 1600, 2000]
    assert pauses_ms[6:8] == [2000, 100]


def test_a_link_that_is_closed_before_it_was_open_loses_nothing(line: Line) -> None:
    """The gateway closes the link at its end, in any state of the link."""
    line.link.close("the gateway ends", 0)
    assert line.link.last_fault == "the gateway ends"
    assert line.poll(1e3 * SETTINGS.pause_first_s).lost == ""
