"""Control law of the fake controller's force feedback: commands 4, 6, 10 and 11 in SI units.

Written from the specification and the packet's table, not from the shipped program.
"""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from common.motion.frames import rotate_about_base_axes

LEVER_M_PER_RAD = 0.1  # equivalent travel of a rotation where a speed is limited


@dataclass(frozen=True, slots=True)
class KeptLimits:
    """Command 10."""

    step_m: float
    step_rad: float
    speed_m_s: float
    travel_m: float
    force_N: float
    torque_Nm: float


class PiFeedback:
    """One run of force feedback."""

    def __init__(self, T_base_flange: pin.SE3, T_flange_tcp: pin.SE3) -> None:
        self._T_flange_tcp = T_flange_tcp
        self._start = T_base_flange * T_flange_tcp
        self._T_base_tcp = self._start.copy()
        self._before: np.ndarray | None = None
        self._at_s = 0.0

    def next_flange(
        self,
        wrench: np.ndarray,
        error: np.ndarray,
        gains_p: np.ndarray,
        gains_i: np.ndarray,
        *,
        limits: KeptLimits,
        now_s: float,
    ) -> pin.SE3 | None:
        """Return the flange's next pose, or None when a limit ends the run.

        Wrench and error (wrench minus its set point) are in N and N m, of shape (6,); the part of
        the error that is not controlled is zero.
        """
        if self._before is None:  # no previous error: no proportional kick
            self._before, self._at_s = error, now_s
        dt_s = now_s - self._at_s
        travel = gains_p * (error - self._before) + gains_i * error * dt_s
        self._before, self._at_s = error, now_s
        step_travel_m = _at_most(travel[:3], min(limits.step_m, limits.speed_m_s * dt_s))
        turn_rad = _at_most(
            travel[3:], min(limits.step_rad, limits.speed_m_s * dt_s / LEVER_M_PER_RAD)
        )
        R = rotate_about_base_axes(self._T_base_tcp.rotation, turn_rad)
        self._T_base_tcp = pin.SE3(R, self._T_base_tcp.translation + step_travel_m)
        travelled_m = np.linalg.norm(self._T_base_tcp.translation - self._start.translation)
        is_over = (
            np.linalg.norm(wrench[:3]) > limits.force_N
            or np.linalg.norm(wrench[3:]) > limits.torque_Nm
        )
        if travelled_m > limits.travel_m or is_over:
            return None
        return self._T_base_tcp * self._T_flange_tcp.inverse()


def _at_most(vector: np.ndarray, longest: float) -> np.ndarray:
    length = float(np.linalg.norm(vector))
    return vector if length <= longest else vector * (longest / length)
