"""One fault in every service and link of a moving cell, on the virtual clock.

The services are those of the real processes, at 125 Hz with the deadlines of a lab PC: the result
is that of the design, to the millisecond, independent of the machine. `python -m tests.chaos` does
the same to real processes.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import product
from math import inf
from typing import Any, Literal, get_args

import numpy as np

from bench.harness import CaseTable, Options
from bench.results import ROOT, Row, Table, table
from cli.demo.scenario import ScenarioError
from common.bus.memory_bus import MemoryTransport
from common.config.cell import CellConfig
from common.config.load import load_cell
from common.motion.convert import pose_of, record_of
from common.motion.frames import Array
from forcemesh import topics
from forcemesh.codec import decode
from forcemesh.messages import Host, RobotCommand, RobotState, Speed
from forcemesh.requests import Empty, ForceStartRequest, MoveRequest
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
FaultKind = Literal["kill", "freeze", "cut"]
Motion = Literal["approach", "press", "retreat", "move"]
ROBOTS: tuple[Robot, ...] = get_args(Robot)
MOTIONS: tuple[Motion, ...] = get_args(Motion)
LINKS = (
    topics.ROBOT_STATE.key,
    topics.SENSOR_WRENCH.key,
    topics.WRENCH.key,
    topics.REGULATOR_TARGET.key,
    topics.ROBOT_COMMAND.key,
)


@dataclass(frozen=True, slots=True)
class Case:
    """One fault: a role that is killed or frozen, or a key of the bus that is cut."""

    robot: Robot
    how: FaultKind
    what: str
    motion: Motion


class CutTransport(MemoryTransport):
    """Bus whose keys can be cut; the robot's messages are recorded before the cut."""

    def __init__(self) -> None:
        """Start without a cut."""
        super().__init__()
        self.cut: set[str] = set()
        self.robot: RobotState | None = None
        self.kinds: dict[tuple[int, int], str] = {}

    def publish(self, key: str, qos: Qos) -> Callable[[bytes], None]:
        """Return the function that puts bytes on a key, unless it is cut."""
        put, name = super().publish(key, qos), key.partition("/")[2]

        def put_unless_cut(data: bytes) -> None:
            self._overhear(name, data)
            if name not in self.cut:
                put(data)

        return put_unless_cut

    def _overhear(self, name: str, data: bytes) -> None:
        if name == topics.ROBOT_STATE.key:
            self.robot = decode(data, RobotState)[1]
        elif name == topics.ROBOT_COMMAND.key:
            header, command = decode(data, RobotCommand)
            kind = "hold" if command.permission is None else command.kind
            self.kinds[header.epoch, header.seq] = kind


class FaultCell:
    """Virtual cell with fault injection, and the true motion of its flange."""

    def __init__(self, robot: Robot, **changes: float) -> None:
        """Start it, with a plate of `stiffness_N_m` at `gap_m`, tare and arm."""
        self.bus = CutTransport()
        self.world = VirtualCell(cell_for(robot, **changes), self.bus)
        self.host: Host = "pc" if robot == "sim" else "controller"
        self.p_m: list[Array] = []
        self.last_ns = 0
        self.world.advance(1.6)
        self.ask(topics.TARE, Empty())
        self.ask(topics.SPEED, Speed(mechanical_m_s=LIFT_M_S))
        self.ask(topics.ARM, Empty())
        self.live(0.1)

    @property
    def now_ns(self) -> int:
        """The virtual time."""
        return self.world.clock.now_ns()

    def ask(self, request: topics.Request[Any], message: Any) -> None:
        """Send a request as a client. Raises ScenarioError when it is refused."""
        answer = self.world.client.ask(request, message)
        if not answer.accepted:
            raise ScenarioError(f"{request.key}: {answer.text}")

    def live(self, duration_s: float) -> None:
        """Advance time; record the flange and the accepted commands each millisecond."""
        self.world.advance(duration_s, self._record)

    def _record(self) -> bool:
        self.p_m.append(np.array(self.world.arm.T_base_flange.translation))
        accepted = None if self.bus.robot is None else self.bus.robot.accepted
        if accepted is not None:
            kind = self.bus.kinds.get((accepted.epoch, accepted.seq), "idle")
            if kind in ("goal", "setpoint", "feedback"):
                self.last_ns = accepted.at_ns
        return False

    def speeds_m_s(self) -> Array:
        """Return the flange's speed over windows of 10 ms. Shape (n,)."""
        p_m = np.array(self.p_m)
        travel_m: Array = np.linalg.norm(p_m[WINDOW:] - p_m[:-WINDOW], axis=1)
        return travel_m / (WINDOW * 1e-3)

    def begin(self, motion: Motion) -> None:
        """Start a motion and wait until it is in progress."""
        if motion == "move":
            if self.bus.robot is None:
                raise ScenarioError("no robot/state received")
            T = pose_of(self.bus.robot)
            T.translation = T.translation + np.array([0.0, 0.0, LIFT_M])
            self.ask(topics.MOVE, MoveRequest(kind="pose", pose=record_of(T)))
            self.live(0.3)
            return
        self.feedback(PRESS_N, "pc")
        if motion == "approach":
            self.live(0.3)
            return
        arm = self.world.arm
        self._until(lambda: arm.true_wrench().force_N[2] > 0.2 * PRESS_N, 0.05, "no contact")
        if motion == "retreat":
            self.live(3.0)
            self.feedback(RELEASE_N, self.host)
            fast_m_s = 2.0 * MOVING_M_S
            self._until(lambda: self.speeds_m_s()[-1] > fast_m_s, 0.01, "the arm does not retreat")

    def feedback(self, setpoint_N: float, host: Host) -> None:
        """Start force feedback along the tool."""
        start = ForceStartRequest(mode="position", host=host, setpoint_N=setpoint_N)
        self.ask(topics.FORCE_START, start)

    def _until(self, condition: Callable[[], bool], step_s: float, failure: str) -> None:
        for _ in range(200):
            self.live(step_s)
            if condition():
                return
        raise ScenarioError(failure)

    def strike(self, case: Case) -> None:
        """Inject the fault, and undo it if it ends: all traffic goes through the hub."""
        links = set(LINKS) if case.what == "hub" else {case.what}
        self.bus.cut |= links if case.what == "hub" or case.how == "cut" else set()
        frozen = None if case.how == "cut" else self.world.runners.pop(case.what)
        self.live(FROZEN_S)
        if case.how != "kill":
            self.bus.cut.clear()
        if case.how == "freeze" and frozen is not None:
            self.world.runners[case.what] = frozen
        self.live(WATCH_S)


