"""Gateway, hostile hop, the emulated controller with the shipped program, and the judge.

A test reads afterwards which packets the program accepted, which reports the gateway published,
whether either came from other bytes than the sender's, and when the arm was commanded to move.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import pinocchio as pin

from common.motion.convert import record_of
from controller.packet import PACKET_CHARS
from forcemesh.messages import Feedback, Gains, RobotState, WrenchAtTcp
from sim.controller.behaviour import Behaviour
from sim.controller.machine import Machine
from sim.controller.motion_queue import Ticket
from sim.controller.motion_requests import MotionRequest
from sim.controller.network import LOOPBACK, MemoryNetwork, MemoryStream, Octets
from sim.controller.tasks import Compiled, Op
from tests.contract.rig import pose_goal, shifted
from tests.contract.robots import GOOD, Both, Emulated
from tests.fakes.hostile_stream import Abuse, Hop, Lane

POSITION_PER_MM, JOINT_PER_DEG = 50, 250  # the scales of hello in this cell
STILL_RAD = 1e-9  # between two milliseconds of command
ARM_STILL_RAD = 2e-4  # how far an arm that holds may settle
GAINS = Gains(force_p_m_per_N=(1e-6,) * 3, force_i_m_per_Ns=(1e-3,) * 3)  # 10 N: 10 mm/s


class PieceStream(MemoryStream):
    """An end that is read piece by piece, as it was written: the least favourable network."""

    def receive(self, most: int) -> bytes | None:
        """Return the oldest piece that waits; see MemoryStream."""
        if not self._inbox or self.cut or self.closed:
            return super().receive(most)
        piece = self._inbox.popleft()
        if piece[most:]:
            self._inbox.appendleft(piece[most:])
        self._held -= len(piece[:most])
        return piece[:most]


class HostileNetwork(MemoryNetwork):
    """A network whose connections all go through a hop; `pump` lets bytes pass."""

    def __init__(self) -> None:
        """Start without an abuse."""
        super().__init__()
        self.hops: list[Hop] = []
        self.standing: dict[str, Callable[[], Abuse]] = {}  # for every new connection
        self._ends: list[tuple[Hop, PieceStream, PieceStream]] = []

    @property
    def hop(self) -> Hop:
        """The newest connection."""
        return self.hops[-1]

    def dial(self, port: int, peer: Octets = LOOPBACK) -> MemoryStream:
        """Connect through a hop. Raises OSError if no process listens."""
        listener = self.listeners.get(port)
        if listener is None:
            raise ConnectionRefusedError(f"no server listens on port {port}")
        near, ours, theirs, far = (PieceStream() for _ in range(4))
        near.partner, ours.partner, theirs.partner, far.partner = ours, near, far, theirs
        far.peer = peer
        listener.waiting.append(far)
        hop = Hop()
        for direction, make in self.standing.items():
            hop.lane(direction).abuse = make()
        self.hops.append(hop)
        self._ends.append((hop, ours, theirs))
        return near

    def strike(self, direction: str, abuse: Abuse) -> Abuse:
        """Apply an abuse to one direction of the newest connection from now on."""
        self.hop.lane(direction).abuse = abuse
        return abuse

    def intrude(self, port: int, data: bytes) -> MemoryStream:
        """Connect as another client, not through a hop, and send data."""
        stream = super().dial(port)
        stream.send(data)
        self.hops.insert(0, Hop(to_controller=Lane(sent=bytearray(data)), over=True))
        return stream

    def pump(self, now_ns: int) -> None:
        """Let bytes pass, except through a hop that has vanished."""
        for hop, ours, theirs in self._ends:
            if hop.vanished or hop.over:
                continue
            up_ended = _carry(ours, theirs, hop.to_controller, now_ns)
            down_ended = _carry(theirs, ours, hop.to_gateway, now_ns)
            if hop.cuts:
                ours.reset()
                theirs.reset()
            elif up_ended or down_ended:
                ours.close()
                theirs.close()
            hop.over = ours.closed


def _carry(source: PieceStream, sink: PieceStream, lane: Lane, now_ns: int) -> bool:
    """Move bytes from one end to the other; return whether the source has ended and all is sent."""
    ended = False
    try:
        while data := source.receive(65_536):
            lane.push(data)
        ended = data == b""
    except OSError:
        ended = True
    try:
        lane.stuck += lane.pull(now_ns)
        while lane.stuck:
            piece = lane.stuck.popleft()
            rest = piece[sink.send(piece) :]
            if rest:
                lane.stuck.appendleft(rest)
                break
    except OSError:
        return True
    return ended and not lane.waiting and not lane.stuck


@dataclass(frozen=True, slots=True)
class Accepted:
    """A packet that the program accepted."""

    connection: int
    chars: str


class HostileCell(Emulated):
    """The emulated robot of the contract with a hostile hop in its wire."""

    network: HostileNetwork

    def __init__(self, behaviour: Behaviour = GOOD) -> None:
        """Start everything at one virtual time."""
        super().__init__(behaviour, network=HostileNetwork())
        assert isinstance(self.rig.service, Both)
        self.gateway = self.rig.service.gateway
        self.accepted: list[Accepted] = []  # framed by the receiver
        self.taken: list[Accepted] = []  # by the robot program
        self.moments_ns: list[int] = []
        self.commands: list[np.ndarray] = []
        self.joints: list[np.ndarray] = []
        self.planned: list[pin.SE3] = []  # final flange pose of every accepted motion
        watch_program(self.machine, self.accepted, self.taken)
        watch_motions(self.machine, self.planned)
        self.machine.after_tick.append(self._tick)

    def _tick(self) -> None:
        robot = self.machine.robot
        self.moments_ns.append(self.machine.now_ns)
        self.commands.append(robot.queue.q_command.copy())
        self.joints.append(robot.q.copy())
        self.network.pump(self.machine.now_ns)

    @property
    def hops(self) -> list[Hop]:
        """Every connection that the gateway has opened so far."""
        return self.network.hops

    # --- what the arm does ------------------------------------------------------------------------

    def begin(self, motion: str) -> None:
        """Connect, arm, and advance into the middle of a motion."""
        self.rig.connect()
        self.rig.arm()
        start = self.rig.T
        if motion == "goal":
            self.rig.send("goal", goal=pose_goal(1, shifted(start, z_m=0.06)))
        elif motion == "feedback":
            self.rig.wrench = WrenchAtTcp(force_N=(0.0, 0.0, 10.0))
            feedback = Feedback(mode="position", gains=GAINS)
            self.rig.send("feedback", host="controller", feedback=feedback)
        else:
            self._stream(start)
        self.rig.until(lambda: self.moves)
        self.rig.advance(0.05)

    def _stream(self, start: Any) -> None:
        """Publish set points at 50 mm/s, a new one each millisecond."""
        arbitrate, z_m = self.rig._arbitrate, 0.0

        def renew(now_ns: int) -> None:
            nonlocal z_m
            if self.rig.command is not None and self.rig.command.kind == "setpoint":
                z_m = min(z_m + 5e-5, 0.06)
                self.rig.send("setpoint", pose=record_of(shifted(start, z_m=z_m)))
            arbitrate(now_ns)

        self.rig._arbitrate = renew  # type: ignore[method-assign]
        self.rig.send("setpoint", pose=record_of(start))

    @property
    def moves(self) -> bool:
        """Whether the arm is commanded to move at this time."""
        return bool(np.abs(self.commands[-1] - self.commands[-2]).max() > STILL_RAD)

    def stopped_ns(self, since_ns: int) -> int:
        """Return when the command moved last after a time; that time if it did not."""
        steps = np.abs(np.diff(np.array(self.commands), axis=0)).max(axis=1) > STILL_RAD
        moments = np.array(self.moments_ns)[1:]
        moved = moments[steps & (moments > since_ns)]
        return int(moved[-1]) if len(moved) else since_ns

    def assert_stays(self, duration_s: float) -> None:
        """Advance by a time in which neither command nor arm moves."""
        first = len(self.joints) - 1
        self.rig.advance(duration_s)
        assert np.abs(np.array(self.commands[first:]) - self.commands[first]).max() <= STILL_RAD
        away = np.abs(np.array(self.joints[first:]) - self.joints[first]).max()
        assert away <= ARM_STILL_RAD, np.degrees(away)

    def assert_obeys_after_arming(self) -> None:
        """Assert that the link is up again: after arming, a goal is done."""
        rig, goal_id = self.rig, 100 + len(self.hops)
        rig.connect()
        rig.arm()
        rig.send("goal", goal=pose_goal(goal_id, shifted(rig.T, z_m=0.005)))
        rig.until(lambda: rig.state.goal.id == goal_id and rig.state.goal.state == "done")

    # --- packets and reports ----------------------------------------------------------------------

    def assert_nothing_misread(self) -> None:
        """Assert that each side accepted only the bytes of the other side, whole and in order."""
        by_connection: dict[int, list[str]] = {}
        for packet in self.accepted:
            by_connection.setdefault(packet.connection, []).append(packet.chars)
        for chars in by_connection.values():
            stream = "".join(chars).encode("latin-1")
            assert any(hop.to_controller.sent.startswith(stream) for hop in self.hops), chars[-1]
        # RUN after HOLD may end the execution of a packet when the next connection is already open.
        rest = iter([packet.chars for packet in self.accepted])
        assert all(p.chars in rest for p in self.taken), "taken, but not accepted in this order"
        samples = [s for hop in self.hops for s in samples_of(bytes(hop.to_gateway.sent))]
        left = iter(samples)
        for state in self.rig.states:
            if state.valid:
                assert any(_is_sample(state, sample) for sample in left), state


def samples_of(sent: bytes) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return flange positions [m] and joints [rad] of each 101 that its 102 follows."""
    numbers = [
        [int(frame) for frame in sent[at : at + PACKET_CHARS].split()]
        for at in range(0, len(sent) - PACKET_CHARS + 1, PACKET_CHARS)
    ]
    samples = []
    for pose, joints in pairwise(numbers):
        if (pose[1], joints[1]) == (101, 102) and pose[2] == joints[2]:
            position_m = np.array(pose[3:6]) / POSITION_PER_MM * 1e-3
            samples.append((position_m, np.radians(np.array(joints[3:]) / JOINT_PER_DEG)))
    return samples


