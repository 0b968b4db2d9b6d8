"""The gateway's socket on bad lines, on a virtual clock: every answer that a kernel may give.

The same on real sockets: test_link.py.
"""

import errno
import fcntl
import os
import socket
from collections.abc import Callable
from itertools import pairwise

import pytest

from controller.packet import PACKET_CHARS
from services.gateway.link import RECEIVE_BYTES, TCP_RECEIVES_PER_POLL, Link, LinkSettings, News
from tests.fakes.scripted_socket import THERE, ScriptedSocket

MS = 1_000_000
SETTINGS = LinkSettings(*THERE)
PACKET = b"x" * PACKET_CHARS
NAME = "controller 192.168.0.2:49152: "


class Line:
    """A link, and the sockets that it makes, oldest first."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Make nothing yet."""
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
        """The newest one."""
        return self.sockets[-1]

    def poll(self, after_ms: float = 0.0) -> News:
        """Poll after a while."""
        self.now_ns += round(after_ms * MS)
        return self.link.poll(self.now_ns)

    def send(self, data: bytes = PACKET) -> bool:
        """Send now."""
        return self.link.send(data, self.now_ns)

    def opened(self) -> ScriptedSocket:
        """Connect; return the socket."""
        assert self.poll().opened
        return self.socket


@pytest.fixture
def line(monkeypatch: pytest.MonkeyPatch) -> Line:
    """A link that has not been polled yet."""
    return Line(monkeypatch)


# --- being opened ---------------------------------------------------------------------------------


def test_the_loop_never_waits_for_the_line(line: Line) -> None:
    """The socket does not block, and Nagle keeps no set point back."""
    sock = line.opened()
    assert sock.timeouts_s == [0.0]
    assert sock.options == [(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)]


@pytest.mark.parametrize("done", [0, errno.EISCONN])
def test_a_connection_that_takes_its_time_is_opened_when_it_stands(line: Line, done: int) -> None:
    """One socket asks until it is connected, and it is told once."""
    line.prepare = lambda sock: sock.connects.extend([errno.EINPROGRESS, errno.EALREADY, done])
    assert [line.poll(1.0).opened for _ in range(4)] == [False, False, True, False]
    assert (len(line.sockets), line.link.connections, line.link.is_open) == (1, 1, True)


def test_an_address_that_does_not_answer_is_given_up_after_its_time(line: Line) -> None:
    """Not at the time itself, then after a pause with a new socket; no connection was lost."""
    line.prepare = lambda sock: sock.connects.extend([errno.EINPROGRESS] * 100)
    line.poll()
    line.poll(1e3 * SETTINGS.connect_within_s)
    assert not line.socket.closed
    assert line.poll(1e-3) == News()
    assert line.link.last_fault == NAME + "no answer"
    assert line.socket.closed
    line.poll(1e3 * SETTINGS.pause_first_s - 1e-3)
    assert len(line.sockets) == 1
    line.poll(1e-3)
    assert len(line.sockets) == 2


@pytest.mark.parametrize("code", [errno.ECONNREFUSED, errno.EHOSTUNREACH, errno.ENETUNREACH])
def test_a_connection_that_is_refused_says_why_and_what_to_look_at(line: Line, code: int) -> None:
    """In the kernel's words, with the address."""
    line.prepare = lambda sock: sock.connects.append(code)
    assert line.poll() == News()
    assert line.link.last_fault == f"{NAME}{os.strerror(code)}, is its program running?"
    assert line.socket.closed


def test_a_name_that_does_not_resolve_is_tried_again(line: Line) -> None:
    """The name service may be back later."""
    answers: list[int | OSError] = [socket.gaierror(-2, "Name or service not known"), 0]
    line.prepare = lambda sock: sock.connects.append(answers.pop(0))
    assert line.poll() == News()
    assert "Name or service not known" in line.link.last_fault
    assert line.poll(1e3 * SETTINGS.pause_first_s).opened


