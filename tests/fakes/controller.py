"""A robot controller on a real TCP socket: the other end of the packet protocol, with tantrums.

It reads and writes with `common.packet` alone. Like the real program it streams 101 and 102 (one
counter for both of a sample) and 103, takes ring commands one by one, and has a watchdog that
latches. It watches from the first packet after hello or hold that is more than a setting: then
something may move, and silence is a fault.
"""

import random
import select
import socket
import struct
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import pinocchio as pin

from common.errors import RemoteProtocolError
from common.packet import Packet, PacketReader, VecInt, encode
from common.packet_table import (
    COMMANDS,
    FEEDBACK_BITS,
    ID_FIRST,
    NO_ID,
    Com,
    FeedbackSwitch,
    Status,
    greeting,
    known,
    next_id,
    pack_status,
)
from tests.fakes.robot_program import RobotProgram

SETTINGS = {Com.SPEEDS, Com.GAINS, Com.LIMITS, Com.TCP}


@dataclass(frozen=True, slots=True)
class Received:
    """A packet and when it came."""

    packet: Packet
    at_ns: int


@dataclass(slots=True)
class Tantrums:
    """What a test may do to the wire; all may be changed while the controller runs."""

    chop: bool = False  # write in pieces of 1 to 60 bytes
    merge: int = 1  # samples that are written at once
    frozen: bool = False  # neither read nor write
    mute: bool = False  # read, but write nothing
    stalled: bool = False  # the robot program takes nothing from the ring
    greeting: int = greeting(1)  # Param of its hello
    any_peer: bool = True
    scales: VecInt | None = None  # set others than it was asked for
    greet: bool = True  # answer hello


