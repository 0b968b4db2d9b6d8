"""The regulator on an in-memory bus between a wrench, a robot and an arbiter."""

from typing import Any

import numpy as np
import pinocchio as pin

from common.config.cell import CellConfig
from common.motion.convert import pose_of
from common.motion.frames import rotation_between
from control.gain_rule import tune
from forcemesh import topics
from forcemesh.bus import Origin
from forcemesh.messages import (
    ArbiterStatus,
    Message,
    RegulatorTarget,
    RobotCommand,
    RobotState,
    WrenchAtTcp,
)
from forcemesh.requests import ForceStartRequest, Reply
from services.regulator.service import Regulator
from tests.fakes.arbiter_world import good_messages
from tests.fakes.bench import CELL, Bench

T_FLANGE_TCP = CELL.tool.T_flange_tcp.pose
POSITION = ForceStartRequest(mode="position")
BOTH_HOSTS = CELL.model_copy(
    update={"robot": CELL.robot.model_copy(update={"hosts": ("pc", "controller")})}
)
PERIOD_S = 1.0 / CELL.rates.control_hz
KI = tune(CELL).force_i_m_per_Ns


class RegulatorBench(Bench):
    """The regulator between a wrench, a robot and an arbiter that tests can change."""

    def __init__(self, cell: CellConfig = CELL) -> None:
        """Start armed, free of contact, with every process running."""
        super().__init__("regulator", Regulator, cell)
        self.wrench = WrenchAtTcp(calibrated=True, axes_checked=True, torques_checked=True)
        self.arbiter = ArbiterStatus(state="ARMED", lease=3)
        self.robot = good_messages(CELL)["robot"]
        self.command = RobotCommand(kind="idle")
        self.silent: set[str] = set()
        self.origin = Origin(77, 8)  # a new sample each period
        self.before_step = self._publish_all
        self.out = self.watch(topics.REGULATOR_TARGET)

    def _publish_all(self) -> None:
        messages: tuple[tuple[topics.Topic[Any], Message], ...] = (
            (topics.WRENCH, self.wrench),
            (topics.ARBITER_STATUS, self.arbiter),
            (topics.ROBOT_STATE, self.robot),
            (topics.ROBOT_COMMAND, self.command),
        )
        if topics.SENSOR_WRENCH.key not in self.silent:
            self.origin = Origin(self.origin.stamp_ns + 4_000_000, self.origin.seq + 1)
        for topic, message in messages:
            if topic.key not in self.silent:
                self.put(topic, message, self.origin if topic is topics.WRENCH else None)

    def push(self, force_N=(0.0, 0.0, 0.0), torque_Nm=(0.0, 0.0, 0.0)) -> None:
        """Apply a force of the environment from now on."""
        self.wrench = self.wrench.replaced(force_N=force_N, torque_Nm=torque_Nm)

    def start(self, request: ForceStartRequest = POSITION) -> Reply:
        """Send a request to start force feedback."""
        return self.ask(topics.FORCE_START, request)

    def published(self) -> RegulatorTarget:
        """Return the newest target."""
        target: RegulatorTarget = self.newest(topics.REGULATOR_TARGET)
        return target

    def T_base_tcp(self) -> pin.SE3:
        """Return the proposed pose of the TCP."""
        record = self.published().pose
        assert record is not None
        return pose_of(record) * T_FLANGE_TCP


class FollowingBench(RegulatorBench):
    """A regulator whose arm is at every commanded pose at once; it records each step."""

    def __init__(self, cell: CellConfig = CELL) -> None:
        """Start armed."""
        super().__init__(cell)
        self.robot: RobotState
        self.poses = [pose_of(self.robot) * T_FLANGE_TCP]
        self.steps_m: list[float] = []
        self.steps_rad: list[float] = []
        self.pass_s(0.1)

    def step(self, times: int = 1) -> None:
        """Let periods pass; the arm follows in each."""
        for _ in range(times):
            super().step()
            self.follow()

    def follow(self) -> None:
        """Move the arm to the newest target and record the step."""
        target = self.published()
        if not target.valid or target.pose is None:
            return
        self.robot = self.robot.replaced(**target.pose.as_dict())
        self.poses.append(pose_of(target.pose) * T_FLANGE_TCP)
        before, after = self.poses[-2:]
        self.steps_m.append(float(np.linalg.norm(after.translation - before.translation)))
        turn = rotation_between(before.rotation, after.rotation)
        self.steps_rad.append(float(np.linalg.norm(turn)))

    @property
    def p_tcp_m(self) -> np.ndarray:
        """Position of the TCP."""
        return self.poses[-1].translation.copy()


def assert_stopped(bench: RegulatorBench, reason: str) -> None:
    """Assert that the target is invalid, with the reason, without mode and pose."""
    target = bench.published()
    assert (target.valid, target.mode, target.pose) == (False, None, None)
    assert reason in target.reason
