"""The gateway's socket on bad lines, on a virtual clock: every answer that a kernel may give.

test_link.py has the same on real sockets.
"""

import errno
import fcntl
import os
import socket
import struct
from collections import deque
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import pytest

from controller.packet import PACKET_CHARS
from services.gateway.link import (
    RECEIVE_BYTES,
    TCP_RECEIVES_PER_POLL,
    Link,
    LinkEvents,
    LinkSettings,
)

MS = 1_000_000
HERE, THERE = ("192.168.0.1", 40_000), ("192.168.0.2", 49_152)
SETTINGS = LinkSettings(*THERE)
PACKET = b"x" * PACKET_CHARS
NAME = "controller 192.168.0.2:49152: "
SILENT_MS, PAUSE_MS = 1e3 * SETTINGS.silent_after_s, 1e3 * SETTINGS.pause_first_s
STALLED_MS = 1e3 * SETTINGS.stalled_after_s
RESET = ConnectionResetError(errno.ECONNRESET, "reset by peer")


def reply(answer: Any) -> Any:
    """Return a scripted answer, or raise it."""
    if isinstance(answer, OSError):
        raise answer
    return answer


class ScriptedSocket:
    """A client's socket with scripted answers of the kernel: socket(7), tcp(7)."""

    def __init__(self) -> None:
        """Succeed at connect; accept and acknowledge everything."""
        self.connects: deque[int | OSError] = deque()  # answers of connect_ex, then 0
        self.arrived: deque[bytes | OSError] = deque()  # data of each recv, then nothing
        self.room: int | OSError = 1 << 30  # bytes that the kernel accepts from now on
        self.confirms = True  # whether the far end acknowledges accepted bytes
        self.outq_error: OSError | None = None  # of the ioctl that reads the unacknowledged bytes
        self.own_name: tuple[str, int] | OSError = HERE
        self.options: list[tuple[Any, ...]] = []
        self.taken = b""
        self.receives = self._confirmed = 0
        self.closed = False

    def settimeout(self, timeout_s: float) -> None:
        """Store the time-out."""
        self.options.append((timeout_s,))

    def setsockopt(self, *option: Any) -> None:
        """Store the option."""
        self.options.append(option)

    def connect_ex(self, address: tuple[str, int]) -> int:
        """Return the next reply; name resolution raises."""
        assert address == THERE
        return int(reply(self.connects.popleft()) if self.connects else 0)

    def recv(self, most: int) -> bytes:
        """Return the bytes that have arrived."""
        self.receives += 1
        data: bytes = reply(self.arrived.popleft() if self.arrived else BlockingIOError())
        assert len(data) <= most
        return data

    def send(self, data: bytes) -> int:
        """Accept as many bytes as there is room for."""
        room = min(int(reply(self.room)), len(data))
        if room == 0:
            raise BlockingIOError(errno.EAGAIN, "no room")
        self.room = int(reply(self.room)) - room
        self.taken += data[:room]
        return room

    def getsockname(self) -> Any:
        """Return this end's address."""
        return reply(self.own_name)

    def getpeername(self) -> tuple[str, int]:
        """Return the other end's address."""
        return THERE

    def close(self) -> None:
        """Close the socket."""
        self.closed = True

    def outq(self, _request: int, _argument: bytes) -> bytes:
        """Return the number of unacknowledged bytes, like SIOCOUTQ."""
        reply(self.outq_error)
        if self.confirms:
            self._confirmed = len(self.taken)
        return struct.pack("i", len(self.taken) - self._confirmed)


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
        return self.sockets[-1]

    def stalled(self, packets: int) -> ScriptedSocket:
        """Connect and send packets that the peer's TCP does not acknowledge."""
        sock = self.opened()
        sock.confirms = False
        for _ in range(packets):
            assert self.send()
        return sock


@pytest.fixture
def line(monkeypatch: pytest.MonkeyPatch) -> Line:
    """Return a link that has not been polled yet."""
    return Line(monkeypatch)


# --- opening --------------------------------------------------------------------------------------


