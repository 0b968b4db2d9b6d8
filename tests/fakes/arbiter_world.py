"""An arbiter without bus or clock, with all its inputs for a test to change one by one."""

from dataclasses import dataclass, field
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from common.config.cell import CellConfig
from common.config.load import cell_hash, load_cell
from common.motion.convert import pose_of, record_of
from common.motion.frames import Oat, R_from_oat, rotation_from_vector
from forcemesh import topics
from forcemesh.bus import Reading
from forcemesh.codec import Header
from forcemesh.faults import FAULTS, tripped
from forcemesh.messages import (
    MAY_MOVE,
    Health,
    Message,
    PoseRecord,
    RegulatorTarget,
    RobotCommand,
    RobotState,
    RobotStatus,
    SensorWrench,
    WrenchAtTcp,
)
from forcemesh.requests import MoveRequest
from forcemesh.version import __version__
from services.arbiter.core import Arbiter
from services.arbiter.inputs import Inputs
from services.arbiter.monitors import InputMonitors

CELL = load_cell(Path(__file__).resolve().parents[2] / "cells" / "demo.yaml")
ROLES = [role for role in topics.ROLES if role != "arbiter"]
PERIOD_NS = 4_000_000
LONG_PERIOD_NS = 20_000_000
DEADLINE_S = 0.04
FIT = RobotStatus(ready=True)
ROBOT_FAULTS = (
    "robot_motors", "robot_teach", "robot_lock", "robot_program", "robot_latched", "robot_error",
)  # fmt: skip
T_START = pin.SE3(R_from_oat(Oat(0.0, pi, 0.0)), np.array([0.0, 0.5, 0.35]))  # flange, tool down
FREE = WrenchAtTcp(calibrated=True, axes_checked=True)  # nothing touches the tool
STOPPED = RegulatorTarget(valid=False, reason="stopped")
CHALLENGE = 4242  # of a robot that has known no arbiter
SPOILED = "spoiled: 123 ms old, limit 100 ms"


def good_messages(cell: CellConfig) -> dict[str, Message]:
    """Return the inputs of a faultless cell without requests."""
    start = record_of(T_START)
    robot = RobotState(
        joint_rad=(0.0,) * 6,
        position_m=start.position_m,
        orientation_xyzw=start.orientation_xyzw,
        status=FIT,
        challenge=CHALLENGE,
    )
    health = Health(config_hash=cell_hash(cell), version=__version__)
    messages: dict[str, Message] = {
        "robot": robot, "sensor": SensorWrench(), "wrench": FREE, "target": STOPPED
    }  # fmt: skip
    return messages | {f"{role}/health": health for role in ROLES}


def with_fault(code: str) -> RobotStatus:
    """Return the status of a robot that one fault prevents from moving."""
    return RobotStatus(faults=(tripped(code, FAULTS[code].cause),))