def test_a_connection_to_itself_is_no_controller(line: Line) -> None:
    """TCP allows it where nobody listens; our own packets would come back as its reports."""
    line.prepare = lambda sock: setattr(sock, "own_name", THERE)
    assert line.poll() == News()
    assert line.link.last_fault == NAME + "no server listens there"
    assert not line.send()


def test_a_connection_that_is_gone_before_it_was_asked_is_told_by_its_first_receive(
    line: Line,
) -> None:
    """Opened and lost in one poll, in this order."""

    def gone(sock: ScriptedSocket) -> None:
        sock.own_name = OSError(errno.ENOTCONN, "not connected")
        sock.arrived.append(ConnectionResetError(errno.ECONNRESET, "reset by peer"))

    line.prepare = gone
    assert line.poll() == News(opened=True, lost=NAME + "reset by peer")


# --- receiving ------------------------------------------------------------------------------------


def test_a_flood_takes_no_more_than_its_share_of_a_step(line: Line) -> None:
    """What is left waits in the kernel, nothing of it is lost, and its order stays."""
    sock = line.opened()
    chunks = [bytes([number]) * RECEIVE_BYTES for number in range(2 * TCP_RECEIVES_PER_POLL)]
    sock.arrived.extend(chunks)
    before = sock.receives
    first = line.poll(2.0).data
    assert sock.receives - before == TCP_RECEIVES_PER_POLL
    assert first + line.poll(2.0).data == b"".join(chunks)


@pytest.mark.parametrize(
    ("end", "words"),
    [
        (b"", "closed by the controller"),
        (ConnectionResetError(errno.ECONNRESET, "reset by peer"), "reset by peer"),
        (TimeoutError("timed out"), "timed out"),
    ],
)
def test_what_came_before_an_end_is_told_with_it(
    line: Line, end: bytes | OSError, words: str
) -> None:
    """The last report is read before the line is given up, and the reason comes once."""
    line.opened().arrived.extend([b"last ", b"words", end])
    assert line.poll(2.0) == News(data=b"last words", lost=NAME + words)
    assert line.poll(2.0) == News()
    assert not line.send()


def test_silence_ends_a_connection_and_any_byte_keeps_it(line: Line) -> None:
    """A controller sends endlessly: at the limit it is still there, beyond it is frozen."""
    sock = line.opened()
    for _ in range(3):
        assert line.poll(1e3 * SETTINGS.silent_after_s) == News(data=b"")
        sock.arrived.append(b"y")
        assert line.poll().data == b"y"
    assert line.poll(1e3 * SETTINGS.silent_after_s + 1e-3).lost == NAME + "silent for 1.5 s"
    assert sock.closed


def test_silence_counts_from_the_opening_and_not_from_the_first_attempt(line: Line) -> None:
    """A connection that took its time is not given up for it."""
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


def test_what_the_kernel_does_not_take_follows_in_its_order(line: Line) -> None:
    """Half a packet, then its rest before the next one."""
    sock = line.opened()
    sock.room = 4
    assert line.send(b"abcdef")
    assert line.send(b"ghi")
    assert sock.taken == b"abcd"
    sock.room = 1 << 30
    line.poll(2.0)
    assert sock.taken == b"abcdefghi"


def test_a_line_that_breaks_while_sending_is_told_by_the_next_poll(line: Line) -> None:
    """`send` says that it did not go; nothing is raised, and the reason is not lost."""
    line.opened().room = BrokenPipeError(errno.EPIPE, "Broken pipe")
    assert not line.send()
    assert line.poll(2.0) == News(lost=NAME + "Broken pipe")
    assert line.poll(2.0) == News()


def test_a_line_that_breaks_while_the_rest_is_sent_is_told_at_once(line: Line) -> None:
    """The poll that finds out says so, and watches no socket that is gone."""
    sock = line.opened()
    sock.room = 1
    assert line.send()
    sock.room = ConnectionResetError(errno.ECONNRESET, "reset by peer")
    assert line.poll(2.0) == News(lost=NAME + "reset by peer")
    assert sock.closed


