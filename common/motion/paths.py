"""Path geometry of the controller's motions: path parameter s in 0..1 to joint angles."""

import math
from typing import Protocol

import numpy as np
import pinocchio as pin

from common.motion.frames import Array, apart, interpolated
from common.motion.kinematics import ArmKinematics, IkResult

TURN_RADIUS_M = 0.24  # scales rotation to translation: 0.25 m/s corresponds to 60 deg/s
_SAMPLE_M = 0.01  # sampling of a linear path for the check before it starts
_SAMPLES = (8, 200)
_FINEST_SHARE = 1e-3
_JUMP_RAD = 0.6  # largest joint change between two samples, thus also between two ticks


class MotionPath(Protocol):
    """Path: joint angles as a function of the path parameter."""

    kinematics: ArmKinematics
    extent_m: float  # largest speed on the path when s runs from 0 to 1 in 1 s [m/s]

    def at(self, share: float, q_near: Array) -> IkResult:
        """Return the joint angles at path parameter `share`, on the branch of q_near."""


class JointPath:
    """Synchronised joint path: all joints start and arrive together."""

    def __init__(self, kinematics: ArmKinematics, q_from: Array, q_to: Array) -> None:
        self._from, self._travel = q_from.copy(), q_to - q_from
        self.kinematics = kinematics
        fastest_m = max(
            math.hypot(*(kinematics.jacobian(self._q(s)) @ self._travel)[:3])
            for s in np.linspace(0.0, 1.0, 21)
        )
        self.extent_m = max(fastest_m, TURN_RADIUS_M * float(abs(self._travel).max()))

    def at(self, share: float, q_near: Array) -> IkResult:  # noqa: ARG002 - one shape for all paths
        """Return the joint angles at path parameter `share`."""
        return IkResult(self._q(share))

    def _q(self, share: float) -> Array:
        return self._from + share * self._travel


class LinearPath:
    """Linear path of the flange with uniform rotation about one fixed axis (log3)."""

    def __init__(self, kinematics: ArmKinematics, q_from: Array, T_goal: pin.SE3) -> None:
        self.kinematics = kinematics
        self._T_from, self._T_goal = kinematics.flange_pose(q_from), T_goal
        travel_m, turn_rad = apart(self._T_from, T_goal)
        self.extent_m = max(travel_m, TURN_RADIUS_M * turn_rad)

    def at(self, share: float, q_near: Array) -> IkResult:
        """Return the joint angles at path parameter `share`, on the branch of q_near."""
        T = interpolated(self._T_from, self._T_goal, share)
        return self.kinematics.solve(T, q_near, jump_rad=_JUMP_RAD)

    def obstacle(self, q_from: Array) -> str:
        """Check the whole path; return why it cannot be followed, or an empty string."""
        count = min(max(_SAMPLES[0], math.ceil(self.extent_m / _SAMPLE_M)), _SAMPLES[1])
        q = q_from
        for k in range(count):
            result = self._walk(k / count, (k + 1) / count, q)
            if result.q is None:
                return f"after {100 * (k + 1) // count} % of the path: {result.reason}"
            q = result.q
        return ""

    def _walk(self, share: float, to_share: float, q: Array) -> IkResult:
        """Follow the path from one parameter to another, bisecting where joints turn fast."""
        result = self.at(to_share, q)
        if result.q is not None or to_share - share < _FINEST_SHARE:
            return result
        middle = 0.5 * (share + to_share)
        first = self._walk(share, middle, q)
        return first if first.q is None else self._walk(middle, to_share, first.q)