def _is_sample(state: RobotState, sample: tuple[np.ndarray, np.ndarray]) -> bool:
    return np.allclose(state.position_m, sample[0], rtol=0.0, atol=1e-9) and np.allclose(
        state.joint_rad, sample[1], rtol=0.0, atol=1e-9
    )


def watch_motions(machine: Machine, planned: list[pin.SE3]) -> None:
    """Record the end of every motion that the robot program commands, executed or not."""
    queue = machine.robot.queue
    offer = queue.offer

    def remember(motion: MotionRequest, *, arrived: bool) -> Ticket:
        if motion.T_base_tcp is not None:
            planned.append(motion.T_base_tcp)
        elif motion.q is not None:
            planned.append(machine.robot.pose_of(motion.q))
        return offer(motion, arrived=arrived)

    queue.offer = remember  # type: ignore[method-assign]


def watch_program(machine: Machine, accepted: list[Accepted], taken: list[Accepted]) -> None:
    """Record each packet at the step of the program that accepts it; nothing else changes."""
    for program, begins, into in (
        ("fm.recv", "fm.framed=500000+", accepted),
        ("fm.hello", "fm.link=1", accepted),
        ("fm.take", "fm.taken=.id", taken),
    ):
        compiled = machine.control.programs[program]
        ops = list(compiled.ops)
        hits = [n for n, step in enumerate(compiled.steps) if step.text.strip().startswith(begins)]
        assert hits, f"{program} has no step {begins}"
        for n in hits:
            ops[n] = _noted(ops[n], machine, into)
        machine.control.programs = {
            **machine.control.programs, program: Compiled(compiled.program, tuple(ops))
        }  # fmt: skip


def _noted(op: Op, machine: Machine, into: list[Accepted]) -> Callable[[Any], int]:
    def run(task: Any) -> int:
        connection = machine.memory.read("fm.conn")
        assert isinstance(connection, int | float)
        into.append(Accepted(int(connection), str(task.locals["$q"].value)))
        return op(task)

    return run