class FakeController:
    """Use as a context manager: listens on `port` until left."""

    def __init__(self, *, rate_hz: float = 100.0, health_hz: float = 10.0, lag_s: float = 0.02):
        self.tantrums = Tantrums()
        self.robot = RobotProgram(lag_s=lag_s)
        self.received: list[Received] = []
        self.connections = 0
        self.errors: list[str] = []
        self._period_s, self._health_every = 1.0 / rate_hz, max(1, round(rate_hz / health_hz))
        self._random = random.Random(1)
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self._client: socket.socket | None = None
        self._reader = PacketReader()
        self._said_hello = self._greeted = self._armed = False
        self._framed_id = NO_ID
        self._outbox = b""
        self._heard_at = 0.0
        self._samples = 0
        self._stop = threading.Event()
        self._news = threading.Condition(threading.RLock())  # guards everything above
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> "FakeController":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self._drop()
        self._listener.close()

    # --- what tests use ---------------------------------------------------------------------------

    @property
    def T_base_flange(self) -> pin.SE3:
        """Where the flange is."""
        with self._news:
            return self.robot.arm.pose(self.robot.joint_rad)

    def of(self, *coms: Com) -> list[Packet]:
        """Received packets of these commands."""
        with self._news:
            return [r.packet for r in self.received if r.packet.com in coms]

    def wait_for(self, condition: Callable[[], bool], timeout_s: float = 5.0) -> bool:
        """Wait until a condition holds; it is looked at after each cycle of the controller."""
        with self._news:
            return self._news.wait_for(condition, timeout_s)

    def write(self, data: bytes) -> None:
        """Put any bytes into the stream."""
        with self._news:
            self._write(data)

    def drop(self, *, reset: bool = False) -> None:
        """End the connection, cleanly or with RST."""
        with self._news:
            if reset and self._client is not None:
                linger = struct.pack("ii", 1, 0)
                self._client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, linger)
            self._lost("dropped by the test")

    # --- the program ------------------------------------------------------------------------------

    def _run(self) -> None:
        at = time.monotonic()
        while not self._stop.is_set():
            sockets = [s for s in (self._listener, self._client) if s is not None]
            if self.tantrums.frozen:
                self._stop.wait(self._period_s)
                continue
            with suppress(OSError, ValueError):  # dropped by the test in the meantime
                select.select(sockets[-1:], [], [], self._period_s)
            with self._news:
                self._listen()
                self._receive()
                now = time.monotonic()
                if now - at >= self._period_s:
                    self._cycle(now, now - at)
                    at = now
                self._news.notify_all()

    def _cycle(self, now: float, dt_s: float) -> None:
        if not self.tantrums.stalled:
            self.robot.take()
            self.robot.correct(now)
        self.robot.move(dt_s)
        if self._armed and now - self._heard_at > self.robot.watchdog_s:
            self._lost("watchdog")
        self._report()

    def _listen(self) -> None:
        if self._client is not None or not select.select([self._listener], [], [], 0)[0]:
            return
        self._client, _ = self._listener.accept()
        self._client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._client.settimeout(2.0)
        self._reader, self._outbox = PacketReader(), b""
        self._said_hello = self._greeted = False
        self.connections += 1

    def _receive(self) -> None:
        if self._client is None or not select.select([self._client], [], [], 0)[0]:
            return
        try:
            data = self._client.recv(255)
            if not data:
                self._lost("closed by the gateway")
            for packet in self._reader.feed(data):
                self.received.append(Received(packet, time.monotonic_ns()))
                self._frame(packet)
        except (OSError, RemoteProtocolError) as error:
            self._lost(str(error))

    def _frame(self, packet: Packet) -> None:
        """Check, handle at once or put into the ring."""
        robot, com = self.robot, known(packet.com, packet.param)
        if (com == Com.HELLO) == self._said_hello or com not in COMMANDS:
            raise RemoteProtocolError(f"command {com} out of place")
        if self._said_hello and packet.id != next_id(self._framed_id):
            raise RemoteProtocolError(f"ID {packet.id} after {self._framed_id}")
        self._framed_id, self._heard_at = packet.id, time.monotonic()
        if com == Com.HELLO:
            self._hello(packet)
        elif com == Com.HOLD:
            self._hold()
        else:
            self._armed |= com not in SETTINGS
            if com == Com.WRENCH:
                robot.wrench = packet
            elif com == Com.FORCE_SET_POINT:
                robot.setpoint = packet
            elif com == Com.FEEDBACK and packet.param == FeedbackSwitch.STOP:
                robot.status &= ~FEEDBACK_BITS
                robot.setpoint = None
            elif com != Com.HEARTBEAT:
                robot.ring.append(packet)

    def _hello(self, packet: Packet) -> None:
        robot, tantrums = self.robot, self.tantrums
        robot.status &= ~Status.WATCHDOG_LATCHED
        robot.taken_id, robot.held_id, self._armed = packet.id, packet.id, False
        robot.set_up, robot.setpoint = set(), None
        robot.scales = tantrums.scales or packet.vec
        self._said_hello = True
        if tantrums.greet:
            self._greeted = True
            self._write(encode(Packet(packet.id, Com.HELLO, tantrums.greeting, robot.scales)))

    def _hold(self) -> None:
        """After a hold nothing moves, so the watchdog has nothing to watch."""
        self.robot.hold(self._framed_id)
        self._armed = False

    def _lost(self, reason: str) -> None:
        """The connection is over: hold, and latch if something was under way."""
        if self._armed:
            self.robot.status |= Status.WATCHDOG_LATCHED
        self._hold()
        self.errors.append(reason)
        self._drop()

    def _drop(self) -> None:
        if self._client is not None:
            self._client.close()
        self._client = None

    def _report(self) -> None:
        """The sender: one sample is 101 and 102 under one counter, now and then 103."""
        if not self._greeted or self._client is None:
            return
        robot, self._samples = self.robot, self._samples + 1
        param = pack_status(self._samples, robot.status)
        self._outbox += encode(Packet(robot.taken_id, Com.POSE, param, robot.pose_vec()))
        self._outbox += encode(Packet(self._framed_id, Com.JOINTS, param, robot.joint_vec()))
        if self._samples % self._health_every == 0:
            held = robot.held_id - ID_FIRST
            any_peer = int(self.tantrums.any_peer)
            vec = (self._samples % ID_FIRST, 0, len(robot.ring), 10_000, held, any_peer)
            self._outbox += encode(Packet(robot.taken_id, Com.HEALTH, 0, vec))
        if self._samples % self.tantrums.merge == 0:
            data, self._outbox = self._outbox, b""
            self._write(data)

    def _write(self, data: bytes) -> None:
        if self._client is None or self.tantrums.mute:
            return
        try:
            while data:
                size = self._random.randint(1, 60) if self.tantrums.chop else len(data)
                self._client.sendall(data[:size])
                data = data[size:]
        except OSError as error:
            self._lost(str(error))
