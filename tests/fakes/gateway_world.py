"""A gateway on the virtual clock, a controller with moods, and the judge of every packet."""

from dataclasses import dataclass, field
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
from forcemesh.codec import Header, encode
from forcemesh.faults import FAULTS
from forcemesh.messages import Permission, RobotCommand, Speed, WrenchAtTcp
from services.gateway.link import News
from services.gateway.service import Gateway
from tests.contract.rig import DEADLINE_S, gateway_cell
from tests.fuzz.permissive_arbiter import MOTIONS, PermissiveController, pose_of_vec

PAUSE_NS = 100_000_000
STEP_NS = 2_000_000
HOME_RAD = (0.0, 0.0, -np.pi / 2, 0.0, -np.pi / 2, 0.0)
SCALES = (50, 500, 250, 100, 1000, 10)
UNPERMITTED = {Com.HELLO, Com.HOLD, Com.LIMITS, Com.TCP}  # all that leaves without a permission
Lease = tuple[int, int]


def moves(packet: Packet) -> bool:
    """Tell whether a packet may set the arm in motion, or keep it so."""
    if packet.com == Com.FEEDBACK:
        return packet.param != FeedbackSwitch.STOP
    return packet.com in {*MOTIONS, Com.WRENCH}


class MoodyController(PermissiveController):
    """Obeys, until it hangs up, talks garbage, cuts its packets or loses a light."""

    def __init__(self) -> None:
        super().__init__(HOME_RAD)
        self.packets: list[Packet] = []
        self.on, self.off = Status(0), Status(0)  # lights that are wrong
        self.held_back = 0  # bytes that come with the next report
        self._judge_reader, self._lost, self._again_ns = PacketReader(), "", 0

    def poll(self, now_ns: int) -> News:
        """Live up to now."""
        lost, self._lost = self._lost, ""
        if lost or now_ns < self._again_ns:
            return News(lost=lost)
        news = super().poll(now_ns)
        end = len(news.data) - self.held_back
        self._outbox, self.held_back = news.data[max(end, 0) :], 0
        return News(news.opened, news.data[: max(end, 0)], "")

    def send(self, data: bytes, now_ns: int) -> bool:
        """Take packets; on a line that is down nobody hears them."""
        if not self._open:
            return False
        self.packets += self._judge_reader.feed(data)
        return super().send(data, now_ns)

    def close(self, reason: str, now_ns: int) -> None:
        """End the connection, from either side: the arm stops."""
        if self._open:
            self._lost = reason
        self.last_fault, self._again_ns = reason, now_ns + PAUSE_NS
        self._open, self._id, self._outbox, self.held_back = False, NO_ID, b"", 0
        self._reader, self._judge_reader = PacketReader(), PacketReader()
        self._target = self.T.copy()

    def say(self, data: bytes) -> None:
        """Put bytes between the reports."""
        self._outbox += data

    def _report(self) -> None:
        before, self._status = self._status, (self._status | self.on) & ~self.off
        super()._report()
        self._status = before


@dataclass
class PacketJudge:
    """Looks at each packet that leaves, and at what the gateway says of itself."""

    last_id: int
    obeyed: tuple[int, int] = (0, 0)  # epoch and seq of what was accepted last
    dead: set[Lease] = field(default_factory=set)
    live: Lease | None = None
    fresh: bool = True  # since hello or hold no set point has gone out

    def packet(self, packet: Packet, lease: Lease | None, stream: pin.SE3 | None) -> None:
        """Judge a packet that leaves under a lease, or under none.

        `stream` is where the arm was reported last while set points are commanded.
        """
        assert packet.id == next_id(self.last_id), "a gap in the IDs"
        self.last_id = packet.id
        if lease is None:
            assert packet.com in UNPERMITTED, f"command {packet.com} without a permission"
        if packet.com in {Com.HELLO, Com.HOLD}:
            self.fresh = True
        elif moves(packet):
            assert lease not in self.dead, "a lease that had ended moves the arm"
            if self.fresh and stream is not None:
                assert packet.com == Com.SET_POINT
                error = pose_of_vec(packet.vec, SCALES).actInv(stream)
                assert np.abs(error.homogeneous - np.eye(4)).max() < 1e-4, "the first one jumps"
            self.fresh = False

    def verdict(self, lease: Lease | None) -> None:
        """Remember which leases have ended."""
        if self.live is not None and lease != self.live:
            self.dead.add(self.live)
        assert lease not in self.dead
        self.live = lease


