"""A fake robot controller: the other end of the packet protocol, with injectable faults.

Used as a context manager it runs in a thread, in real time, on a real TCP socket; on a network in
memory the test that steps the gateway steps it too, on a clock of its own. It reads and writes with
`controller.packet` alone. Like the real program it streams 101 and 102 (one counter for both of a
sample) and 103, executes ring commands one by one, and has a watchdog that latches. The watchdog is
active from the first packet after hello or hold that is more than a setting: then a motion is
possible, and silence is a fault.
"""

import random
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import pinocchio as pin

from controller.packet import Packet, PacketReader, VecInt, encode
from controller.packet_table import (
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
from forcemesh.clock import NS_PER_S
from forcemesh.errors import RemoteProtocolError
from sim.controller.network import MemoryNetwork, MemoryStream, SocketNetwork, SocketStream
from tests.fakes.robot_program import RobotProgram

PORT = 49152
CYCLE_S = 0.001  # in real time, at its socket
SETTINGS = {Com.SPEEDS, Com.GAINS, Com.LIMITS, Com.TCP}


@dataclass(frozen=True, slots=True)
class Received:
    """A packet and its time of receipt."""

    packet: Packet
    at_ns: int


@dataclass(slots=True)
class Tantrums:
    """Injectable faults of the wire; all may be changed while the controller runs."""

    chop: bool = False  # write in pieces of 1 to 60 bytes
    merge: int = 1  # samples that are written at once
    frozen: bool = False  # neither read nor write
    mute: bool = False  # read, but write nothing
    stalled: bool = False  # the robot program reads nothing from the ring
    greeting: int = greeting(1)  # Param of its hello
    any_peer: bool = True
    scales: VecInt | None = None  # set others than commanded
    greet: bool = True  # reply to hello


class FakeController:
    """Listens on `port` of a network in memory, or of this machine until the context ends."""

    def __init__(
        self,
        network: MemoryNetwork | None = None,
        *,
        rate_hz: float = 100.0,
        health_hz: float = 10.0,
        lag_s: float = 0.02,
    ):
        self.tantrums = Tantrums()
        self.robot = RobotProgram(lag_s=lag_s)
        self.received: list[Received] = []
        self.connections = 0
        self.errors: list[str] = []
        self._period_s, self._health_every = 1.0 / rate_hz, max(1, round(rate_hz / health_hz))
        self._random = random.Random(1)
        sockets = SocketNetwork(port=0)
        self._listener = (network or sockets).listen(PORT)
        self.port = sockets.bound.get(PORT, PORT)
        self._client: MemoryStream | SocketStream | None = None
        self._reader = PacketReader()
        self._hello_received = self._greeted = self._armed = False
        self._framed_id = NO_ID
        self._outbox, self._rest = b"", b""  # not written yet, not accepted by the network yet
        self._now_s, self._cycled_s, self._received_s = 0.0, 0.0, 0.0
        self._samples = 0
        self._stop = threading.Event()
        self._new_data = threading.Condition(threading.RLock())  # guards everything above
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
        """The pose of the flange."""
        with self._new_data:
            return self.robot.arm.pose(self.robot.joint_rad)

    def of(self, *coms: Com) -> list[Packet]:
        """Return the received packets of these commands."""
        with self._new_data:
            return [r.packet for r in self.received if r.packet.com in coms]

    def wait_for(self, condition: Callable[[], bool], timeout_s: float = 5.0) -> bool:
        """Wait until a condition is true; it is checked after each cycle of the controller."""
        with self._new_data:
            return self._new_data.wait_for(condition, timeout_s)

    def write(self, data: bytes) -> None:
        """Put any bytes into the stream."""
        with self._new_data:
            self._write(data)

    def drop(self, *, reset: bool = False) -> None:
        """End the connection, cleanly or with RST."""
        with self._new_data:
            if reset and self._client is not None:
                self._client.reset()
            self._lost("dropped by the test")

    # --- the program ------------------------------------------------------------------------------

    def _run(self) -> None:
        while not self._stop.wait(CYCLE_S):
            self.live(time.monotonic())

    def live(self, now_s: float) -> None:
        """Poll the network, and run a cycle of the robot program when it is due."""
        if self.tantrums.frozen:
            return
        with self._new_data:
            self._now_s = now_s
            self._listen()
            self._receive()
            since_s = now_s - self._cycled_s
            if since_s >= self._period_s - 1e-9:
                self._cycled_s = now_s
                self._cycle(min(since_s, 1.0))
            self._flush()
            self._new_data.notify_all()

    def _cycle(self, dt_s: float) -> None:
        if not self.tantrums.stalled:
            self.robot.take()
            self.robot.correct(self._now_s)
        self.robot.move(dt_s)
        if self._armed and self._now_s - self._received_s > self.robot.watchdog_s:
            self._lost("watchdog")
        self._report()

    def _listen(self) -> None:
        if self._client is not None:
            return
        stream = self._listener.accept()
        if stream is None:
            return
        assert isinstance(stream, MemoryStream | SocketStream)
        self._client = stream
        self._reader, self._outbox, self._rest = PacketReader(), b"", b""
        self._hello_received = self._greeted = False
        self.connections += 1

    def _receive(self) -> None:
        if self._client is None:
            return
        try:
            data = self._client.receive(255)
            if data == b"":
                self._lost("closed by the gateway")
            for packet in self._reader.feed(data or b""):
                self.received.append(Received(packet, round(self._now_s * NS_PER_S)))
                self._frame(packet)
        except (OSError, RemoteProtocolError) as error:
            self._lost(str(error))

    def _frame(self, packet: Packet) -> None:
        """Check a packet, execute it at once or put it into the ring."""
        robot, com = self.robot, known(packet.com, packet.param)
        if (com == Com.HELLO) == self._hello_received or com not in COMMANDS:
            raise RemoteProtocolError(f"command {com} out of place")
        if self._hello_received and packet.id != next_id(self._framed_id):
            raise RemoteProtocolError(f"ID {packet.id} after {self._framed_id}")
        self._framed_id, self._received_s = packet.id, self._now_s
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
        self._hello_received = True
        if tantrums.greet:
            self._greeted = True
            self._write(encode(Packet(packet.id, Com.HELLO, tantrums.greeting, robot.scales)))

    def _hold(self) -> None:
        """After a hold nothing moves, so the watchdog is off."""
        self.robot.hold(self._framed_id)
        self._armed = False

    def _lost(self, reason: str) -> None:
        """The connection is lost: hold, and latch if a motion was in progress."""
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
        """Send one sample: 101 and 102 under one counter, now and then 103."""
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
        if self._client is not None and not self.tantrums.mute:
            self._rest += data
            self._flush()

    def _flush(self) -> None:
        """Write what the network accepts; the rest goes with the next call."""
        try:
            while self._client is not None and self._rest:
                size = self._random.randint(1, 60) if self.tantrums.chop else len(self._rest)
                taken = self._client.send(self._rest[:size])
                self._rest = self._rest[taken:]
                if taken == 0:
                    break
        except OSError as error:
            self._lost(str(error))
