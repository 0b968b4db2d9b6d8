"""Contact whose stiffness is diagonal in none of the frames: a tool held in a skewed bushing.

In place of the plate of a simulated arm. T is the relaxation time, K positive definite:

    (F, M) = -K (x + T v),    K = A^T diag(k) A
"""

from typing import Any

import numpy as np
import pinocchio as pin

from sim.robot.arm import SimArm

RELAXATION_S = 0.003


class CoupledContact:
    """Bushing around the disc; it has the interface of `PlateContact`."""

    def __init__(self, arm: SimArm, K: np.ndarray) -> None:
        """Put it on at the present pose, without load; K in base axes about the TCP, (6, 6)."""
        self.K, self._arm, self._body = K, arm, arm.model.body("disc").id
        self.point_m, self.normal = arm.plate.point_m - 1.0, arm.plate.normal  # far below
        self.springs: Any = arm.plate.springs
        self._p_m = arm.data.xpos[self._body].copy()
        self._R = arm.data.xmat[self._body].reshape(3, 3).copy()

    def shift(self, travel_m: np.ndarray, turn_rad: np.ndarray) -> None:
        """Move the bushing, which loads the tool. Base axes, shapes (3,)."""
        self._p_m, self._R = self._p_m + travel_m, pin.exp3(turn_rad) @ self._R

    def lift_off_m(self, _: pin.SE3) -> float:
        """Return zero: a bushing never lets go of the tool."""
        return 0.0

    def act(self) -> None:
        """Apply the wrench to the disc for the model's next time step."""
        data = self._arm.data
        R, p = data.xmat[self._body].reshape(3, 3), data.xpos[self._body]
        *_, speed_m_s, turn_rad_s = data.sensordata[6:].reshape(4, 3)  # rows as in `scene.SENSORS`
        deviation = np.concatenate((p - self._p_m, pin.log3(R @ self._R.T)))
        rate = np.concatenate((speed_m_s, turn_rad_s))
        data.xfrc_applied[self._body] = -self.K @ (deviation + RELAXATION_S * rate)


def skewed_stiffness(
    rng: np.random.Generator, k_N_m: tuple[float, ...], k_Nm_rad: tuple[float, ...]
) -> np.ndarray:
    """Return a stiffness in random axes about a random point. Shape (6, 6), base axes."""
    along, about = (pin.Quaternion(rng.normal(size=4)).normalized().matrix() for _ in range(2))
    K, A = np.zeros((6, 6)), np.eye(6)
    K[:3, :3] = along @ np.diag(k_N_m) @ along.T
    K[3:, 3:] = about @ np.diag(k_Nm_rad) @ about.T
    A[:3, 3:] = -pin.skew(rng.uniform(-0.01, 0.01, 3))  # the centre of stiffness is not the TCP
    return A.T @ K @ A
