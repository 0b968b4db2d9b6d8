"""One fault in every service and link of a moving cell, on the virtual clock.

The services are those of the real processes, at 125 Hz with the deadlines of a lab PC: the result
is that of the design, to the millisecond, independent of the machine. `python -m tests.chaos` does
the same to real processes.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import product
from math import inf
from typing import Any, Literal, get_args

import numpy as np

from bench.harness import CaseTable, Options, Tables, grouped, largest
from bench.results import ROOT, Row
from cli.demo.scenario import ScenarioError
from common.bus.configured_cell import ConfiguredCell
from common.bus.memory_bus import MemoryTransport
from common.config.cell import CellConfig
from common.config.load import load_cell
from common.motion.convert import pose_of, record_of
from common.motion.frames import Array
from forcemesh import topics
from forcemesh.messages import Host, Speed
from forcemesh.requests import ArmRequest, MoveRequest
from forcemesh.topics import ROLES, Qos
from launch.virtual_cell import VirtualCell

CELLS = ROOT / "cells"
HZ, FROZEN_S, WATCH_S = 125, 1.0, 1.0
MOVING_M_S, STILL_M_S = 2e-3, 1e-3
WINDOW = 10  # milliseconds over which a speed is taken
PRESS_N, RELEASE_N = 20.0, 0.0
LIFT_M, LIFT_M_S = 0.06, 0.1
APPROACH_N_S = 140.0  # rise of the force at first contact, as in the demo's cells
SOFT_N_M = 2000.0  # so that pressing takes centimetres

Robot = Literal["sim", "tcp"]
MOVING = ("goal", "setpoint", "feedback")  # kinds of commands
MOTIONS = ("approach", "press", "retreat", "move")
LINKS = (
    topics.ROBOT_STATE.key,
    topics.SENSOR_WRENCH.key,
    topics.WRENCH.key,
    topics.REGULATOR_TARGET.key,
    topics.ROBOT_COMMAND.key,
)


class CutTransport(MemoryTransport):
    """Bus whose keys can be cut."""

    def __init__(self) -> None:
        super().__init__()
        self.cut: set[str] = set()

    def publish(self, key: str, qos: Qos) -> Callable[[bytes], None]:
        """Return the function that puts bytes on a key, unless it is cut."""
        put, name = super().publish(key, qos), key.partition("/")[2]

        def put_unless_cut(data: bytes) -> None:
            if name not in self.cut:
                put(data)

        return put_unless_cut


class FaultCell:
    """Virtual cell with fault injection, and the true motion of its flange."""

    def __init__(self, robot: Robot) -> None:
        self.bus = CutTransport()
        self.world, self.client = armed_cell(cell_for(robot, SOFT_N_M), self.bus)
        self.host: Host = "pc" if robot == "sim" else "controller"
        self.p_m: list[Array] = []
        self.last_ns = 0  # of the last motion command that the robot has accepted
        self._robot: Any = self.world.runners["robot"].service
        self.client.state.reading()  # subscribes: the newest message is there when it is read
        self.live(0.1)

    def live(self, duration_s: float) -> None:
        """Advance time; record the flange and the accepted commands each millisecond."""
        self.world.advance(duration_s, self._record)

    def _record(self) -> bool:
        self.p_m.append(np.array(self.world.arm.T_base_flange.translation))
        command, _, accepted, _ = self._robot.verdict
        if command is not None and command.permission is not None and command.kind in MOVING:
            self.last_ns = accepted.at_ns
        return False

    def speeds_m_s(self) -> Array:
        """Return the flange's speed over windows of 10 ms. Shape (n,)."""
        p_m = np.array(self.p_m)
        travel_m: Array = np.linalg.norm(p_m[WINDOW:] - p_m[:-WINDOW], axis=1)
        return travel_m / (WINDOW * 1e-3)

    def begin(self, motion: str) -> None:
        """Start a motion and wait until it is in progress."""
        if motion == "move":
            T = pose_of(self.client.state())
            T.translation = T.translation + np.array([0.0, 0.0, LIFT_M])
            self.client.ask(topics.MOVE, MoveRequest(kind="pose", pose=record_of(T)))
            self.live(0.3)
            return
        self.client.force.start(PRESS_N)
        if motion == "approach":
            self.live(0.3)
            return
        arm = self.world.arm
        self._until(lambda: arm.true_wrench().force_N[2] > 0.2 * PRESS_N, 0.05, "no contact")
        if motion == "retreat":
            self.live(3.0)
            self.client.force.start(RELEASE_N, host=self.host)
            fast_m_s = 2.0 * MOVING_M_S
            self._until(lambda: self.speeds_m_s()[-1] > fast_m_s, 0.01, "the arm does not retreat")

    def _until(self, condition: Callable[[], bool], step_s: float, failure: str) -> None:
        for _ in range(200):
            self.live(step_s)
            if condition():
                return
        raise ScenarioError(failure)

    def strike(self, how: str, what: str) -> None:
        """Kill or freeze a role, or cut a key; undo it if it ends: all goes through the hub."""
        self.bus.cut |= set(LINKS) if what == "hub" else {what} if how == "cut" else set()
        frozen = None if how == "cut" else self.world.runners.pop(what)
        self.live(FROZEN_S)
        if how != "kill":
            self.bus.cut.clear()
        if how == "freeze" and frozen is not None:
            self.world.runners[what] = frozen
        self.live(WATCH_S)