@dataclass
class World:
    """The arbiter and its surroundings."""

    cell: CellConfig = CELL
    now_ns: int = 1_000_000_000
    silent: set[str] = field(default_factory=set)
    epochs: dict[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Start the arbiter in a faultless cell."""
        self.core = Arbiter(self.cell, command_deadline_s=DEADLINE_S)
        self.watch = InputMonitors(self.cell)
        self.messages = good_messages(self.cell)

    # --- surroundings -----------------------------------------------------------------------------

    def change(self, name: str, **changes: Any) -> None:
        """Change fields of one input."""
        self.messages[name] = self.messages[name].replaced(**changes)

    def place(self, T_base_flange: pin.SE3) -> None:
        """Set the pose of the flange."""
        record = record_of(T_base_flange)
        self.change("robot", position_m=record.position_m, orientation_xyzw=record.orientation_xyzw)

    def propose(self, pose: PoseRecord | None, **changes: Any) -> None:
        """Publish a flange pose as target of the regulator."""
        self.messages["target"] = RegulatorTarget(mode="position", pose=pose, **changes)

    def reading(self, name: str) -> Reading[Any]:
        """Return one input with its verdict, as a reader does."""
        message = self.messages[name]
        if isinstance(message, RobotState) and message.challenge == CHALLENGE:
            # Drawn after each lease and reported at once, unless a test has set another one.
            leases = self.core.status().lease + (self.core.state not in MAY_MOVE)
            message = message.replaced(challenge=CHALLENGE + leases)
        header = Header(seq=1, epoch=self.epochs.get(name, 1), boot="virtual", stamp_ns=self.now_ns)
        if name in self.silent:
            return Reading(message, header, 0.123, f"{name} {SPOILED}", silent=True, code="stale")
        fault = "" if message.valid else f"{name} invalid: {message.reason}"
        return Reading(
            message, header, 0.0, fault, code=(message.code or "invalid") if fault else ""
        )

    def inputs(self) -> Inputs:
        """Return the snapshot for the arbiter."""
        snapshot = Inputs(
            now_ns=self.now_ns,
            robot=self.reading("robot"),
            sensor=self.reading("sensor"),
            wrench=self.reading("wrench"),
            target=self.reading("target"),
            health={role: self.reading(f"{role}/health") for role in ROLES},
        )
        self.watch.update(snapshot)
        return snapshot

    # --- the arbiter ------------------------------------------------------------------------------

    def tick(self, times: int = 1, *, period_ns: int = PERIOD_NS) -> RobotCommand:
        """Advance by periods; return the last command."""
        for _ in range(times - 1):
            self.tick(period_ns=period_ns)
        self.now_ns += period_ns
        return self.core.tick(self.inputs())

    def pass_s(self, duration_s: float) -> RobotCommand:
        """Advance by a time, in long periods to save computation."""
        return self.tick(round(duration_s * 1e9) // LONG_PERIOD_NS, period_ns=LONG_PERIOD_NS)

    def make_ready(self) -> "World":
        """Wait out the preflight."""
        self.pass_s(1.1)
        assert self.core.state == "IDLE"
        return self

    def make_armed(self) -> "World":
        """Arm and wait until the robot accepts."""
        self.make_ready()
        assert self.core.arm(self.inputs()).accepted
        self.pass_s(0.5)
        assert self.core.state == "ARMED"
        return self

    def make_active(self, commander: str) -> "World":
        """Arm and let a commander move."""
        return self.make_armed().activate(commander)

    def activate(self, commander: str) -> "World":
        """Let a commander move an armed arm."""
        if commander == "operator":
            assert self.core.move(MOVE_DOWN, self.inputs()).accepted
        else:
            self.propose(record_of(T_START))
        self.tick()
        assert (self.core.state, self.core.status().commander) == ("ACTIVE", commander)
        return self

    def report_goal(self, state: str, **changes: Any) -> None:
        """Let the robot report on its last goal."""
        command = self.core.tick(self.inputs())
        assert command.goal is not None
        robot = self.messages["robot"]
        assert isinstance(robot, RobotState)
        report = robot.goal.replaced(**({"id": command.goal.id, "state": state} | changes))
        self.change("robot", goal=report)


def with_limits(**limits: float) -> World:
    """Return a world with changed limits of the cell."""
    changed = CELL.limits.model_copy(update=limits)
    return World(CELL.model_copy(update={"limits": changed}))


def shifted(x_m: float = 0.0, y_m: float = 0.0, z_m: float = 0.0) -> PoseRecord:
    """Return a flange pose shifted from the start, same orientation."""
    return record_of(pin.SE3(T_START.rotation, T_START.translation + np.array([x_m, y_m, z_m])))


def pose_at(p: Any, turn: Any = (0.0, 0.0, 0.0)) -> pin.SE3:
    """Return the pose at a place [m], turned by a rotation vector [rad]."""
    return pin.SE3(rotation_from_vector(np.array(turn)), np.array(p, dtype=float))


def displaced(kind: int, amount: float) -> pin.SE3:
    """Return a pose so far [m] in x, or, for kind 1, turned by so much [rad] about z."""
    return pose_at((amount * (1 - kind), 0.0, 0.0), (0.0, 0.0, amount * kind))


def distance_m(a: PoseRecord | None, b: PoseRecord | RobotState) -> float:
    """Return the distance between two poses."""
    assert a is not None
    return float(np.linalg.norm(pose_of(a).translation - pose_of(b).translation))


MOVE_DOWN = MoveRequest(kind="pose", pose=shifted(z_m=-0.05))
MOVE_JOINTS = MoveRequest(kind="joints", joint_rad=(0.0, 0.0, -1.5, 0.0, -1.5, 0.0))
