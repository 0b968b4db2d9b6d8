"""Gateway, hostile hop, the emulated controller with the shipped program, and the judge.

A test reads afterwards which packets the program accepted, which reports the gateway published,
whether either came from other bytes than the sender's, and when the arm was commanded to move.
"""

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import pinocchio as pin

from common.config.cell import CellConfig
from common.motion.convert import record_of
from common.runtime.service import Runner, Service
from controller.packet import PACKET_CHARS
from forcemesh.bus import Bus
from forcemesh.clock import ManualClock, MonotonicClock
from forcemesh.messages import Feedback, Gains, RobotState, WrenchAtTcp
from services.gateway.link import LinkEvents
from services.gateway.service import Gateway
from sim.as_language.parser import load
from sim.controller.behaviour import Behaviour
from sim.controller.machine import Machine
from sim.controller.motion_queue import Ticket
from sim.controller.motion_requests import MotionRequest
from sim.controller.network import LockStepLink, Network, SocketNetwork
from sim.controller.service import ControllerSensor
from sim.controller.tasks import Compiled, Op
from tests.contract.rig import Rig, gateway_cell, pose_goal, shifted
from tests.contract.robots import PROGRAM, Both
from tests.fakes.controller import PORT
from tests.fakes.hostile_proxy import HostileProxy
from tests.fakes.hostile_stream import Hop
from tests.fakes.hostile_wire import HostileNetwork

WATCHDOG_S = 0.25
POSITION_PER_MM, JOINT_PER_DEG = 50, 250  # the scales of hello in this cell
STILL_RAD = 1e-9  # between two milliseconds of command
ARM_STILL_RAD = 2e-4  # how far an arm that holds may settle
LONGEST_RENEWAL_NS = 10_000_000  # longer ones are stalls of the machine, half a millimetre each
QUICK = Behaviour(step_s=1e-4)
GAINS = Gains(force_p_m_per_N=(1e-6,) * 3, force_i_m_per_Ns=(1e-3,) * 3)  # 10 N: 10 mm/s


@dataclass(frozen=True, slots=True)
class Accepted:
    """A packet that the program accepted."""

    connection: int
    chars: str


class HostileCell:
    """A rig whose robot is gateway, hop and controller; a wire in memory by default."""

    def __init__(self, behaviour: Behaviour = QUICK, **overrides: object) -> None:
        """Start everything at one virtual time."""
        self._behaviour = behaviour
        self.accepted: list[Accepted] = []  # framed by the receiver
        self.taken: list[Accepted] = []  # by the robot program
        self.moments_ns: list[int] = []
        self.commands: list[np.ndarray] = []
        self.joints: list[np.ndarray] = []
        self.planned: list[pin.SE3] = []  # final flange pose of every accepted motion
        self.rig = self._make_rig(overrides)

    def _make_rig(self, overrides: dict[str, object]) -> Rig:
        self.network = HostileNetwork()
        return Rig(hostile_cell(PORT, **overrides), ManualClock(), self._make)

    def _make(self, bus: Bus, cell: CellConfig) -> Service:
        self.wire = LockStepLink(self.network, PORT, LinkEvents)
        self.gateway = Gateway(bus, cell, self.wire)
        controller = self._controller(bus, cell, self.network)
        self.machine.after_tick.append(lambda: self.network.pump(self.machine.now_ns))
        return Both(self.gateway, Runner(controller, [], bus.clock).step)

    def _controller(self, bus: Bus, cell: CellConfig, network: Network) -> ControllerSensor:
        self.controller = ControllerSensor(
            bus.playing("sensor"), cell, network, behaviour=self._behaviour
        )
        machine = self.machine = self.controller.machine
        machine.load(load(PROGRAM))
        watch_program(machine, self.accepted, self.taken)
        watch_motions(machine, self.planned)
        machine.after_tick.append(self._record_command)
        machine.pendant.monitor_speed(100.0)
        machine.pendant.execute("fm.main")
        return self.controller

    def _record_command(self) -> None:
        robot = self.machine.robot
        self.moments_ns.append(self.machine.now_ns)
        self.commands.append(robot.queue.q_command.copy())
        self.joints.append(robot.q.copy())

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
        """Publish set points at 50 mm/s, a new one each millisecond; a stall causes no step."""
        arbitrate = self.rig._arbitrate
        last_ns, z_m = self.rig.clock.now_ns(), 0.0

        def renew(now_ns: int) -> None:
            nonlocal last_ns, z_m
            last_ns, past_ns = now_ns, now_ns - last_ns
            if self.rig.command is not None and self.rig.command.kind == "setpoint":
                z_m = min(z_m + 0.05e-9 * min(past_ns, LONGEST_RENEWAL_NS), 0.06)
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
        self.rig.connect()
        goals = (self._does_a_goal(100 + 10 * len(self.hops) + attempt) for attempt in range(3))
        # A stall of the controller may end a lease, so three attempts.
        assert "done" in goals, f"{self.rig.state.goal} {self.rig.state.hold_reason}"

    def _does_a_goal(self, goal_id: int) -> str:
        rig = self.rig
        rig.arm()
        rig.send("goal", goal=pose_goal(goal_id, shifted(rig.T, z_m=0.005)))
        over = {"done", "refused"}
        rig.advance(5.0, lambda: rig.state.goal.id == goal_id and rig.state.goal.state in over)
        return rig.state.goal.state

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


class SocketCell(HostileCell):
    """The same on real sockets, through a proxy, in real time; the gateway with its own link."""

    def __init__(self, stack: ExitStack, **overrides: object) -> None:
        """Open everything; the stack closes it."""
        self._stack = stack
        super().__init__(QUICK, **({"rates.robot_hz": 20} | overrides))

    def _make_rig(self, overrides: dict[str, object]) -> Rig:
        self.sockets = SocketNetwork(port=0)
        self.proxy = self._stack.enter_context(HostileProxy(lambda: self.sockets.bound.get(PORT)))
        return Rig(hostile_cell(self.proxy.port, **overrides), MonotonicClock(), self._make)

    def _make(self, bus: Bus, cell: CellConfig) -> Service:
        self.gateway = Gateway(bus, cell)
        self._stack.callback(self.gateway.close)
        controller = self._controller(bus, cell, self.sockets)
        self._stack.callback(controller.close)
        return Both(self.gateway, Runner(controller, [], bus.clock).step)

    @property
    def hops(self) -> list[Hop]:
        """Every connection that the gateway has opened so far."""
        return self.proxy.hops


class LoneController(SocketCell):
    """The controller and the proxy; the gateway is another process."""

    def _make(self, bus: Bus, cell: CellConfig) -> Service:
        controller = self._controller(bus, cell, self.sockets)
        self._stack.callback(controller.close)
        return controller


def hostile_cell(port: int, **overrides: object) -> CellConfig:
    """Return the cell of these tests: the shipped program's watchdog, room below the tool."""
    gateway = {"host": "127.0.0.1", "port": port, "watchdog_s": WATCHDOG_S}
    return gateway_cell(
        port, **{"rates.robot_hz": 40, "sim.gap_m": 0.1, "gateway": gateway} | overrides
    )


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
