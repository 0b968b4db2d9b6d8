"""Arm as seen by AS: motor power, BASE and TOOL, current pose and destination.

Internal units: metres, radians, `pin.SE3`, in the robot's own base frame (the simulation's). A pose
of a program is the TOOL frame in the BASE frame, T_base_shift_tcp here.
"""

import numpy as np
import pinocchio as pin

from common.motion.frames import Array
from common.motion.kinematics import IkResult
from sim.as_language.errors import AsError
from sim.controller.motion_queue import MotionQueue, Ticket
from sim.controller.motion_requests import MotionRequest
from sim.controller.planner import inverse
from sim.robot.arm import SimArm
from sim.robot.settings import TICK_S

_STANDING_RAD = 2e-5  # of every joint: the arm has reached its command
_SETTLED_TICKS = 500  # limit for an arm that vibrates in contact


class Robot:
    """Simulated arm with its motion queue; stepped every millisecond."""

    def __init__(self, arm: SimArm) -> None:
        """Connect to an arm at rest."""
        self.arm = arm
        self.kinematics = arm.kinematics
        self.queue = MotionQueue(arm.kinematics, arm.q)
        self.T_base_shift = pin.SE3.Identity()  # BASE
        self.T_flange_tcp = pin.SE3.Identity()  # TOOL
        self.motor_power = True
        self._arrived_at = -1
        self._arrived = True
        self._commanded_at = -_SETTLED_TICKS  # tick of the last change of the command

    # --- position ---------------------------------------------------------------------------------

    @property
    def q(self) -> Array:
        """Joint angles of the encoders [rad]. Shape (6,)."""
        return self.arm.q

    def here(self) -> pin.SE3:
        """Return the TOOL's pose in BASE, from the encoders."""
        return self.pose_of(self.arm.q)

    def destination(self) -> pin.SE3:
        """Return the TOOL's pose in BASE at the end of the newest motion, or at rest."""
        return self.pose_of(self.q_destination())

    def q_destination(self) -> Array:
        """Return the joint angles at the end of the newest motion [rad]. Shape (6,)."""
        return self.queue.q_end

    def pose_of(self, q: Array) -> pin.SE3:
        """Return the TOOL's pose in BASE at joint angles [rad]."""
        T_base_tcp = self.kinematics.flange_pose(q) * self.T_flange_tcp
        return self.T_base_shift.actInv(T_base_tcp)

    def joints_of(self, T_shift_tcp: pin.SE3, q_near: Array) -> IkResult:
        """Return the joint angles for a program's pose, near `q_near`."""
        T_base_flange = self.T_base_shift * T_shift_tcp * self.T_flange_tcp.inverse()
        return inverse(self.kinematics, T_base_flange, q_near)

    # --- motion -----------------------------------------------------------------------------------

    @property
    def arrived(self) -> bool:
        """Whether the arm has reached its last command, within the motion's ACCURACY."""
        if self._arrived_at != self.arm.ticks:
            self._arrived_at = self.arm.ticks
            self._arrived = not self.queue.is_moving and self._is_near()
        return self._arrived and not self.queue.is_moving

    @property
    def moving(self) -> bool:
        """Whether a motion is active or queued, or the arm is not at rest."""
        return self.queue.busy or not self.at_rest

    @property
    def at_rest(self) -> bool:
        """Whether command and arm are at rest; at the latest 0.5 s after the command."""
        if self.queue.is_moving:
            return False
        arm = self.arm
        still = not arm.moving or np.abs(arm.q - self.queue.q_command).max() < _STANDING_RAD
        return bool(still) or arm.ticks - self._commanded_at > _SETTLED_TICKS

    def move(self, motion: MotionRequest) -> Ticket:
        """Queue a motion. Raises AsError: P1000, E6007, E6008, E6016."""
        if not self.motor_power:
            raise AsError("P1000")
        return self.queue.offer(motion, arrived=self.arrived)

    def power(self, *, on: bool) -> None:
        """Switch the motors; off: active motions are braked and discarded."""
        if on and not self.motor_power:
            self.queue.reseed(self.arm.q)
        elif not on:
            self.queue.brake(keep_ahead=False)
        self.motor_power = on

    def tick(self) -> None:
        """Advance by one millisecond. Raises AsError if a motion cannot be continued."""
        try:
            waits = self.queue.ahead is not None and not self.queue.is_moving
            self.queue.tick(TICK_S, arrived=waits and self.arrived)
        except AsError:
            self.queue.fail()
            raise
        finally:
            if self.queue.is_moving:
                self._commanded_at = self.arm.ticks
            command = self.queue.q_command
            command.setflags(write=False)
            self.arm.command_joints(command)
            self.arm.step()

    def _is_near(self) -> bool:
        if self.at_rest:
            return True
        q, command = self.arm.q, self.queue.q_command
        last = self.queue.last
        accuracy_m = 0.001 if last is None else last.manner.accuracy_m
        off = self.pose_of(q).translation - self.pose_of(command).translation
        return float(np.linalg.norm(off)) <= accuracy_m
