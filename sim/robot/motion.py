"""Motion generator of the controller: goals with a trapezoidal speed profile, and streamed poses.

state    meaning
idle     no motion; also after a brake
running  a goal is active
braking  a goal is being stopped, along its path
done     the goal was reached
refused  a goal was aborted because its path cannot be followed; `reason` holds the cause
stream   the newest streamed pose is followed
"""

import math
from typing import Literal

import numpy as np
import pinocchio as pin

from common.motion.frames import Array, apart
from common.motion.kinematics import ArmKinematics, IkResult
from common.motion.limits import real_speed_m_s
from common.motion.paths import TURN_RADIUS_M, JointPath, LinearPath, MotionPath
from forcemesh.messages import Speed

MotionState = Literal["idle", "running", "braking", "done", "refused", "stream"]

ACCEL_M_S2 = 2.0  # at 100 percent
BRAKE_M_S2 = 2.5  # from 250 mm/s to standstill in 100 ms
STREAM_JUMP_RAD = 0.35  # largest joint change of one streamed pose
_SHRINKS = 8  # attempts to find a step that keeps the joints' speed limits
BUSY = ("running", "braking")  # states with a goal
_REFUSED_BUSY = "a goal is active: brake first"


class MotionGenerator:
    """Converts goals and streamed poses into one joint command per tick.

    Open loop: its commands do not depend on measurements of the arm. `start_*` and `setpoint`
    return an empty string, or the reason for a rejection. In the speed of a goal, rotations and
    joint angles are scaled by the radius `TURN_RADIUS_M`.
    """

    def __init__(
        self, kinematics: ArmKinematics, q_start: Array, *, stream_m_s: float = math.inf
    ) -> None:
        """Start at rest at q_start [rad], shape (n,); `speed` is for streamed poses."""
        self._kinematics = kinematics
        self._path: MotionPath | None = None
        self._speed = Speed()
        self._share, self._share_speed = 0.0, 0.0  # s and ds/dt of the path
        self.q_command: Array = np.array(q_start, dtype=float)
        self._q_stream: Array = self.q_command.copy()
        self._stream_m_s = stream_m_s
        self._stream_s = 0.0  # time left to the streamed pose, at this speed and the joints'
        self.state: MotionState = "idle"
        self.reason = ""  # why the last goal was aborted

    def reseed(self, q: Array) -> None:
        """Discard every motion and hold q [rad]. Shape (n,)."""
        self.q_command = np.array(q, dtype=float)
        self._path, self.state, self.reason = None, "idle", ""

    def start_pose(self, T_base_flange: pin.SE3, speed: Speed) -> str:
        """Start a linear motion of the flange with uniform rotation about one axis."""
        if self.state in BUSY:
            return _REFUSED_BUSY
        if not np.isfinite(T_base_flange.homogeneous).all():
            return "the pose contains a number that is not finite"
        path = LinearPath(self._kinematics, self.q_command, T_base_flange)
        return path.obstacle(self.q_command) or self._start(path, speed)

    def start_joints(self, q_goal: Array, speed: Speed) -> str:
        """Start a synchronised motion to joint angles [rad]. Shape (n,)."""
        if self.state in BUSY:
            return _REFUSED_BUSY
        goal = np.array(q_goal, dtype=float)
        if not np.isfinite(goal).all():
            return "the joint goal contains a number that is not finite"
        violation = self._kinematics.limit_violation(goal)
        return violation or self._start(JointPath(self._kinematics, self.q_command, goal), speed)

    def setpoint(self, T_base_flange: pin.SE3) -> str:
        """Follow a streamed pose from the next tick on; it replaces an older one."""
        result = self.solved(T_base_flange)
        if result.q is not None:
            self.follow(T_base_flange, result.q)
        return result.reason

    def solved(self, T_base_flange: pin.SE3) -> IkResult:
        """Return the joint angles of a streamed pose, or why it cannot be followed."""
        if self.state in BUSY:
            return IkResult(None, _REFUSED_BUSY)
        return self._kinematics.solve(T_base_flange, self.q_command, jump_rad=STREAM_JUMP_RAD)

    def follow(self, T_base_flange: pin.SE3, q: Array) -> None:
        """Follow a streamed pose, whose joint angles were found, from the next tick on."""
        self._q_stream, self.state, self.reason = q, "stream", ""
        travel_m, turn_rad = apart(self._kinematics.flange_pose(self.q_command), T_base_flange)
        self._stream_s = max(
            self._kinematics.full_speed_s(q - self.q_command),
            max(travel_m, TURN_RADIUS_M * turn_rad) / self._stream_m_s,
        )

    def brake(self) -> None:
        """Stop: a goal along its path; a stream ramps down unless its last pose is reached."""
        if self.state == "running":
            self.state = "braking"
        elif self.state == "stream":
            self.state = "idle"
            if self._stream_s > 1e-9:
                path = JointPath(self._kinematics, self.q_command, self._q_stream)
                self._start(path, self._speed)
                self._share_speed = 1.0 / self._stream_s
                self.state = "braking"

    def tick(self, dt_s: float) -> Array:
        """Advance by one tick and return the joint command [rad], read-only; the same one at rest.

        Shape (n,).
        """
        if self.state in BUSY:
            self._follow(dt_s)
        elif self.state == "stream" and self._stream_s > 0.0:
            if self._stream_s <= dt_s:
                self.q_command, self._stream_s = self._q_stream, 0.0
            else:
                travel = self._q_stream - self.q_command
                self.q_command = self.q_command + dt_s / self._stream_s * travel
                self._stream_s -= dt_s
        self.q_command.setflags(write=False)
        return self.q_command

    def _start(self, path: MotionPath, speed: Speed) -> str:
        self._path, self._speed = path, speed
        self._share, self._share_speed = 0.0, 0.0
        self.state, self.reason = "running", ""
        return ""

    def _follow(self, dt_s: float) -> None:
        assert self._path is not None  # noqa: S101 - a busy state has one
        self._share_speed = self._next_share_speed(self._path.extent_m, dt_s)
        step = self._share_speed * dt_s
        share, result = step_along(self._path, self._share, self.q_command, step=step, dt_s=dt_s)
        if result.q is None:
            self.reason = f"after {100 * share:.0f} % of the path: {result.reason}"
            self.state, self._share_speed = "refused", 0.0
            return
        self._share_speed = (share - self._share) / dt_s
        self._share, self.q_command = share, result.q
        if share >= 1.0:
            self.state = "done"
        elif self.state == "braking" and self._share_speed <= 0.0:
            self.state = "idle"

    def _next_share_speed(self, extent_m: float, dt_s: float) -> float:
        """Return ds/dt of this tick: trapezoid, or deceleration of a brake."""
        scale = 1.0 / max(extent_m, 1e-6)
        if self.state == "braking":
            return max(0.0, self._share_speed - BRAKE_M_S2 * scale * dt_s)
        decel = self._speed.decel_fraction * ACCEL_M_S2 * scale
        accel = self._speed.accel_fraction * ACCEL_M_S2 * scale
        # Discrete braking speed: steps of dt, each slower by decel * dt, end exactly at the goal.
        half = 0.5 * decel * dt_s
        stopping = math.sqrt(half * half + 2.0 * decel * (1.0 - self._share)) - half
        faster = self._share_speed + accel * dt_s
        return min(faster, real_speed_m_s(self._speed) * scale, max(stopping, half))


def step_along(
    path: MotionPath, share: float, q: Array, *, step: float, dt_s: float
) -> tuple[float, IkResult]:
    """Return share and joints after one tick: `step` shortened to the joints' speed limits.

    If the path cannot be continued: the share that was tried last, and the reason.
    """
    reason, reached = "", share
    for _ in range(_SHRINKS):
        reached = min(1.0, share + step)
        if reached > 1.0 - 1e-9:
            reached = 1.0
        result = path.at(reached, q)
        if result.q is None:
            reason, step = result.reason, 0.25 * step
            continue
        excess = path.kinematics.full_speed_s(result.q - q) / dt_s
        if excess <= 1.0 + 1e-9:
            return reached, result
        reason = "joint speed limit exceeded"
        step /= 1.05 * excess
    return reached, IkResult(None, reason)