# --- what the far end does not take ---------------------------------------------------------------


def stalled(line: Line, packets: int) -> ScriptedSocket:
    """Send packets that the far end's TCP does not acknowledge."""
    sock = line.opened()
    sock.confirms = False
    for _ in range(packets):
        assert line.send()
    return sock


def test_packets_that_are_not_taken_end_the_connection_after_their_time(line: Line) -> None:
    """Their age counts from the first one; set points must not pile up behind a shut window."""
    sock = stalled(line, packets=2)
    limit_ms = 1e3 * SETTINGS.stalled_after_s
    assert line.poll(limit_ms).lost == ""
    assert line.poll(1.0).lost == f"{NAME}{2 * PACKET_CHARS} bytes not acknowledged for 201 ms"
    assert sock.closed


def test_one_packet_on_its_way_is_no_stall(line: Line) -> None:
    """An acknowledgement may be delayed for longer; the silence of the peer is another limit."""
    stalled(line, packets=1)
    assert line.poll(1e3 * SETTINGS.silent_after_s).lost == ""


def test_what_the_kernel_has_no_room_for_counts_as_not_taken(line: Line) -> None:
    """It waits in this process, and is as old as what the peer has not acknowledged."""
    sock = line.opened()
    sock.room = 0
    assert line.send()
    assert line.send()
    lost = line.poll(1e3 * SETTINGS.stalled_after_s + 1.0).lost
    assert f"{2 * PACKET_CHARS} bytes not acknowledged" in lost


def test_a_peer_that_takes_in_turns_is_never_called_stalled(line: Line) -> None:
    """The age is that of the oldest packet that is still on its way, not of the stall before."""
    sock = stalled(line, packets=2)
    for _ in range(10):
        sock.confirms = True
        assert line.poll(0.6e3 * SETTINGS.stalled_after_s).lost == ""
        sock.confirms = False
        assert line.send()
        assert line.send()
        assert line.poll(0.6e3 * SETTINGS.stalled_after_s).lost == ""
        sock.arrived.append(b"y")


def test_a_new_connection_is_not_blamed_for_packets_of_the_one_before(line: Line) -> None:
    """Whatever was on its way when that one ended: the age of the new one's packets counts."""
    sock = stalled(line, packets=2)
    sock.arrived.append(b"")
    assert line.poll(1.0).lost
    line.poll(1e3 * SETTINGS.stalled_after_s)
    assert line.link.is_open
    line.socket.confirms = False
    assert line.send()
    assert line.send()
    assert line.poll(1e3 * SETTINGS.stalled_after_s).lost == ""


def test_where_the_kernel_cannot_say_what_is_on_its_way_the_rest_is_still_watched(
    line: Line,
) -> None:
    """Without the ioctl nothing counts as on its way but what this process has kept."""
    sock = stalled(line, packets=5)
    sock.outq_error = OSError(errno.ENOTTY, "no such request")
    assert line.poll(1e3 * SETTINGS.stalled_after_s + 1.0).lost == ""
    sock.room = 0
    for _ in range(2):
        assert line.send()
    assert "bytes not acknowledged" in line.poll(1e3 * SETTINGS.stalled_after_s + 1.0).lost


# --- pauses ---------------------------------------------------------------------------------------


def test_pauses_grow_to_the_longest_and_a_greeting_makes_them_short_again(line: Line) -> None:
    """0.1, 0.2, 0.4 ... 2 s: an absent controller is not besieged, one that is back is not late."""
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


def test_a_link_that_is_given_up_before_it_was_open_loses_nothing(line: Line) -> None:
    """The gateway closes it at its end, whatever state it is in."""
    line.link.close("the gateway ends", 0)
    assert line.link.last_fault == "the gateway ends"
    assert line.poll(1e3 * SETTINGS.pause_first_s).lost == ""
