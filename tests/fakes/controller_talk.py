"""A client of the shipped program: packets over a wire in memory, all on the virtual clock."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin

from common.motion.frames import oat_from_R
from controller.packet import ZERO_VEC, Packet, PacketReader, VecInt, encode
from controller.packet_table import (
    ID_FIRST,
    ID_LAST,
    NO_ID,
    Bank,
    CentreParam,
    Com,
    Status,
    greeting,
    next_id,
    unpack_status,
)
from forcemesh.clock import NS_PER_S
from sim.controller.behaviour import Behaviour
from sim.controller.hardware import Robot
from sim.controller.machine import Machine
from sim.controller.network import LOOPBACK, MemoryNetwork, MemoryStream, Octets
from tests.fakes.controller import PORT, QUICK, TICK_NS, RunningController

TEXT = (Path(__file__).resolve().parents[2] / "controller" / "forcemesh.as").read_text("ascii")
SCALES: VecInt = (50, 500, 250, 100, 1000, 10)  # per mm, degree, degree of a joint, N, N m, mm/s
LIMITS: VecInt = (50, 1000, 500, 10_000, 5_000, 250)  # 1 mm, 2 deg, 50 mm/s, 200 mm, 50 N, 250 ms
ARM = 1  # fm.num of the shipped program
HELLO_PARAM = greeting(ARM)
# 175 deg since a hold, 100 N m, 20 mm and 10 deg from one set point to the next, 1000 mm/s.
MOTION: VecInt = (87_500, 100_000, 1_000, 5_000, 10_000, 0)
LOWER: VecInt = (-99_999, -99_999, -99_999, 0, 0, 0)  # no walls
UPPER: VecInt = (499_999, 499_999, 499_999, 0, 0, 0)
NO_TCP: VecInt = ZERO_VEC  # the flange itself
SEGMENT: VecInt = (30, 12, 0, 0, 0, 0)  # 30 ms, 1.2 mm/s
JOINT_SPEED: VecInt = (92_500, 77_500, 102_500, 137_500, 137_500, 250_000)  # 370 deg/s and so on
SET_UP = (
    (Bank.MOTION, MOTION),
    (Bank.LOWER_CORNER, LOWER),
    (Bank.UPPER_CORNER, UPPER),
    (Bank.SEGMENT, SEGMENT),
    (Bank.JOINT_SPEED, JOINT_SPEED),
)
BEAT_NS = 40_000_000
CHUNK = 65_536


def with_peer(a: int, b: int, c: int, d: int) -> str:
    """Return the program with the address of its PC in fm.config."""
    text = TEXT
    for k, octet in enumerate((a, b, c, d), start=1):
        assert text.count(f"fm.peer[{k}]=0") == 1
        text = text.replace(f"fm.peer[{k}]=0", f"fm.peer[{k}]={octet}")
    return text


class Talk:
    """A controller with `fm.main` started, and one client that may send it any bytes."""

    def __init__(
        self,
        behaviour: Behaviour = QUICK,
        *,
        prepare: Callable[[Machine], None] | None = None,
        text: str = "",
    ) -> None:
        """Start; `text` is the program, possibly with other settings."""
        self.network = MemoryNetwork()
        controller = RunningController(
            text or TEXT, behaviour=behaviour, network=self.network, prepare=prepare
        )
        self.machine, self.printed, self.value = (
            controller.machine, controller.printed, controller.value
        )  # fmt: skip
        self.pendant = self.machine.pendant
        self.stream = MemoryStream()
        self.closed, self.reading = True, True
        self.inbox: list[Packet] = []
        self.id = ID_LAST
        self._reader = PacketReader()
        self._sent_ns = 0

    # --- time -------------------------------------------------------------------------------------

    @property
    def now_s(self) -> float:
        """Virtual time since power-on."""
        return self.machine.now_ns / NS_PER_S

    def live(
        self, duration_s: float, *, beat: bool = False, until: Callable[[], object] | None = None
    ) -> bool:
        """Advance by a time, with optional heartbeats; return whether a condition came true."""
        end_ns = self.machine.now_ns + round(duration_s * NS_PER_S)
        while self.machine.now_ns < end_ns:
            if until is not None and until():
                return True
            self.machine.advance(min(self.machine.now_ns + TICK_NS, end_ns))
            self._receive()
            if beat and not self.closed and self.machine.now_ns - self._sent_ns >= BEAT_NS:
                self.send(Com.HEARTBEAT)
        return until is not None and bool(until())

    def wait(
        self, until: Callable[[], object], limit_s: float = 5.0, *, beat: bool = True
    ) -> float:
        """Advance until a condition is true; return the time that it took [s]."""
        start_s = self.now_s
        came = self.live(limit_s, beat=beat, until=until)
        assert came, f"not in {limit_s} s: status {self.status!r}, fault {self.fault}"
        return self.now_s - start_s

    # --- the wire ---------------------------------------------------------------------------------

    def dial(self, peer: Octets = LOOPBACK) -> None:
        """Connect as soon as the program listens."""
        self.wait(lambda: PORT in self.network.listeners, beat=False)
        self.stream = self.network.dial(PORT, peer)
        self.closed, self.inbox, self._reader = False, [], PacketReader()

    def write(self, data: bytes) -> None:
        """Put bytes on the wire; a closed connection discards them."""
        self._sent_ns = self.machine.now_ns
        try:
            assert self.stream.send(data) == len(data), "the wire is full"
        except OSError:
            self.closed = True

    def send(self, com: int, param: int = 0, vec: VecInt = ZERO_VEC) -> int:
        """Send a command with the next ID; return the ID."""
        self.id = next_id(self.id)
        self.write(encode(Packet(self.id, com, param, vec)))
        return self.id

    def hang_up(self) -> None:
        """Close the connection."""
        self.stream.close()
        self.closed = True

    def greet(
        self, *, id_: int = ID_FIRST, param: int = HELLO_PARAM, scales: VecInt = SCALES
    ) -> None:
        """Connect and send hello; wait for nothing."""
        self.dial()
        self.id = id_
        self.write(encode(Packet(id_, Com.HELLO, param, scales)))

    def hello(
        self,
        *,
        limits: VecInt | None = LIMITS,
        id_: int = ID_FIRST,
        scales: VecInt = SCALES,
        **banks: VecInt,
    ) -> None:
        """Connect, send hello, wait for the stream of reports, `set_up`."""
        self.greet(id_=id_, scales=scales)
        self.wait(lambda: self.received(Com.HEALTH), beat=False)
        if limits is not None:
            self.set_up(limits, **banks)

    def set_up(
        self,
        limits: VecInt = LIMITS,
        *,
        motion: VecInt = MOTION,
        lower: VecInt = LOWER,
        upper: VecInt = UPPER,
        tcp: VecInt = NO_TCP,
        segment: VecInt = SEGMENT,
    ) -> None:
        """Send each setting needed before a motion once; wait until all are executed."""
        for bank, vec in enumerate((limits, motion, lower, upper, segment, JOINT_SPEED)):
            self.send(Com.LIMITS, bank, vec)
        self.do(Com.TCP, CentreParam.TCP, tcp)

    def do(self, com: int, param: int = 0, vec: VecInt = ZERO_VEC, limit_s: float = 5.0) -> float:
        """Send a command of the robot program and wait until it is executed; return the time."""
        sent = self.send(com, param, vec)
        return self.wait(lambda: self.taken == sent, limit_s, beat=False)

    def _receive(self) -> None:
        if self.closed or not self.reading:
            return
        try:
            data = self.stream.receive(CHUNK)
        except OSError:
            data = b""
        if data == b"":
            self.closed = True
        elif data:
            self.inbox += self._reader.feed(data)

    # --- reports of the controller ----------------------------------------------------------------

    def received(self, com: Com) -> list[Packet]:
        """Return every report of a kind on this connection."""
        return [packet for packet in self.inbox if packet.com == com]

    def last(self, com: Com) -> Packet:
        """Return the newest report of a kind on this connection."""
        for packet in reversed(self.inbox):
            if packet.com == com:
                return packet
        return Packet(NO_ID, com)

    @property
    def status(self) -> Status:
        """Status bits of the newest sample."""
        return unpack_status(self.last(Com.POSE).param)[1]

    @property
    def fault(self) -> int:
        """Fault code of the newest 103."""
        return self.last(Com.HEALTH).param

    @property
    def taken(self) -> int:
        """ID of the last command that the robot program has executed."""
        return self.last(Com.POSE).id

    @property
    def framed(self) -> int:
        """ID of the last packet that the receiver found valid."""
        return self.last(Com.JOINTS).id

    # --- the arm and the program ------------------------------------------------------------------

    @property
    def robot(self) -> Robot:
        """The arm."""
        return self.machine.robot

    @property
    def T_mm(self) -> pin.SE3:
        """Flange pose with its position in mm."""
        T = self.robot.kinematics.flange_pose(self.robot.q)
        return pin.SE3(T.rotation, T.translation * 1e3)

    def height_mm(self) -> float:
        """Height of the flange."""
        return float(self.T_mm.translation[2])

    # --- sentences --------------------------------------------------------------------------------

    def pose_vec(self, T_mm: pin.SE3, scales: VecInt = SCALES) -> VecInt:
        """Return a pose with its position in mm as six numbers of a packet."""
        oat = np.degrees(oat_from_R(T_mm.rotation)) * scales[1]
        x, y, z, o, a, t = (round(float(v)) for v in (*(T_mm.translation * scales[0]), *oat))
        return (x, y, z, o, a, t)

    def shifted_vec(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> VecInt:
        """Return the present pose, shifted along the base axes by that many mm."""
        T = self.T_mm
        return self.pose_vec(pin.SE3(T.rotation, T.translation + np.array([x, y, z])))

    def move_up(self, z_mm: float, *, speed_mm_s: float = 50.0) -> int:
        """Send a speed and a straight motion up along z from the present pose; return its ID."""
        self.send(Com.SPEEDS, 0, (10_000, 10_000, 10_000, round(speed_mm_s * SCALES[5]), 0, 0))
        return self.send(Com.MOVE_POSE, 0, self.shifted_vec(z=z_mm))

    def start_feedback(
        self, mode: int, *, gains_p: VecInt = ZERO_VEC, gains_i: VecInt = ZERO_VEC
    ) -> None:
        """Send gains and start: 1 position, 2 orientation, 3 both; wait for the status."""
        self.send(Com.GAINS, 0, gains_p)
        self.send(Com.GAINS, 1, gains_i)
        for param in (0, 1):
            if mode >> param & 1:
                self.send(Com.FEEDBACK, param)
        self.wait(lambda: int(self.status) >> 5 & 3 == mode)


def moving(talk: Talk, z_mm: float = 60.0) -> Talk:
    """Return a client during a motion up."""
    talk.hello()
    z = talk.height_mm()
    talk.move_up(z_mm)
    talk.wait(lambda: talk.height_mm() > z + 5.0)
    return talk


def push(talk: Talk, times: int, vec: VecInt = ZERO_VEC) -> None:
    """Send the same wrench some times, every 20 ms."""
    for _ in range(times):
        talk.send(Com.WRENCH, 0, vec)
        talk.live(0.02)


def still(talk: Talk, duration_s: float = 1.0) -> bool:
    """Return whether the arm stays in its place, from 0.3 s on."""
    talk.live(0.3, beat=True)
    q = talk.robot.q
    talk.live(duration_s, beat=True)
    return bool(np.abs(talk.robot.q - q).max() < 2e-4)
