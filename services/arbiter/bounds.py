"""Limits of the arm since it was armed, and the check of the measured arm against them. Pure."""

from dataclasses import dataclass
from math import radians

import pinocchio as pin

from common.motion.convert import pose_of
from common.motion.limits import (
    Limits,
    check_joint_speed,
    check_joints,
    check_tether,
    check_workspace,
    check_wrench,
)
from common.motion.rate_limiter import JointTrack
from forcemesh.messages import RobotState, Trip, WrenchAtTcp

MEASURED_SLACK_RAD = radians(0.5)  # measurement tolerance of an arm at rest on a joint limit


@dataclass(frozen=True, slots=True)
class ArmBounds:
    """Limits of the cell, with the pose at arming as the tether's origin."""

    limits: Limits
    T_flange_tcp: pin.SE3
    T_armed: pin.SE3  # flange in base

    def place(self, T_base_flange: pin.SE3) -> Trip | None:
        """Check a flange pose: its TCP in the workspace, the flange within the tether."""
        trip = check_workspace(self.limits, T_base_flange * self.T_flange_tcp)
        return trip or check_tether(self.limits, self.T_armed, T_base_flange)

    def measured(
        self, robot: RobotState, wrench: WrenchAtTcp | None, joints: JointTrack
    ) -> Trip | None:
        """Check the measured arm: load (if known), pose, joint angles and joint speeds.

        Joint moves have no end pose that could be checked before, so the measured pose is checked.
        """
        speed_rad_s = joints.speed_rad_s
        return (
            self._load(wrench)
            or self.place(pose_of(robot))
            or check_joints(self.limits, robot.joint_rad, slack_rad=MEASURED_SLACK_RAD)
            or (None if speed_rad_s is None else check_joint_speed(self.limits, speed_rad_s))
        )

    def _load(self, wrench: WrenchAtTcp | None) -> Trip | None:
        if wrench is None:
            return None
        return check_wrench(self.limits, wrench.force_N, wrench.torque_Nm)
