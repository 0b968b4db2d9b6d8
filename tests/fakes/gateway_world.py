"""A gateway on the virtual clock, a controller with faults, and the judge of every packet."""

from typing import Any

import numpy as np
import pinocchio as pin

from common.bus.memory_bus import MemoryTransport
from common.motion.convert import record_of
from controller.packet import Packet, PacketReader
from controller.packet_table import NO_ID, Com, FeedbackSwitch, Status, next_id
from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.clock import NS_PER_S, ManualClock
from forcemesh.codec import Header
from forcemesh.faults import FAULTS
from forcemesh.messages import Permission, RobotCommand, RobotState, Speed, WrenchAtTcp
from services.gateway.link import LinkEvents
from services.gateway.service import Gateway
from tests.contract.rig import DEADLINE_S, gateway_cell
from tests.fakes.dialogues import last_id
from tests.fakes.records import encode_unchecked
from tests.fuzz.permissive_arbiter import MOTIONS, PermissiveController, pose_of_vec

PAUSE_NS = 100_000_000
STEP_NS = 2_000_000
HOME_RAD = (0.0, 0.0, -np.pi / 2, 0.0, -np.pi / 2, 0.0)
SCALES = (50, 500, 250, 100, 1000, 10)
UNPERMITTED = {Com.HELLO, Com.HOLD, Com.LIMITS, Com.TCP}  # all packets that need no permission
Lease = tuple[int, int]


def moves(packet: Packet) -> bool:
    """Return whether a packet may start or continue a motion."""
    if packet.com == Com.FEEDBACK:
        return packet.param != FeedbackSwitch.STOP
    return packet.com in {*MOTIONS, Com.WRENCH}


class FaultyController(PermissiveController):
    """Executes commands; a test makes it close, send garbage, cut packets or drop a status bit."""

    def __init__(self) -> None:
        super().__init__(HOME_RAD)
        self.packets: list[Packet] = []  # since the judge has taken them
        self.notes: list[tuple[Com, int]] = []  # Com and Param, without heartbeats and wrenches
        self.wrenches: list[Packet] = []
        self.on, self.off = Status(0), Status(0)  # wrong status bits
        self.held_back = 0  # bytes that follow the next report
        self.pause_ns = PAUSE_NS  # from the end of a connection to the next one
        self._judge_reader, self._lost, self._again_ns = PacketReader(), "", 0

    def poll(self, now_ns: int) -> LinkEvents:
        """Advance to the present time."""
        lost, self._lost = self._lost, ""
        if lost or now_ns < self._again_ns:
            return LinkEvents(lost=lost)
        events = super().poll(now_ns)
        end = len(events.data) - self.held_back
        self._outbox, self.held_back = events.data[max(end, 0) :], 0
        return LinkEvents(events.opened, events.data[: max(end, 0)], "")

    def send(self, data: bytes, now_ns: int) -> bool:
        """Accept packets; on a line that is down they are lost."""
        if not self._open:
            return False
        for packet in self._judge_reader.feed(data):
            self.packets.append(packet)
            if packet.com == Com.WRENCH:
                self.wrenches.append(packet)
            elif packet.com != Com.HEARTBEAT:
                self.notes.append((Com(packet.com), packet.param))
        return super().send(data, now_ns)

    def close(self, reason: str, now_ns: int) -> None:
        """Close the connection from either side: the arm stops."""
        if self._open:
            self._lost = reason
        self.last_fault, self._again_ns = reason, now_ns + self.pause_ns
        self._open, self._id, self._outbox, self.held_back = False, NO_ID, b"", 0
        self._reader, self._judge_reader = PacketReader(), PacketReader()
        self._target = self.T.copy()

    def insert(self, data: bytes) -> None:
        """Put bytes between the reports."""
        self._outbox += data

    def _report(self) -> None:
        before, self._status = self._status, (self._status | self.on) & ~self.off
        super()._report()
        self._status = before