class GatewayWorld:
    """The gateway, everything around it, and what is always true of it."""

    def __init__(self, controller: MoodyController | None = None) -> None:
        """Connect."""
        self.cell = gateway_cell(49152)
        self.clock, self.transport = ManualClock(), MemoryTransport()
        self.controller = controller or MoodyController()
        bus = self._bus("robot")
        self.gateway = Gateway(bus, self.cell, self.controller)
        self.judge = PacketJudge(self.gateway._dialogue.last_id)
        self.lease, self.turn, self.seq, self.epoch = 0, 0, 0, 1
        self.kind = "hold"  # of what was said last
        self.wrench: WrenchAtTcp | None = WrenchAtTcp()
        self.codes: set[str] = set()  # why it held, or was not heard
        self.sent: list[bytes] = []  # commands, to be played again
        self.allowed: tuple[Lease, int] | None = None  # by the newest good command: until when
        topic = topics.ROBOT_COMMAND
        self._put = self.transport.publish(f"{self.cell.cell}/{topic.key}", topic.qos)
        self._put_wrench = self._bus("wrench").publisher(topics.WRENCH)
        self._states = self._bus("arbiter").reader(topics.ROBOT_STATE)
        self.live(30)

    def _bus(self, role: str) -> Bus:
        return Bus(role, self.cell.cell, self.transport, self.cell, self.clock, 7)

    @property
    def T(self) -> pin.SE3:
        """Where the arm is."""
        return self.controller.T

    # --- the arbiter ------------------------------------------------------------------------------

    def say(self, command: RobotCommand, *, late_s: float = 0.0, keep: bool = True) -> None:
        """Publish a command as the arbiter does, or so much too late."""
        self.seq += 1
        stamp_ns = self.clock.now_ns() - round(late_s * NS_PER_S)
        header = Header(
            seq=self.seq, epoch=self.epoch, boot=self.clock.boot,
            stamp_ns=stamp_ns, topic=f"{self.cell.cell}/{topics.ROBOT_COMMAND.key}",
        )  # fmt: skip
        data = encode(header, command)
        self._put(data)
        self.allowed, self.kind = None, command.kind
        permission = command.permission
        if permission is not None and (permission.lease, permission.ownership) == (
            self.lease,
            self.turn,
        ):
            self.allowed = (self.epoch, permission.lease), stamp_ns + round(DEADLINE_S * NS_PER_S)
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
        )
        speed = Speed(mechanical_m_s=0.05)
        return RobotCommand(
            kind=kind, commander="operator", speed=speed, permission=permission, **content
        )

    def put(self, data: bytes) -> None:
        """Put bytes on the key of commands."""
        self._put(data)

    # --- time -------------------------------------------------------------------------------------

    def live(self, steps: int = 1) -> None:
        """Let the gateway step; judge all that it sends and says."""
        for _ in range(steps):
            self.clock.advance_ns(STEP_NS)
            now_ns = self.clock.now_ns()
            if self.wrench is not None:
                self._put_wrench.put(self.wrench)
            self.gateway.step(now_ns)
            self._look(now_ns)

    def _look(self, now_ns: int) -> None:
        verdict, lease = self.gateway.verdict, None
        if verdict.command is None:
            assert verdict.hold_reason
            assert verdict.hold_code in FAULTS
        else:
            assert verdict.command.permission is not None
            assert verdict.accepted is not None
            lease = (verdict.accepted.epoch, verdict.command.permission.lease)
            assert self.allowed is not None, "nobody allows this"
            assert lease == self.allowed[0]
            assert now_ns <= self.allowed[1], "the permission is over"
        stopped = self.judge.live is not None and lease is None
        self._look_at_packets(lease, stopped=stopped)
        self.judge.verdict(lease)
        if verdict.accepted is not None:
            accepted = (verdict.accepted.epoch, verdict.accepted.seq)
            assert accepted >= self.judge.obeyed
            self.judge.obeyed = accepted
        self._look_at_state()

    def _look_at_packets(self, lease: Lease | None, *, stopped: bool) -> None:
        """Judge what was sent in this step.

        What is refused half-way left under the lease that was obeyed when the step began, or under
        one that began and ended in this very step.
        """
        packets, self.controller.packets = self.controller.packets, []
        under = lease or self.judge.live or self._allowed_lease()
        measured = self.gateway.measured
        streams = None if measured is None or self.kind != "setpoint" else measured.T_base_flange
        for packet in packets:
            self.judge.packet(packet, under, streams)
        half_way = lease is None and any(packet.com not in UNPERMITTED for packet in packets)
        if half_way and under is not None:
            self.judge.dead.add(under)
        if (stopped or half_way) and self.gateway._connection.is_ready:
            assert packets, "the arm is not braked"
            assert packets[-1].com == Com.HOLD

    def _allowed_lease(self) -> Lease | None:
        """Return the lease of the newest command, if it may be obeyed now."""
        if self.allowed is None or self.clock.now_ns() > self.allowed[1]:
            return None
        return None if self.allowed[0] in self.judge.dead else self.allowed[0]

    def _look_at_state(self) -> None:
        if self._states.poll():
            state = self._states.read(self.clock.now_ns()).message
            assert state is not None
            assert state.valid or state.hold_reason
            assert bool(state.hold_reason) == bool(state.hold_code)
            assert bool(state.hold_reason) == (self.gateway.verdict.command is None)
            assert state.code in FAULTS or state.valid
            self.codes |= {state.code, state.hold_code}

    def shifted(self, x_m: float, y_m: float, z_m: float) -> Any:
        """Return a pose beside the arm."""
        return record_of(pin.SE3(self.T.rotation, self.T.translation + np.array([x_m, y_m, z_m])))