def test_the_loop_never_waits_for_the_line(line: Line) -> None:
    """The socket does not block, and Nagle delays no set point."""
    nodelay = (socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    assert line.opened().options == [(0.0,), nodelay]


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
    assert not line.sockets[0].closed
    assert line.poll(1e-3) == LinkEvents()
    assert (line.link.last_fault, line.sockets[0].closed) == (NAME + "no answer", True)
    line.poll(PAUSE_MS - 1e-3)
    assert len(line.sockets) == 1
    line.poll(1e-3)
    assert len(line.sockets) == 2


@pytest.mark.parametrize(
    ("cause", "fault"),
    [
        (errno.ECONNREFUSED, f"{os.strerror(errno.ECONNREFUSED)}, is its program running?"),
        (socket.gaierror(-2, "Name or service not known"), "[Errno -2] Name or service not known"),
    ],
)
def test_a_failed_connection_reports_the_cause_and_is_tried_again(
    line: Line, cause: int | OSError, fault: str
) -> None:
    """The fault has the address and the kernel's text, or that of the name service."""
    answers: list[int | OSError] = [cause, 0]
    line.prepare = lambda sock: sock.connects.append(answers.pop(0))
    assert line.poll() == LinkEvents()
    assert (line.link.last_fault, line.sockets[0].closed) == (NAME + fault, True)
    assert line.poll(PAUSE_MS).opened


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
        sock.arrived.append(RESET)

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
    [(b"", "closed by the controller"), (RESET, "reset by peer"), (TimeoutError("out"), "out")],
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
    """It counts from the opening, however slow; at the limit itself the connection stays."""
    line.prepare = lambda sock: sock.connects.append(errno.EINPROGRESS)
    line.poll()
    assert line.poll(1e3 * SETTINGS.connect_within_s).opened
    for _ in range(3):
        assert line.poll(SILENT_MS) == LinkEvents()
        line.sockets[0].arrived.append(b"y")
        assert line.poll().data == b"y"
    assert line.poll(SILENT_MS + 1e-3).lost == NAME + "silent for 1.5 s"
    assert line.sockets[0].closed


# --- sending --------------------------------------------------------------------------------------


def test_without_a_connection_nothing_is_kept_for_the_next_one(line: Line) -> None:
    """A set point of an earlier connection must never reach the arm in a later one."""
    assert not line.send(b"before")
    sock = line.opened()
    sock.room = 3
    assert line.send(b"abcdef")
    sock.arrived.append(b"")
    line.poll(2.0)
    line.poll(PAUSE_MS)
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


@pytest.mark.parametrize("room", [0, 1])
def test_a_line_that_breaks_while_sending_is_reported_by_the_next_poll(
    line: Line, room: int
) -> None:
    """`send` raises nothing, also for the rest of a packet, and the closed socket is not used."""
    sock = line.opened()
    sock.room = room
    assert line.send()
    sock.room = RESET
    assert line.send() is False
    assert line.poll(2.0) == LinkEvents(lost=NAME + "reset by peer")
    assert line.poll(2.0) == LinkEvents()
    assert sock.closed
    assert line.poll(PAUSE_MS).opened
    line.sockets[-1].room = room
    assert line.send()
    line.sockets[-1].room = RESET
    assert line.poll(2.0) == LinkEvents(lost=NAME + "reset by peer")


# --- packets that the peer does not acknowledge ---------------------------------------------------


def test_unacknowledged_packets_end_the_connection_after_their_time(line: Line) -> None:
    """Their age counts from the first one; set points must not pile up behind a closed window."""
    line.stalled(packets=2)
    assert line.poll(STALLED_MS).lost == ""
    assert line.poll(1.0).lost == f"{NAME}{2 * PACKET_CHARS} bytes not acknowledged for 201 ms"


def test_one_packet_in_flight_is_no_stall(line: Line) -> None:
    """An acknowledgement may be delayed for longer; the silence of the peer has its own limit."""
    line.stalled(packets=1)
    assert line.poll(SILENT_MS).lost == ""


def test_without_the_count_of_unacknowledged_bytes_those_kept_here_are_still_counted(
    line: Line,
) -> None:
    """Bytes that the kernel has no room for wait in this process, and have an age as well."""
    sock = line.stalled(packets=5)
    sock.outq_error = OSError(errno.ENOTTY, "no such request")
    assert line.poll(STALLED_MS + 1.0).lost == ""
    sock.room = 0
    for _ in range(2):
        assert line.send()
    assert f"{2 * PACKET_CHARS} bytes not acknowledged" in line.poll(STALLED_MS + 1.0).lost


def test_a_peer_that_acknowledges_in_parts_is_never_stalled(line: Line) -> None:
    """The age is that of the oldest packet in flight and not of an earlier stall."""
    sock = line.stalled(packets=2)
    for _ in range(10):
        sock.confirms = True
        assert line.poll(0.6 * STALLED_MS).lost == ""
        sock.confirms = False
        assert line.send()
        assert line.send()
        assert line.poll(0.6 * STALLED_MS).lost == ""
        sock.arrived.append(b"y")


def test_packets_of_the_old_connection_do_not_count_for_the_new_one(line: Line) -> None:
    """Only the age of the new connection's packets counts."""
    line.stalled(packets=2).arrived.append(b"")
    assert line.poll(1.0).lost
    line.poll(STALLED_MS)
    line.sockets[-1].confirms = False
    assert line.send()
    assert line.send()
    assert line.poll(STALLED_MS).lost == ""


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
    assert line.poll(PAUSE_MS).lost == ""
