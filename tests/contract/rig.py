"""One robot on an in-memory bus, and a stand-in for the arbiter: what the contract is tried on.

The simulated robot lives on a virtual clock; the gateway talks to the fake controller over a real
TCP socket, so there time is real.
"""

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from common import topics
from common.cell import Cell
from common.clock import NS_PER_S, Clock, ManualClock, MonotonicClock
from common.config import load_cell
from common.convert import pose_of, record_of
from common.endpoints import Bus, Origin
from common.memory import MemoryTransport
from common.messages import Goal, Host, Permission, RobotCommand, RobotState, Speed, WrenchAtTcp
from common.service import Runner, Service
from services.gateway.service import Gateway
from sim.robot.service import SimRobot
from tests.fakes.controller import FakeController

DEMO_CELL = Path(__file__).resolve().parents[2] / "cells" / "demo.yaml"
COMMAND_PERIOD_NS = 4_000_000
DEADLINE_S = 0.25  # long enough that a busy machine does not look like a dead arbiter
SENSOR_STAMP = Origin(123_456, 7)


class Rig:
    """A robot, and what a test needs to command and to watch it."""

    def __init__(self, cell: Cell, clock: Clock, make: Callable[[Bus, Cell], Service]) -> None:
        self.cell = cell
        self.clock = clock
        self.transport = MemoryTransport()
        self.state = RobotState(valid=False, reason="nothing yet")
        self.states: list[RobotState] = []
        self.lease = 0
        self.command: RobotCommand | None = None
        self.command_seq = 0
        self.wrench: WrenchAtTcp | None = None
        self._robot = self._bus("robot")
        self.service = make(self._robot, cell)
        self._runner = Runner(self.service, [], clock)
        self._reader = self._bus("arbiter").reader(topics.ROBOT_STATE)
        self._put_wrench = self._bus("wrench").publisher(topics.WRENCH)
        self.restart_arbiter()

    def _bus(self, role: str) -> Bus:
        return Bus(role, self.cell.cell, self.transport, self.cell, self.clock)

    def restart_arbiter(self) -> None:
        """Go on as another process: a new epoch."""
        self._put_command = self._bus("arbiter").publisher(topics.ROBOT_COMMAND)
        self._next_ns = 0

    # --- time -------------------------------------------------------------------------------------

    def advance(self, duration_s: float, until: Callable[[], object] = lambda: False) -> bool:
        """Let the robot live; tell whether a condition came true in that time."""
        end_ns = self.clock.now_ns() + round(duration_s * NS_PER_S)
        while self.clock.now_ns() < end_ns:
            self.clock.sleep_s(0.001)
            self._arbitrate(self.clock.now_ns())
            if self._runner.due(self.clock.now_ns()):
                self._runner.step(self.clock.now_ns())
            if self._reader.poll():
                message = self._reader.read(self.clock.now_ns()).message
                assert message is not None
                self.state = message
                self.states.append(message)
            if until():
                return True
        return False

    def until(self, condition: Callable[[], object], within_s: float = 5.0) -> None:
        """Let the robot live until a condition is true."""
        assert self.advance(within_s, condition), self.state

    def _arbitrate(self, now_ns: int) -> None:
        if now_ns < self._next_ns:
            return
        self._next_ns = now_ns + COMMAND_PERIOD_NS
        if self.wrench is not None:
            self._put_wrench.put(self.wrench)
        if self.command is not None:
            self.command_seq = self._put_command.put(self.command, SENSOR_STAMP).seq

    # --- commanding -------------------------------------------------------------------------------

    def say(self, kind: str, *, host: Host = "pc", **content: Any) -> None:
        """Command this every period from now on, under the present lease."""
        permission = Permission(host=host, lease=self.lease, deadline_s=DEADLINE_S)
        content = {"speed": Speed(mechanical_m_s=0.1)} | content
        self.command = RobotCommand.model_validate(
            {"kind": kind, "permission": permission, "commander": "operator"} | content
        )

    def say_hold(self, reason: str = "asked to hold") -> None:
        """Command hold every period from now on."""
        self.command = RobotCommand(kind="hold", reason=reason)

    def silence(self) -> None:
        """Say nothing any more."""
        self.command = None

    def arm(self) -> None:
        """Open a new lease and wait until the robot accepts it."""
        self.lease += 1
        self.say("idle")
        self.until(lambda: self.state.valid and not self.state.hold_reason)

    def connect(self) -> None:
        """Wait until the robot says where it is."""
        self.until(lambda: self.state.valid)

    # --- watching ---------------------------------------------------------------------------------

    @property
    def T(self) -> pin.SE3:
        """Flange in base, as the robot says."""
        return pose_of(self.state)

    @property
    def joint_rad(self) -> np.ndarray:
        """Joint angles, as the robot says."""
        return np.array(self.state.joint_rad)

    def is_at_rest(self, within_s: float = 3.0) -> bool:
        """Wait until the arm has not moved for 50 ms."""
        seen: list[np.ndarray] = []

        def rests() -> bool:
            seen.append(self.T.translation.copy())
            return len(seen) > 50 and np.ptp(np.array(seen[-50:]), axis=0).max() < 5e-5

        return self.advance(within_s, rests)


def sim_rig(stack: ExitStack) -> Rig:
    """The simulated robot on a virtual clock."""
    return Rig(load_cell(DEMO_CELL, {"deadlines.command_s": DEADLINE_S}), ManualClock(), SimRobot)


def gateway_cell(port: int, **overrides: object) -> Cell:
    """The demo cell with a controller behind a gateway."""
    changes: dict[str, object] = {
        "roles.robot": "gateway",
        "roles.sensor": "external",
        "robot.hosts": ["pc", "controller"],
        "deadlines.command_s": DEADLINE_S,
        "rates.robot_hz": 100,
        "gateway": {"host": "127.0.0.1", "port": port, "watchdog_s": 1.0},
    }
    return load_cell(DEMO_CELL, changes | overrides)


def gateway_rig(stack: ExitStack) -> Rig:
    """The gateway and a fake controller on a real socket, in real time."""
    controller = stack.enter_context(FakeController(rate_hz=100.0))
    rig = Rig(gateway_cell(controller.port), MonotonicClock(), Gateway)
    assert isinstance(rig.service, Gateway)
    stack.callback(rig.service.close)
    return rig


def goal(id_: int, kind: str, **content: Any) -> Goal:
    """A goal."""
    return Goal.model_validate({"id": id_, "kind": kind} | content)


def shifted(T: pin.SE3, x_m: float = 0.0, y_m: float = 0.0, z_m: float = 0.0) -> pin.SE3:
    """The same orientation somewhere else in base."""
    return pin.SE3(T.rotation, T.translation + np.array([x_m, y_m, z_m]))


def pose_goal(id_: int, T: pin.SE3) -> Goal:
    """A goal of kind pose."""
    return goal(id_, "pose", pose=record_of(T))