class GatewayWorld:
    """The gateway, its surroundings, and the invariants of every packet and report."""

    def __init__(self, controller: FaultyController | None = None, *, epoch: int = 7) -> None:
        """Connect; `epoch` is that of the gateway's process."""
        self.cell = gateway_cell(49152)
        self.clock, self.transport = ManualClock(), MemoryTransport()
        self.controller = controller or FaultyController()
        self.gateway = Gateway(self._bus("robot", epoch), self.cell, self.controller)
        self._last_id = last_id(self.gateway.driver.dialogue)
        self._obeyed = (0, 0)  # epoch and seq of the last accepted command
        self._dead: set[Lease] = set()
        self._live: Lease | None = None
        self._is_fresh = True  # since hello or hold no set point has been sent
        self.turn, self.seq, self.epoch = 0, 0, 1
        self.lease = 0
        self.kind = "hold"  # of the last command
        self.wrench: WrenchAtTcp | None = WrenchAtTcp()
        self.states: list[RobotState] = []
        self.codes: set[str] = set()  # reason of the hold, or of the rejection
        self.sent: list[bytes] = []  # commands for a later replay
        self.allowed: tuple[Lease, int] | None = None  # expiry by the newest valid command
        topic = topics.ROBOT_COMMAND
        self.put = self.transport.publish(f"{self.cell.cell}/{topic.key}", topic.qos)
        self._put_wrench = self._bus("wrench").publisher(topics.WRENCH)
        self._states = self._bus("arbiter").reader(topics.ROBOT_STATE)
        self.live(30)

    def _bus(self, role: str, epoch: int = 7) -> Bus:
        return Bus(role, self.cell.cell, self.transport, self.cell, self.clock, epoch)

    @property
    def lease(self) -> int:
        """Number of the present lease."""
        return self._lease

    @lease.setter
    def lease(self, number: int) -> None:
        """Begin a lease with the challenge that the gateway publishes."""
        self._lease, self.challenge = number, self.gateway._gate.challenge

    # --- the arbiter ------------------------------------------------------------------------------

    def send(self, command: RobotCommand, *, late_s: float = 0.0, keep: bool = True) -> None:
        """Publish a command as the arbiter does, with an optional delay."""
        self.seq += 1
        stamp_ns = self.clock.now_ns() - round(late_s * NS_PER_S)
        header = Header(
            seq=self.seq, epoch=self.epoch, boot=self.clock.boot,
            stamp_ns=stamp_ns, topic=f"{self.cell.cell}/{topics.ROBOT_COMMAND.key}",
        )  # fmt: skip
        data = encode_unchecked(header, command)
        self.put(data)
        self.allowed, self.kind = None, command.kind
        granted, now = command.permission, (self.lease, self.turn)
        if granted is not None and (granted.lease, granted.ownership) == now:
            self.allowed = (self.epoch, granted.lease), stamp_ns + round(DEADLINE_S * NS_PER_S)
        if keep:
            self.sent.append(data)

    def permitted(
        self, kind: Any, *, lease: int = 0, turn: int = 0, **content: Any
    ) -> RobotCommand:
        """Return a command under the present permission, or under an older one."""
        permission = Permission(
            host="controller" if kind == "feedback" else "pc",
            lease=self.lease + lease,
            ownership=self.turn + turn,
            deadline_s=DEADLINE_S,
            challenge=self.challenge,
        )
        speed = Speed(mechanical_m_s=0.05)
        return RobotCommand(
            kind=kind, commander="operator", speed=speed, permission=permission, **content
        )

    def shifted(self, x_m: float, y_m: float, z_m: float) -> Any:
        """Return a pose shifted from the arm."""
        T = self.controller.T
        return record_of(pin.SE3(T.rotation, T.translation + np.array([x_m, y_m, z_m])))

    # --- time -------------------------------------------------------------------------------------

    def live(self, steps: int = 1) -> None:
        """Step the gateway; judge all its packets and reports."""
        for _ in range(steps):
            self.clock.advance_ns(STEP_NS)
            now_ns = self.clock.now_ns()
            if self.wrench is not None:
                self._put_wrench.put(self.wrench)
            self.gateway.step(now_ns)
            self._judge_all(now_ns)

    def _judge_all(self, now_ns: int) -> None:
        verdict, lease = self.gateway.verdict, None
        if verdict.command is None:
            assert verdict.hold_reason
            assert verdict.hold_code in FAULTS
        else:
            assert verdict.command.permission is not None
            assert verdict.accepted is not None
            lease = (verdict.accepted.epoch, verdict.command.permission.lease)
            assert self.allowed is not None, "no command permits this"
            assert lease == self.allowed[0]
            assert now_ns <= self.allowed[1], "the permission has expired"
        stopped = self._live is not None and lease is None
        self._judge_packets(lease, stopped=stopped)
        if self._live is not None and lease != self._live:
            self._dead.add(self._live)
        assert lease not in self._dead
        self._live = lease
        if verdict.accepted is not None:
            accepted = (verdict.accepted.epoch, verdict.accepted.seq)
            assert accepted >= self._obeyed
            self._obeyed = accepted
        self._judge_state()

    def _judge_packets(self, lease: Lease | None, *, stopped: bool) -> None:
        """Judge the packets of this step.

        A packet that is refused during the step was sent under the lease at its start, or under one
        that began and ended in the same step.
        """
        packets, self.controller.packets = self.controller.packets, []
        under = lease or self._live or self._allowed_lease()
        measured = self.gateway.driver.measured
        streams = None if measured is None or self.kind != "setpoint" else measured.T_base_flange
        for packet in packets:
            self._judge_packet(packet, under, streams)
        is_refused = lease is None and any(packet.com not in UNPERMITTED for packet in packets)
        if is_refused and under is not None:
            self._dead.add(under)
        if (stopped or is_refused) and self.gateway.driver.dialogue.ready:
            assert packets, "the arm is not braked"
            assert packets[-1].com == Com.HOLD

    def _judge_packet(self, packet: Packet, lease: Lease | None, stream: pin.SE3 | None) -> None:
        """Judge a packet; `stream` is the last reported pose while set points are commanded."""
        assert packet.id == next_id(self._last_id), "a gap in the IDs"
        self._last_id = packet.id
        if lease is None:
            assert packet.com in UNPERMITTED, f"command {packet.com} without a permission"
        if packet.com in {Com.HELLO, Com.HOLD}:
            self._is_fresh = True
        elif moves(packet):
            assert lease not in self._dead, "a lease that had ended moves the arm"
            if self._is_fresh and stream is not None:
                assert packet.com == Com.SET_POINT
                error = pose_of_vec(packet.vec, SCALES).actInv(stream)
                assert np.abs(error.homogeneous - np.eye(4)).max() < 1e-4, "the first one jumps"
            self._is_fresh = False

    def _allowed_lease(self) -> Lease | None:
        """Return the lease of the newest command, if it may be executed now."""
        if self.allowed is None or self.clock.now_ns() > self.allowed[1]:
            return None
        return None if self.allowed[0] in self._dead else self.allowed[0]

    def _judge_state(self) -> None:
        if self._states.poll():
            state = self._states.read(self.clock.now_ns()).message
            assert state is not None
            assert state.valid or state.hold_reason
            assert bool(state.hold_reason) == bool(state.hold_code)
            assert bool(state.hold_reason) == (self.gateway.verdict.command is None)
            assert state.code in FAULTS or state.valid
            self.codes |= {state.code, state.hold_code}
            self.states.append(state)
