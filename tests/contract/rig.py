"""One robot on an in-memory bus, and a stand-in for the arbiter: what the contract is tried on.

Which robots there are stands in `tests/contract/robots.py`.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

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

DEMO_CELL = Path(__file__).resolve().parents[2] / "cells" / "demo.yaml"
COMMAND_PERIOD_NS = 4_000_000
DEADLINE_S = 0.25  # long enough that a busy machine does not look like a dead arbiter
SENSOR_STAMP = Origin(123_456, 7)


class LateClock:
    """The rig's clock, as a process sees it whose messages are old when they come."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self.late_s = 0.0

    @property
    def boot(self) -> str:
        """The same clock's."""
        return self._clock.boot

    def now_ns(self) -> int:
        """Return the time a while ago."""
        return self._clock.now_ns() - round(self.late_s * NS_PER_S)

    def sleep_s(self, duration_s: float) -> None:
        """Wait."""
        self._clock.sleep_s(duration_s)


class Rig:
    """A robot, and what a test needs to command and to watch it."""

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
        self.lease = 0
        self.command: RobotCommand | None = None
        self.command_seq = 0
        self.wrench: WrenchAtTcp | None = None
        self._on_pc: PcFeedback | None = None
        self._robot = self._bus("robot")
        self.service = make(self._robot, cell)
        self._runner = Runner(self.service, [], clock)
        self._reader = self._bus("arbiter").reader(topics.ROBOT_STATE)
        self._put_wrench = self._bus("wrench").publisher(topics.WRENCH)
        self.restart_arbiter()

    def _bus(self, role: str, clock: Clock | None = None) -> Bus:
        return Bus(role, self.cell.cell, self.transport, self.cell, clock or self.clock)

    def restart_arbiter(self) -> None:
        """Go on as another process: a new epoch."""
        bus = self._bus("arbiter", self.arbiter_clock)
        self._put_command = bus.publisher(topics.ROBOT_COMMAND)
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
                if message.valid:
                    self.track.append((self.clock.now_ns() / NS_PER_S, self.T))
            if until():
                return True
        return False

    def until(self, condition: Callable[[], object], within_s: float = 10.0) -> None:
        """Let the robot live until a condition is true."""
        assert self.advance(within_s, condition), self.state

    def _arbitrate(self, now_ns: int) -> None:
        if now_ns < self._next_ns:
            return
        self._next_ns = now_ns + COMMAND_PERIOD_NS
        if self.wrench is not None:
            self._put_wrench.put(self.wrench)
        if self._on_pc is not None and self.wrench is not None:
            pose = self._on_pc.next_pose(self.wrench, now_ns)
            self.command = self._permitted("setpoint", pose=pose)
        if self.command is not None:
            self.command_seq = self._put_command.put(self.command, SENSOR_STAMP).seq

    # --- commanding -------------------------------------------------------------------------------

    def say(self, kind: str, *, host: Host = "pc", **content: Any) -> None:
        """Command this every period from now on, under the present lease."""
        self._on_pc = None
        self.command = self._permitted(kind, host, **content)

    def _permitted(self, kind: str, host: Host = "pc", **content: Any) -> RobotCommand:
        permission = Permission(host=host, lease=self.lease, deadline_s=DEADLINE_S)
        content = {"speed": Speed(mechanical_m_s=0.1)} | content
        return RobotCommand.model_validate(
            {"kind": kind, "permission": permission, "commander": "operator"} | content
        )

    def say_hold(self, reason: str = "asked to hold") -> None:
        """Command hold every period from now on."""
        self._on_pc = None
        self.command = RobotCommand(kind="hold", reason=reason)

    def silence(self) -> None:
        """Say nothing any more."""
        self._on_pc, self.command = None, None

    def push(self, force_N: Vec3 = (0.0, 0.0, 0.0), torque_Nm: Vec3 = (0.0, 0.0, 0.0)) -> None:
        """Let the environment push from now on: base axes, about the TCP."""
        self.wrench = WrenchAtTcp(force_N=force_N, torque_Nm=torque_Nm)

    def feed_back(self, mode: Mode, gains: Gains) -> None:
        """Run force feedback from now on, where this robot has it; `push` gives the wrench."""
        if self.feedback_host == "controller":
            feedback = Feedback(mode=mode, gains=gains)
            self.say("feedback", host="controller", feedback=feedback)
            wanted = (mode != "orientation", mode != "position")
            self.until(lambda: self.feedback_bits == wanted)
        elif self._on_pc is None:
            now_ns = self.clock.now_ns()
            self._on_pc = PcFeedback(self.cell, self.T, mode, gains, now_ns=now_ns)
        else:
            self._on_pc.use(gains)

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
    def T_tcp(self) -> pin.SE3:
        """Tool centre point in base, as the robot says."""
        return self.T * self.cell.tool.T_flange_tcp.pose

    @property
    def feedback_bits(self) -> tuple[bool, bool]:
        """Whether the controller says that feedback of position, of orientation runs."""
        mode = self.state.status.feedback
        return mode in ("position", "both"), mode in ("orientation", "both")

    @property
    def joint_rad(self) -> np.ndarray:
        """Joint angles, as the robot says."""
        return np.array(self.state.joint_rad)

    def fastest(self, window_s: float) -> tuple[float, float]:
        """Return the longest way [m] and turn [rad] of the flange in any window of its track."""
        ways_m, turns_rad = [0.0], [0.0]
        for at_s, T in self.track:
            later = next((seen for seen in self.track if seen[0] >= at_s + window_s - 1e-9), None)
            if later is None:
                break
            share = window_s / (later[0] - at_s)  # no report comes at the window's very end
            ways_m.append(share * float(np.linalg.norm(later[1].translation - T.translation)))
            turn_rad = np.linalg.norm(rotation_between(T.rotation, later[1].rotation))
            turns_rad.append(share * float(turn_rad))
        return max(ways_m), max(turns_rad)

    def is_at_rest(self, within_s: float = 3.0) -> bool:
        """Wait until the arm has not moved for 50 ms."""
        seen: list[np.ndarray] = []

        def rests() -> bool:
            seen.append(self.T.translation.copy())
            return len(seen) > 50 and np.ptp(np.array(seen[-50:]), axis=0).max() < 5e-5

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
    return Goal.model_validate({"id": id_, "kind": kind} | content)


def shifted(T: pin.SE3, x_m: float = 0.0, y_m: float = 0.0, z_m: float = 0.0) -> pin.SE3:
    """The same orientation somewhere else in base."""
    return pin.SE3(T.rotation, T.translation + np.array([x_m, y_m, z_m]))


def pose_goal(id_: int, T: pin.SE3) -> Goal:
    """A goal of kind pose."""
    return goal(id_, "pose", pose=record_of(T))
