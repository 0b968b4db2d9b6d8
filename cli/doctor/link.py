"""Link check of `forcemesh doctor`: hello, command 12, and hold to the controller. Nothing moves.

Command 12 arms the program's watchdog, for which silence is a fault. Each 12 is therefore sent in
one write with a hold (command 8), which disarms it: if this process ends early, the controller is
left held, and not latched.
"""

import secrets
import select
import socket
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from cli.doctor.checks import HelloOutcome, Opened
from controller.packet import PACKET_CHARS, Packet, PacketReader
from controller.packet_table import ID_COUNT, ID_FIRST, Scales
from forcemesh.clock import NS_PER_S
from forcemesh.errors import RemoteProtocolError
from services.gateway.dialogue import Dialogue
from services.gateway.packet_window import Rate, RoundTrips, Spread, WrappingCounterRate
from services.gateway.packets import HealthReport, JointReport, Pacing, PoseReport

PROBE_EVERY_S = 0.1
RECEIVE_BYTES = 16_384
LOOPS_SPAN = 500_000


@dataclass(frozen=True, slots=True)
class VisitTimeouts:
    """Timeouts and watch time of a visit."""

    connect_s: float = 2.0
    hello_s: float = 5.0  # the program may take 4 s to release the previous client
    reports_s: float = 2.0
    watch_s: float = 4.0
    confirm_s: float = 1.0


PATIENCE = VisitTimeouts()


@dataclass(slots=True)
class ReceivedReports:
    """Reports received from the controller during a visit."""

    pose: PoseReport | None = None
    joints: JointReport | None = None
    health: HealthReport | None = None
    sender_hz: float | None = None
    longest_gap_s: float | None = None
    loop_hz: float | None = None
    round_trip: Spread | None = None
    held: bool = False  # the last hold was acknowledged
    broken: str = ""  # why the connection ended early


@dataclass(slots=True)
class Visit:
    """Result of a visit to the controller, up to the step that failed."""

    opened: Opened = "open"
    opened_detail: str = ""
    opened_s: float = 0.0
    hello_outcome: HelloOutcome = "silent"
    hello_detail: str = ""
    hello_s: float = 0.0
    hello: Packet | None = None
    reports: ReceivedReports | None = None  # None: version or scales did not match


def visit_controller(
    host: str, port: int, scales: Scales, patience: VisitTimeouts | None = None, *, arm: int = 1
) -> Visit:
    """Connect, greet, watch for some seconds, disconnect. Raises nothing for errors of the peer."""
    found, patience = Visit(), patience or PATIENCE
    started_s = time.monotonic()
    try:
        sock = _open_socket((host, port), patience.connect_s)
    except OSError as error:
        found.opened, found.opened_detail = _failure_outcome(error)
        return found
    finally:
        found.opened_s = time.monotonic() - started_s
    with sock:
        last_id = ID_FIRST + secrets.randbelow(ID_COUNT)  # reports for an earlier client differ
        dialogue = Dialogue(scales, Pacing(heartbeat_after_s=0.0), arm=arm, last_id=last_id)
        exchange = _ControllerExchange(sock, dialogue, patience)
        exchange.greet(found)
        if exchange.dialogue.ready:
            found.reports = exchange.watch()
    return found


def _open_socket(endpoint: tuple[str, int], timeout_s: float) -> socket.socket:
    """Open the connection, over IPv4 as the controller does. Raise OSError."""
    address = socket.getaddrinfo(*endpoint, socket.AF_INET, socket.SOCK_STREAM)[0][4]
    sock = socket.create_connection((str(address[0]), int(address[1])), timeout_s)
    if sock.getsockname() == sock.getpeername():  # TCP self-connect: there is no listener
        sock.close()
        raise ConnectionRefusedError
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return sock


def _failure_outcome(error: OSError) -> tuple[Opened, str]:
    if isinstance(error, ConnectionRefusedError):
        return "refused", ""
    if isinstance(error, TimeoutError):
        return "silent", ""
    outcome: Opened = "unresolved" if isinstance(error, socket.gaierror) else "unreachable"
    return outcome, error.strerror or str(error)


