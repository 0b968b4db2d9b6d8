"""Linear path of the tool centre point, for any TOOL. Joint paths are in common.motion.paths."""

import math

import numpy as np
import pinocchio as pin

from common.motion.frames import rotation_between, rotation_from_vector
from common.motion.kinematics import ArmKinematics, IkResult
from common.motion.paths import TURN_RADIUS_M

JUMP_RAD = 0.6  # between two samples; a larger change means another kinematic branch
_SAMPLE_M = 0.01
_SAMPLES = (4, 200)


class TcpLine:
    """Linear TCP path with uniform rotation about one fixed axis; path parameter in 0..1."""

    def __init__(
        self, kinematics: ArmKinematics, *, T_flange_tcp: pin.SE3, T_from: pin.SE3, T_to: pin.SE3
    ) -> None:
        """Set the TCP's pose at both ends, in the robot's base frame."""
        self._kinematics = kinematics
        self._T_tcp_flange = T_flange_tcp.inverse()
        self._from, self._to = T_from, T_to
        self._travel_m = T_to.translation - T_from.translation
        self._rotation = rotation_between(T_from.rotation, T_to.rotation)
        self.travel_m = float(np.linalg.norm(self._travel_m))
        self.extent_m = max(self.travel_m, TURN_RADIUS_M * float(np.linalg.norm(self._rotation)))

    def tcp(self, share: float) -> pin.SE3:
        """Return T_base_tcp at path parameter `share`; the end is exact."""
        if share >= 1.0:
            return self._to
        return pin.SE3(
            rotation_from_vector(share * self._rotation) @ self._from.rotation,
            self._from.translation + share * self._travel_m,
        )

    def at(self, share: float, q_near: np.ndarray) -> IkResult:
        """Return the joint angles at path parameter `share`, on the branch of q_near."""
        T_base_flange = self.tcp(share) * self._T_tcp_flange
        return self._kinematics.solve(T_base_flange, q_near, jump_rad=JUMP_RAD)

    def walk(self, q_from: np.ndarray) -> IkResult:
        """Check the whole path; return the joints at its end, or why it cannot be followed."""
        count = min(max(_SAMPLES[0], math.ceil(self.extent_m / _SAMPLE_M)), _SAMPLES[1])
        q = q_from
        for k in range(1, count + 1):
            result = self.at(k / count, q)
            if result.q is None:
                return IkResult(None, f"after {100 * k // count} % of the path: {result.reason}")
            q = result.q
        return IkResult(q)