def cell_for(
    robot: Robot, *, stiffness_N_m: float = SOFT_N_M, gap_m: float | None = None
) -> CellConfig:
    """Return a demo cell at 125 Hz, with the default deadlines of a lab PC."""
    name = "demo.yaml" if robot == "sim" else "demo-tcp.yaml"
    robot_hz = HZ if robot == "sim" else 40
    return load_cell(
        CELLS / name,
        {
            "rates": {"robot_hz": robot_hz, "sensor_hz": 2 * HZ, "control_hz": HZ},
            "deadlines": {},
            "sim.stiffness_N_m": stiffness_N_m,
            "contact.stiffness_N_m": stiffness_N_m,
            "force.approach_m_s": min(0.01, APPROACH_N_S / stiffness_N_m),
            **({} if gap_m is None else {"sim.gap_m": gap_m}),
        },
    )


def cases() -> Iterator[Case]:
    """Yield every fault that does not end the arm itself."""
    for robot, motion in product(ROBOTS, MOTIONS):
        kept = {"robot", "sensor"} if robot == "sim" else {"sensor"}
        for role in (role for role in ROLES if role not in kept):
            yield Case(robot, "kill", role, motion)
            yield Case(robot, "freeze", role, motion)
        for link in LINKS:
            yield Case(robot, "cut", link, motion)


def row(case: Case) -> Row:
    """Let a fault happen in motion, and watch the flange."""
    world = FaultCell(case.robot)
    world.begin(case.motion)
    speed_m_s, begun, fault_ns = float(world.speeds_m_s()[-1]), len(world.p_m), world.now_ns
    world.strike(case)
    speeds = world.speeds_m_s()[begun - WINDOW :]
    fast = np.flatnonzero(speeds >= STILL_M_S)
    still = int(fast[-1]) + 1 if len(fast) else 0
    rest_m = np.array(world.p_m[begun + still :])
    rests = still < len(speeds)
    return {
        **asdict(case),
        "speed_m_s": speed_m_s,
        "last_motion_ms": max(0, world.last_ns - fault_ns) / 1e6,
        "at_rest_ms": still if rests else inf,
        "moved_after_mm": 1e3 * np.linalg.norm(rest_m - rest_m[0], axis=1).max() if rests else inf,
    }


ROWS = CaseTable(
    {
        "robot": "", "how": "", "what": "", "motion": "", "speed_m_s": ".3f",
        "last_motion_ms": ".0f", "at_rest_ms": ".0f", "moved_after_mm": ".2f",
    },
    [*cases()],
    row,
)  # fmt: skip
WORST = {
    "robot": "", "how": "", "what": "", "trials": "d",
    "last_motion_ms": ".0f", "at_rest_ms": ".0f", "moved_after_mm": ".2f",
}  # fmt: skip


def measure(options: Options) -> dict[str, Table]:
    """Return every fault, and the worst of each over the motions in which the flange moved."""
    rows = ROWS.measured(options)
    return {"rows": ROWS.stored(rows), "worst": table(WORST, worst_rows(rows))}


def worst_rows(rows: Sequence[Row]) -> Iterator[Row]:
    """Yield the worst of each robot, fault and role or key."""
    names, measures = list(WORST)[:3], list(WORST)[4:]
    moving = [each for each in rows if each["speed_m_s"] > MOVING_M_S]
    for place in dict.fromkeys(tuple(each[name] for name in names) for each in moving):
        ours = [each for each in moving if tuple(each[name] for name in names) == place]
        yield {
            **dict(zip(names, place, strict=True)),
            "trials": len(ours),
            **{name: max(each[name] for each in ours) for name in measures},
        }
