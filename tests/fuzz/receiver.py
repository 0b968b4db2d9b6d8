"""Fuzz target `receiver`: the shipped AS program frames exactly the valid prefix of any bytes.

There is no uncommanded motion. The emulated controller keeps running between inputs; each input is
a new connection. It runs at 1 % monitor speed, so fuzzed motions are negligible.
"""

from contextlib import suppress
from pathlib import Path

import numpy as np

from controller.packet import PACKET_CHARS, Packet, PacketReader, encode
from controller.packet_table import ID_FIRST, REPORTS, TABLE, Com, next_id
from sim.as_language.parser import load
from sim.controller.behaviour import Behaviour
from sim.controller.machine import Machine
from sim.controller.network import MemoryNetwork, MemoryStream
from sim.robot.arm import SimArm
from sim.robot.settings import SimSettings
from tests.fuzz import streams
from tests.fuzz.framer import Framed, frame

PROGRAM = Path(__file__).resolve().parents[2] / "controller" / "forcemesh.as"
PORT = 49152
MAX_BYTES = 1 + 30 * PACKET_CHARS  # less than the capacity of the ring buffer
TICK_NS = 1_000_000
SETTLE_MS = 8000
BEATS, BEAT_MS = 20, 20  # covers the brake of a hello, after which a motion begins
# A linear path between two reachable poses may be unreachable in between: AS then stops.
TOLERATED = {"E6007", "E6008", "E6016"}
mutate = streams.mutate


class Controller:
    """Emulated controller with the shipped program, and consecutive clients."""

    def __init__(self) -> None:
        """Power on, start, and wait until the program listens."""
        self.network = MemoryNetwork()
        arm = SimArm(SimSettings(gap_m=0.1, delay_s=0.0), seed=0)
        self.machine = Machine(arm, self.network, behaviour=Behaviour(step_s=2e-5))
        self.machine.load(load(PROGRAM))
        self.machine.pendant.monitor_speed(1.0)
        self.machine.pendant.execute("fm.main")
        self.stream: MemoryStream | None = None
        self.received = PacketReader()
        self.settle()

    def real(self, name: str) -> float:
        """Return a real variable of the program."""
        value = self.machine.memory.read(name)
        assert isinstance(value, float)
        return value

    def element(self, name: str, *index: int) -> object:
        """Return an array element of the program."""
        return self.machine.memory.read(f"{name}[{','.join(map(str, index))}]")

    def pass_ms(self, most: int = 1) -> None:
        """Advance time, and read the program's output: whole packets of known reports."""
        for _ in range(most):
            self.machine.advance(self.machine.now_ns + TICK_NS)
            self.listen()

    def listen(self) -> None:
        """Read the output; anything but a report is a fault of the program."""
        try:
            data = self.stream.receive(16_384) if self.stream is not None else None
        except ConnectionResetError:
            data = None
        for packet in self.received.feed(data or b""):
            assert packet.com in REPORTS, packet
            assert packet.param in TABLE[Com(packet.com)].params, packet

    def dial(self) -> MemoryStream:
        """Connect."""
        self.stream, self.received = self.network.dial(PORT), PacketReader()
        return self.stream

    def settle(self) -> None:
        """Wait until the program listens, its ring buffer is empty, and the arm is at rest."""
        for _ in range(SETTLE_MS):
            self.pass_ms()
            if PORT in self.network.listeners and self._quiet():
                return
        raise AssertionError("the program does not come to rest")

    def _quiet(self) -> bool:
        idle = self.real("fm.sock") == 0 and self.real("fm.rt") == self.real("fm.rh")
        return idle and not self.machine.robot.queue.busy


_running: list[Controller] = []


def controller() -> Controller:
    """Return the running controller, or start one."""
    if not _running:
        _running.append(Controller())
    return _running[0]


def check(data: bytes) -> None:
    """Feed one connection, compare with the reference, and wait for the idle state."""
    expected = frame(data[1:])
    device = controller()
    try:
        _converse(device, data, expected)
    except BaseException:
        _running.clear()  # the next input starts a new controller
        raise
    if device.machine.stops:
        _running.clear()


def _converse(device: Controller, data: bytes, expected: Framed) -> None:
    before = {
        name: device.real(f"fm.{name}") for name in ("rh", "wn", "zn", "stopn", "conn", "lat")
    }
    q = device.machine.robot.queue.q_command.copy()
    stream = device.dial()
    device.pass_ms()
    for chunk in streams.chunks(data):
        try:
            stream.send(chunk)
        except ConnectionResetError:
            break
        device.pass_ms()
    _wait_for(device, expected)
    if device.real("fm.lat") == before["lat"] and not device.machine.stops:
        _compare(device, expected, before)
    if expected.may_move and not expected.closed and len(data) % PACKET_CHARS == 1:
        _linger(device, stream, expected.last_id)
    stream.close()
    if device.machine.stops:
        codes = {stop.error.code for stop in device.machine.stops}
        assert expected.may_move, device.machine.stops[0]
        assert codes <= TOLERATED, device.machine.stops[0]
        return
    device.settle()
    if not expected.may_move:
        assert np.array_equal(device.machine.robot.queue.q_command, q), "the arm moved"


def _linger(device: Controller, stream: MemoryStream, id_: int) -> None:
    """Keep the connection alive until the commanded motion has begun."""
    for _ in range(BEATS):
        id_ = next_id(id_)
        with suppress(ConnectionResetError):
            stream.send(encode(Packet(id_, Com.HEARTBEAT)))
        device.pass_ms(BEAT_MS)


def _wait_for(device: Controller, expected: Framed) -> None:
    """Wait until the program has read all, and longer to detect that it accepts too much."""
    for _ in range(200):
        if (device.real("fm.sock") == 0) == expected.closed and (
            not expected.last_id or device.real("fm.framed") == expected.last_id
        ):
            break
        device.pass_ms()
    device.pass_ms(4)


def _compare(device: Controller, expected: Framed, before: dict[str, float]) -> None:
    """Compare the state of the program with the reference."""
    assert device.real("fm.conn") == before["conn"] + 1
    if expected.last_id:
        assert device.real("fm.framed") == expected.last_id
    assert (device.real("fm.sock") == 0) == expected.closed
    assert (device.real("fm.wn") - before["wn"]) % 1_000_000 == expected.count(Com.WRENCH)
    aimed = expected.count(Com.FORCE_SET_POINT)
    assert (device.real("fm.zn") - before["zn"]) % 1_000_000 == aimed
    assert device.real("fm.stopn") - before["stopn"] == expected.count(Com.FEEDBACK, 2)
    slots = int(device.real("fm.rh") - before["rh"]) % 64
    ring = [device.element("$fm.ring", int(before["rh"] + k) % 64) for k in range(slots)]
    assert ring == [packet.decode("ascii") for packet in expected.queued]
    if expected.answered:
        assert device.real("fm.hid") == expected.hold_id - ID_FIRST
    if expected.wrench is not None:
        bank = int(device.real("fm.wb"))
        held = tuple(device.element("fm.w", bank, k) for k in range(1, 7))
        assert held == expected.wrench
