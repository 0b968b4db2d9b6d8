"""A whole cell on a virtual clock, armed, with a client."""

from collections.abc import Callable
from typing import Any, cast

import numpy as np
import pytest

from common.config.cell import CellConfig
from common.motion.convert import pose_of, record_of
from common.motion.frames import rotate_about_base_axes
from forcemesh import topics
from forcemesh.messages import ArbiterStatus, Host, Law, PoseRecord, RobotState
from forcemesh.requests import Empty, ForceStartRequest, MoveRequest
from launch.virtual_cell import VirtualCell
from sim.controller.machine import Machine
from sim.controller.service import ControllerSensor
from tests.fakes.bench import HALF_CELL

PRESS_N = 20.0
FOUND_PART = 0.9  # of the force: the plate is found
FOUND_S, SETTLED_S = 6.0, 0.7
STILL_M = 5e-5
BRAKE_S = 0.25


class Lab:
    """The cell on a virtual clock with a client."""

    def __init__(self, cell: CellConfig = HALF_CELL) -> None:
        """Advance past the preflight, tare and arm."""
        self.cell = VirtualCell(cell)
        self.robot = self.cell.client.reader(topics.ROBOT_STATE)
        self.command = self.cell.client.reader(topics.ROBOT_COMMAND)
        self.arbiter = self.cell.client.reader(topics.ARBITER_STATUS)
        self.wrench = self.cell.client.reader(topics.WRENCH)
        # A controller needs a hello first.
        self.cell.advance(1.2 if cell.roles.robot == "sim" else 1.6)
        assert self.ask(topics.TARE, Empty()).accepted
        assert self.ask(topics.ARM, Empty()).accepted
        self.cell.advance(0.05)

    def ask(self, request: topics.Request[Any], message: Any) -> Any:
        """Send a request as a client."""
        return self.cell.client.ask(request, message)

    def now(self, reader: Any) -> Any:
        """Return the newest message of a reader, however old."""
        return reader.read(self.cell.clock.now_ns()).message

    @property
    def machine(self) -> Machine:
        """The emulated controller, of a cell over TCP."""
        service = self.cell.runners["sensor"].service
        assert isinstance(service, ControllerSensor)
        return service.machine

    @property
    def state(self) -> RobotState:
        """Last report of the robot."""
        return cast("RobotState", self.now(self.robot))

    @property
    def status(self) -> ArbiterStatus:
        """Last status of the arbiter."""
        return cast("ArbiterStatus", self.now(self.arbiter))

    @property
    def force_N(self) -> float:
        """Force along base z."""
        return float(self.now(self.wrench).force_N[2])

    def p_m(self) -> np.ndarray:
        """True flange position, also after the end of the robot's process."""
        return np.array(self.cell.arm.T_base_flange.translation)

    def q_command(self) -> np.ndarray:
        """Joint angles that the controller commands its servos."""
        return self.cell.arm.q_command

    def approach(self, law: Law | None = None) -> None:
        """Move down under force feedback, in free space."""
        start = ForceStartRequest(mode="position", setpoint_N=PRESS_N, law=law)
        assert self.ask(topics.FORCE_START, start).accepted
        self.cell.advance(0.2)

    def press(self, host: Host = "pc") -> None:
        """Find the plate on the PC, then let a host hold the force."""
        self.approach()
        self.seconds_until(lambda: self.force_N > FOUND_PART * PRESS_N, FOUND_S)
        if host == "controller":
            start = ForceStartRequest(mode="position", host=host, setpoint_N=PRESS_N)
            assert self.ask(topics.FORCE_START, start).accepted
        self.cell.advance(SETTLED_S)
        assert self.force_N == pytest.approx(PRESS_N, abs=1.0)

    def lift(self) -> None:
        """Begin a move up as a goal."""
        assert self.ask(topics.MOVE, MoveRequest(kind="pose", pose=self.target(z_m=0.1))).accepted
        self.cell.advance(0.5)

    def target(self, **shift: float) -> PoseRecord:
        """Return a flange pose shifted from the present one, with a small rotation."""
        T = pose_of(self.state)
        moved_m = [shift.get(axis, 0.0) for axis in ("x_m", "y_m", "z_m")]
        T.translation = T.translation + np.array(moved_m)
        T.rotation = rotate_about_base_axes(T.rotation, np.array([0.1, 0.0, 0.2]))
        return record_of(T)

    def seconds_until(self, condition: Callable[[], bool], at_most_s: float) -> float:
        """Advance until a condition is true; return the time that it took."""
        before_ns = self.cell.clock.now_ns()
        self.cell.advance(at_most_s, condition)
        assert condition()
        return (self.cell.clock.now_ns() - before_ns) / 1e9

    def finish_move(self, at_most_s: float = 6.0) -> float:
        """Wait until the goal is done; return the duration."""
        duration_s = self.seconds_until(lambda: self.status.state == "ARMED", at_most_s)
        assert self.state.goal.state == "done"
        assert self.status.commander == "none"
        return duration_s

    def assert_still(self, duration_s: float) -> None:
        """Assert that neither the command nor the arm moves."""
        q, p = self.q_command(), self.p_m()
        for _ in range(10):
            self.cell.advance(duration_s / 10)
            assert self.q_command() == pytest.approx(q, abs=1e-9)
            assert self.p_m() == pytest.approx(p, abs=STILL_M)
