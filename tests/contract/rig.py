"""Test rig of the contract: one robot on an in-memory bus and a substitute of the arbiter.

The robots are defined in `tests/contract/robots.py`.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pinocchio as pin

from common.bus.memory_bus import MemoryTransport
from common.config.cell import CellConfig
from common.config.load import load_cell
from common.motion.convert import pose_of, record_of
from common.motion.frames import rotation_between
from common.runtime.service import Runner, Service
from forcemesh import topics
from forcemesh.bus import Bus, Origin
from forcemesh.clock import NS_PER_S, Clock
from forcemesh.messages import (
    Feedback,
    Gains,
    Goal,
    Host,
    Mode,
    Permission,
    RobotCommand,
    RobotState,
    Speed,
    Vec3,
    WrenchAtTcp,
)
from tests.contract.pc_feedback import PcFeedback
from tests.fakes.records import encode_unchecked

DEMO_CELL = Path(__file__).resolve().parents[2] / "cells" / "demo.yaml"
COMMAND_PERIOD_NS = 4_000_000
DEADLINE_S = 0.25  # longer than the stalls of a busy machine
SENSOR_STAMP = Origin(123_456, 7)


class LateClock:
    """The rig's clock with a constant delay, for a process that receives its messages late."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self.late_s = 0.0

    @property
    def boot(self) -> str:
        """Return the boot ID of the rig's clock."""
        return self._clock.boot

    def now_ns(self) -> int:
        """Return the rig's time minus the delay."""
        return self._clock.now_ns() - round(self.late_s * NS_PER_S)

    def sleep_s(self, duration_s: float) -> None:
        """Sleep on the rig's clock."""
        self._clock.sleep_s(duration_s)


