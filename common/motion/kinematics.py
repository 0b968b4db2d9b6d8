"""Forward and inverse kinematics of the arm. Errors are returned, not raised."""

import math
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin

from common.motion.frames import Array, is_finite_pose

MODEL_PATH = Path(__file__).resolve().parents[2] / "arms" / "rs007l" / "rs007l.xml"
JOINTS = 6
MAX_SPEED_RAD_S = np.radians([370.0, 310.0, 410.0, 550.0, 550.0, 1000.0])  # vendor's datasheet
MAX_SPEED_RAD_S.setflags(write=False)

_TOLERANCE = 1e-10  # of log6, m and rad together
_MAX_ITERATIONS = 40
_MAX_STEP_RAD = 0.3  # of one Newton step: keeps the iteration from diverging at a far start
_DAMPING = 0.1  # times the error: vanishes at the solution and keeps quadratic convergence
_LEAST_DAMPING = 1e-7
_LOCAL = pin.ReferenceFrame.LOCAL


@dataclass(frozen=True, slots=True)
class IkResult:
    """Joint angles [rad], or the reason why the pose has no solution."""

    q: Array | None
    reason: str = ""


@cache
def _model() -> pin.Model:
    """Return the arm's geometry, read once and shared: it is read-only."""
    return pin.buildModelFromMJCF(str(MODEL_PATH))


class ArmKinematics:
    """Kinematics of the RS007L, read from the same model file as the physics."""

    def __init__(self) -> None:
        """Read limits, frames and reach from the model. Raises only if the file is damaged."""
        self.model = _model()
        self.lower_rad: Array = np.array(self.model.lowerPositionLimit)
        self.upper_rad: Array = np.array(self.model.upperPositionLimit)
        self._limits = (self.lower_rad.tolist(), self.upper_rad.tolist())
        arm = self.model.jointPlacements
        self.reach_m = float(sum(np.linalg.norm(arm[joint].translation) for joint in (3, 4, 5)))
        self._data = self.model.createData()
        self._flange = self.model.getFrameId("flange")

    def flange_pose(self, q: Array) -> pin.SE3:
        """Return T_base_flange at joint angles q [rad]. Shape (6,)."""
        pin.forwardKinematics(self.model, self._data, q)
        return pin.SE3(pin.updateFramePlacement(self.model, self._data, self._flange))

    def jacobian(self, q: Array) -> Array:
        """Return the flange's Jacobian at q, in flange axes: rows m/s then rad/s. Shape (6, 6)."""
        pin.computeJointJacobians(self.model, self._data, q)
        pin.updateFramePlacement(self.model, self._data, self._flange)
        return np.asarray(pin.getFrameJacobian(self.model, self._data, self._flange, _LOCAL))

    def solve(self, T_base_flange: pin.SE3, q_start: Array, *, jump_rad: float) -> IkResult:
        """Return the joint angles that reach a pose, on the branch of q_start.

        Newton's method on log6(T(q)^-1 T_goal), damped in proportion to the remaining error.

        Args:
            T_base_flange: Target pose.
            q_start: Where the search starts [rad]. Shape (6,).
            jump_rad: Largest permitted change of any joint from its start [rad].
        """
        if not is_finite_pose(T_base_flange):
            return IkResult(None, "the pose contains a number that is not finite")
        q, error = self._newton(T_base_flange, q_start)
        if error > 1e-7:
            return IkResult(None, self._failure(T_base_flange, q, error))
        return self._checked_limits(q, q_start, jump_rad)

    def limit_violation(self, q: Array) -> str:
        """Return a message about the first joint outside its limits, or an empty string."""
        for number, (angle, low, high) in enumerate(zip(q.tolist(), *self._limits, strict=True), 1):
            if angle < low or angle > high:
                return (
                    f"joint {number} would be at {math.degrees(angle):.2f} deg,"
                    f" its limits are {math.degrees(low):g} .. {math.degrees(high):g} deg"
                )
        return ""

    def _newton(self, goal: pin.SE3, q_start: Array) -> tuple[Array, float]:
        q = np.array(q_start, dtype=float)
        model, data, flange = self.model, self._data, self._flange
        size = math.inf
        for _ in range(_MAX_ITERATIONS):
            pin.computeJointJacobians(model, data, q)
            present = pin.updateFramePlacement(model, data, flange)
            error = pin.log6(present.actInv(goal)).vector
            size = math.sqrt(error.dot(error))  # `dot` has the digits of `@` in a third of its time
            if size < _TOLERANCE:
                break
            J = pin.getFrameJacobian(model, data, flange, _LOCAL)
            damping = _LEAST_DAMPING + _DAMPING * size
            A = J.dot(J.T)
            diagonal = A.ravel()[:: JOINTS + 1]  # a view
            diagonal += damping * damping
            step = J.T.dot(np.linalg.solve(A, error))
            longest = max(map(abs, step.tolist()))
            q += step if longest <= _MAX_STEP_RAD else step * (_MAX_STEP_RAD / longest)
        return q, size

    def _failure(self, goal: pin.SE3, q: Array, error: float) -> str:
        wrist_m = goal.act(-self.model.jointPlacements[6].translation)
        far_m = float(np.linalg.norm(wrist_m))
        if far_m > self.reach_m:
            return (
                f"out of reach: the wrist would be {1e3 * far_m:.0f} mm from the shoulder,"
                f" the arm is {1e3 * self.reach_m:.0f} mm long"
            )
        least = float(np.linalg.svd(self.jacobian(q), compute_uv=False)[-1])
        where = "singular pose" if least < 0.02 else "the iteration did not converge"
        return f"not reachable from here: {where} (error {error:.1e})"

    def _checked_limits(self, q: Array, q_start: Array, jump_rad: float) -> IkResult:
        violation = self.limit_violation(q)
        if violation:
            return IkResult(None, violation)
        moved = abs(q - q_start).tolist()
        farthest = max(moved)
        if farthest > jump_rad:
            return IkResult(
                None,
                f"joint {moved.index(farthest) + 1} would jump by"
                f" {math.degrees(farthest):.1f} deg,"
                f" limit {math.degrees(jump_rad):.1f} deg",
            )
        return IkResult(q)