def armed_cell(
    cell: CellConfig, transport: MemoryTransport | None = None
) -> tuple[VirtualCell, ConfiguredCell]:
    """Return a virtual cell that is tared and armed, and its client."""
    world = VirtualCell(cell, transport)
    client = ConfiguredCell(cell, commander="operator", bus=world.client)
    world.advance(1.6)
    client.tare()
    client.ask(topics.SPEED, Speed(mechanical_m_s=LIFT_M_S))
    client.ask(topics.ARM, ArmRequest())
    return world, client


def cell_for(
    robot: Robot, stiffness_N_m: float, changes: Mapping[str, object] | None = None
) -> CellConfig:
    """Return a demo cell at 125 Hz with the default deadlines of a lab PC, and other changes."""
    name = "demo.yaml" if robot == "sim" else "demo-tcp.yaml"
    robot_hz = HZ if robot == "sim" else 40
    usual = {
        "rates": {"robot_hz": robot_hz, "sensor_hz": 2 * HZ, "control_hz": HZ},
        "deadlines": {},
        "sim.stiffness_N_m": stiffness_N_m,
        "contact.stiffness_N_m": stiffness_N_m,
        "force.approach_m_s": min(0.01, APPROACH_N_S / stiffness_N_m),
    }
    return load_cell(CELLS / name, {**usual, **(changes or {})})


def cases() -> Iterator[Row]:
    """Yield every fault that does not end the arm itself, in every motion."""
    for robot, motion in product(get_args(Robot), MOTIONS):
        kept = {"robot", "sensor"} if robot == "sim" else {"sensor"}
        roles = [role for role in ROLES if role not in kept]
        faults = [*product(roles, ("kill", "freeze")), *product(LINKS, ("cut",))]
        for what, how in faults:
            yield {"robot": robot, "how": how, "what": what, "motion": motion}


def row(case: Row) -> Row:
    """Let a fault happen in motion, and watch the flange."""
    cell = FaultCell(case["robot"])
    cell.begin(case["motion"])
    speed_m_s, begun = float(cell.speeds_m_s()[-1]), len(cell.p_m)
    fault_ns = cell.world.clock.now_ns()
    cell.strike(case["how"], case["what"])
    speeds = cell.speeds_m_s()[begun - WINDOW :]
    fast = np.flatnonzero(speeds >= STILL_M_S)
    still = int(fast[-1]) + 1 if len(fast) else 0
    rest_m = np.array(cell.p_m[begun + still :])
    rests = still < len(speeds)
    return {
        **case,
        "speed_m_s": speed_m_s,
        "last_motion_ms": max(0, cell.last_ns - fault_ns) / 1e6,
        "at_rest_ms": still if rests else inf,
        "moved_after_mm": 1e3 * np.linalg.norm(rest_m - rest_m[0], axis=1).max() if rests else inf,
    }


ROWS = CaseTable([*cases()], row)


def measure(options: Options) -> Tables:
    """Return every fault, and the worst of each over the motions in which the flange moved."""
    rows = ROWS.measured(options)
    return {"rows": rows, "worst": worst_rows(rows)}


def worst_rows(rows: Sequence[Row]) -> Iterator[Row]:
    """Yield the worst of each robot, fault and role or key."""
    moving = [each for each in rows if each["speed_m_s"] > MOVING_M_S]
    for place, ours in grouped(moving, "robot", "how", "what"):
        measures = largest(ours, ("last_motion_ms", "at_rest_ms", "moved_after_mm"))
        yield {**place, "trials": len(ours), **measures}