class Rig:
    """A robot and the functions with which a test commands and observes it."""

    def __init__(
        self,
        cell: CellConfig,
        clock: Clock,
        make: Callable[[Bus, CellConfig], Service],
        *,
        feedback_host: Host = "controller",
    ) -> None:
        self.cell = cell
        self.clock = clock
        self.arbiter_clock = LateClock(clock)
        self.feedback_host = feedback_host
        self.transport = MemoryTransport()
        self.state = RobotState(valid=False, reason="nothing yet")
        self.states: list[RobotState] = []
        self.track: list[tuple[float, pin.SE3]] = []  # time [s] and flange of every report
        self.lease, self.challenge = 0, 0
        self.command: RobotCommand | None = None
        self.command_seq = 0
        self.wrench: WrenchAtTcp | None = None
        self._on_pc: PcFeedback | None = None
        # Stops and resumes the robot program; a robot without one takes each command at once.
        self.stall: Callable[[bool], object] = lambda _on: None
        # Moves the arm by several millimetres, without a command.
        self.shove: Callable[[], object] = lambda: None
        self._robot = self._bus("robot")
        self.service = make(self._robot, cell)
        self._runner = Runner(self.service, [], clock)
        self._reader = self._bus("arbiter").reader(topics.ROBOT_STATE)
        self._put_wrench = self._bus("wrench").publisher(topics.WRENCH)
        self.restart_arbiter()

    def _bus(self, role: str, clock: Clock | None = None) -> Bus:
        return Bus(role, self.cell.cell, self.transport, self.cell, clock or self.clock)

    def restart_arbiter(self) -> None:
        """Restart the arbiter's substitute: it publishes with a new epoch."""
        bus = self._bus("arbiter", self.arbiter_clock)
        self._put_command = bus.publisher(topics.ROBOT_COMMAND)
        self._next_ns = 0

    # --- time -------------------------------------------------------------------------------------

    def advance(self, duration_s: float, until: Callable[[], object] = lambda: False) -> bool:
        """Advance the robot by a time; return whether the condition became true in that time."""
        end_ns = self.clock.now_ns() + round(duration_s * NS_PER_S)
        while self.clock.now_ns() < end_ns:
            self.clock.sleep_s(0.001)
            self._arbitrate(self.clock.now_ns())
            self._runner.step(self.clock.now_ns())
            if self._reader.poll():
                message = self._reader.read(self.clock.now_ns()).message
                assert message is not None
                self.state = message
                self.states.append(message)
                if message.valid:
                    self.track.append((self.clock.now_ns() / NS_PER_S, self.T))
            if until():
                return True
        return False

    def until(self, condition: Callable[[], object], within_s: float = 10.0) -> None:
        """Advance the robot until a condition is true; fail after `within_s`."""
        assert self.advance(within_s, condition), self.state

    def _arbitrate(self, now_ns: int) -> None:
        if now_ns < self._next_ns:
            return
        self._next_ns = now_ns + COMMAND_PERIOD_NS
        if self.wrench is not None:
            with patch("forcemesh.bus.encode", encode_unchecked):
                self._put_wrench.put(self.wrench)
        if self._on_pc is not None and self.wrench is not None:
            pose = self._on_pc.next_pose(self.wrench, now_ns)
            self.command = self._permitted("setpoint", pose=pose)
        if self.command is not None:
            with patch("forcemesh.bus.encode", encode_unchecked):
                self.command_seq = self._put_command.put(self.command, SENSOR_STAMP).seq

    # --- commanding -------------------------------------------------------------------------------

    def send(self, kind: str, *, host: Host = "pc", **content: Any) -> None:
        """Publish this command every period from now on, under the present lease."""
        self._on_pc = None
        self.command = self._permitted(kind, host, **content)

    def _permitted(self, kind: str, host: Host = "pc", **content: Any) -> RobotCommand:
        permission = self.permission(host=host)
        content = {"speed": Speed(mechanical_m_s=0.1)} | content
        return RobotCommand.from_dict(
            {"kind": kind, "permission": permission, "commander": "operator"} | content
        )

    def permission(self, **content: Any) -> Permission:
        """Return a permission under the present lease."""
        terms = {"host": "pc", "deadline_s": DEADLINE_S, "challenge": self.challenge}
        return Permission.from_dict(terms | {"lease": self.lease} | content)

    def send_hold(self, reason: str = "asked to hold") -> None:
        """Publish hold every period from now on."""
        self._on_pc = None
        self.command = RobotCommand(kind="hold", reason=reason)

    def silence(self) -> None:
        """Publish no more commands."""
        self._on_pc, self.command = None, None

    def push(self, force_N: Vec3 = (0.0, 0.0, 0.0), torque_Nm: Vec3 = (0.0, 0.0, 0.0)) -> None:
        """Apply a wrench of the environment from now on: base axes, about the TCP."""
        self.wrench = WrenchAtTcp(force_N=force_N, torque_Nm=torque_Nm)

    def feed_back(self, mode: Mode, gains: Gains) -> None:
        """Command force feedback from now on, on the robot's loop host; `push` sets the wrench."""
        if self.feedback_host == "controller":
            feedback = Feedback(mode=mode, gains=gains)
            self.send("feedback", host="controller", feedback=feedback)
            request = (mode != "orientation", mode != "position")
            self.until(lambda: self.feedback_bits == request)
        elif self._on_pc is None:
            now_ns = self.clock.now_ns()
            self._on_pc = PcFeedback(self.cell, self.T, mode, gains, now_ns=now_ns)
        else:
            self._on_pc.use(gains)

    def arm(self, **terms: Any) -> None:
        """Open a new lease and wait until the robot accepts it; again if its challenge was old."""

        def begin() -> None:
            self.lease, self.challenge = self.lease + 1, self.state.challenge
            self.send("idle", permission=self.permission(**terms))

        def accepts() -> bool:
            if self.state.challenge not in {0, self.challenge}:
                begin()
            return self.state.valid and not self.state.hold_reason

        begin()
        self.until(accepts)

    def connect(self) -> None:
        """Wait until the robot reports its pose."""
        self.until(lambda: self.state.valid)

    # --- watching ---------------------------------------------------------------------------------

    @property
    def T(self) -> pin.SE3:
        """Reported pose of the flange in base."""
        return pose_of(self.state)

    @property
    def T_tcp(self) -> pin.SE3:
        """Reported pose of the tool centre point in base."""
        return self.T * self.cell.tool.T_flange_tcp.pose

    @property
    def feedback_bits(self) -> tuple[bool, bool]:
        """Reported status bits of force feedback of position and of orientation."""
        mode = self.state.status.feedback
        return mode in ("position", "both"), mode in ("orientation", "both")

    @property
    def joint_rad(self) -> np.ndarray:
        """Reported joint angles."""
        return np.array(self.state.joint_rad)

    def fastest(self, window_s: float) -> tuple[float, float]:
        """Return the longest travel [m] and rotation [rad] of the flange in any window."""
        travels_m, turns_rad = [0.0], [0.0]
        for at_s, T in self.track:
            later = next((each for each in self.track if each[0] >= at_s + window_s - 1e-9), None)
            if later is None:
                break
            share = window_s / (later[0] - at_s)  # no report falls on the end of the window
            travels_m.append(share * float(np.linalg.norm(later[1].translation - T.translation)))
            turn_rad = np.linalg.norm(rotation_between(T.rotation, later[1].rotation))
            turns_rad.append(share * float(turn_rad))
        return max(travels_m), max(turns_rad)

    def is_at_rest(self, within_s: float = 3.0) -> bool:
        """Wait until the arm has not moved for 50 ms."""
        positions: list[np.ndarray] = []

        def rests() -> bool:
            positions.append(self.T.translation.copy())
            return len(positions) > 50 and np.ptp(positions[-50:], axis=0).max() < 5e-5

        return self.advance(within_s, rests)


def gateway_cell(port: int, **overrides: object) -> CellConfig:
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


def goal(id_: int, kind: str, **content: Any) -> Goal:
    """A goal."""
    return Goal.from_dict({"id": id_, "kind": kind} | content)


def distance_m(T: pin.SE3, U: pin.SE3) -> float:
    """Return the distance between two poses."""
    return float(np.linalg.norm(T.translation - U.translation))


def shifted(T: pin.SE3, x_m: float = 0.0, y_m: float = 0.0, z_m: float = 0.0) -> pin.SE3:
    """Return a pose with the same orientation at a shifted position."""
    return pin.SE3(T.rotation, T.translation + np.array([x_m, y_m, z_m]))


def pose_goal(id_: int, T: pin.SE3) -> Goal:
    """A goal of kind pose."""
    return goal(id_, "pose", pose=record_of(T))