@dataclass(slots=True)
class _ControllerExchange:
    """Connection to the controller."""

    sock: socket.socket
    dialogue: Dialogue
    patience: VisitTimeouts
    reports: ReceivedReports = field(default_factory=ReceivedReports)
    samples: Rate = field(default_factory=Rate)
    loops: WrappingCounterRate = field(default_factory=lambda: WrappingCounterRate(LOOPS_SPAN))
    trips: RoundTrips = field(default_factory=RoundTrips)
    sample_ns: int | None = None  # time of the last sample
    pending: PoseReport | None = None

    def greet(self, found: Visit) -> None:
        """Send hello, read the reply, and let the dialogue check it."""
        started_ns = time.monotonic_ns()
        data = b""
        try:
            self.sock.sendall(self.dialogue.connected(started_ns))
            while len(data) < PACKET_CHARS:
                left_s = self.patience.hello_s - (time.monotonic_ns() - started_ns) / NS_PER_S
                if left_s <= 0.0:
                    break
                self.sock.settimeout(left_s)
                data += self._receive()
        except TimeoutError:
            pass
        except OSError as error:
            found.hello_outcome, found.hello_detail = "closed", error.strerror or str(error)
        now_ns = time.monotonic_ns()
        found.hello_s = (now_ns - started_ns) / NS_PER_S
        if len(data) < PACKET_CHARS:
            return
        try:
            (found.hello,) = PacketReader().feed(data[:PACKET_CHARS])
            found.hello_outcome = "answered"
            self._handle_reports(data, now_ns)
        except RemoteProtocolError as error:
            if found.hello is None:
                found.hello_outcome, found.hello_detail = "garbled", str(error)

    def watch(self) -> ReceivedReports:
        """Receive reports, and periodically send command 12 followed by a hold."""
        try:
            self._receive_for(self.patience.reports_s, lambda: self.reports.joints is not None)
            end_ns = time.monotonic_ns() + round(self.patience.watch_s * NS_PER_S)
            while time.monotonic_ns() < end_ns and self.reports.joints is not None:
                self._probe()
                self._receive_for(PROBE_EVERY_S)
            self._probe()
            self._receive_for(
                self.patience.confirm_s, lambda: self.dialogue.window.unacknowledged == 0
            )
            self.reports.held = self.dialogue.window.unacknowledged == 0
        except (OSError, RemoteProtocolError) as error:
            self.reports.broken = str(error)
        now_ns = time.monotonic_ns()
        self.reports.sender_hz = self.samples.hz(now_ns)
        self.reports.loop_hz = self.loops.hz(now_ns)
        self.reports.round_trip = self.trips.spread(now_ns)
        return self.reports

    def _probe(self) -> None:
        now_ns = time.monotonic_ns()
        heartbeat = self.dialogue.tick(now_ns, permitted=True)
        self.trips.sent(self.dialogue.window.last, now_ns)
        self.sock.sendall(heartbeat + self.dialogue.hold(now_ns))

    def _receive_for(self, duration_s: float, until: Callable[[], bool] = lambda: False) -> None:
        """Receive for a period, or until a condition holds."""
        end_ns = time.monotonic_ns() + round(duration_s * NS_PER_S)
        while not until():
            left_s = (end_ns - time.monotonic_ns()) / NS_PER_S
            if left_s <= 0.0 or not select.select([self.sock], [], [], left_s)[0]:
                return
            self._handle_reports(self._receive(), time.monotonic_ns())

    def _receive(self) -> bytes:
        data = self.sock.recv(RECEIVE_BYTES)
        if not data:
            raise ConnectionError("closed by the controller")
        return data

    def _handle_reports(self, data: bytes, now_ns: int) -> None:
        for event in self.dialogue.feed(data, now_ns):
            if isinstance(event, HealthReport):
                self.reports.health = event
                self.loops.read(event.loop_count, now_ns)
            elif isinstance(event, PoseReport):
                self.pending = event
            elif isinstance(event, JointReport) and self.pending is not None:
                self.reports.pose, self.reports.joints = self.pending, event
                self.trips.reached(self.dialogue.window.framed, now_ns)
                self.samples.count(1, now_ns)
                if self.sample_ns is not None:
                    gap_s = (now_ns - self.sample_ns) / NS_PER_S
                    self.reports.longest_gap_s = max(self.reports.longest_gap_s or 0.0, gap_s)
                self.sample_ns = now_ns
