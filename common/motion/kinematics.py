"""Forward and inverse kinematics of the arm. Errors are returned, not raised."""

import math
from functools import cache
from operator import le, truediv
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from eigenpy import LLT

from common.config.arm import model_file, read_arm
from common.motion.frames import Array, is_finite_pose

_TOLERANCE = 1e-10  # of log6, m and rad together
_MAX_ITERATIONS = 40
_MAX_STEP_RAD = 0.3  # of one Newton step: keeps the iteration from diverging at a far start
_DAMPING = 0.1  # times the error: vanishes at the solution and keeps quadratic convergence
_LEAST_DAMPING = 1e-7
_STEP_DAMPING = 1e-6  # of a single step: joints turn finitely at a singularity
DAMPED_GAIN = 0.1 / _STEP_DAMPING  # a singular value is below ten times the damping
_EYE = np.eye(6)
_LOCAL = pin.ReferenceFrame.LOCAL


class IkResult(NamedTuple):
    """Joint angles [rad], or the reason why the pose has no solution."""

    q: Array | None
    reason: str = ""


class NewtonStep(NamedTuple):
    """One step of inverse kinematics: the inverse times the twist, in flange axes [m and rad]."""

    inverse: Array  # J^T (J J^T + d^2 I)^-1, shape (n, 6)
    twist: Array  # to the pose, shape (6,)
    gain: float  # at least the norm of the inverse, at a singularity of the undamped one

    @property
    def is_damped(self) -> bool:
        """Whether the step leaves out directions in which joints turn fast: at a singularity."""
        return self.gain > DAMPED_GAIN


@cache
def _model(name: str) -> pin.Model:
    """Return an arm's geometry, read once and shared: it is read-only."""
    return pin.buildModelFromMJCF(str(model_file(name)))


class ArmKinematics:
    """Kinematics of an arm of six or seven joints, read from the same model file as the physics."""

    def __init__(self, name: str) -> None:
        """Read an arm of the folder arms/. Raise ConfigError if its data sheet is damaged."""
        self.model = _model(name)
        self.joints: int = self.model.nq
        self.lower_rad: Array = np.array(self.model.lowerPositionLimit)
        self.upper_rad: Array = np.array(self.model.upperPositionLimit)
        self.max_speed_rad_s: Array = np.radians(read_arm(name).joint_speed_max_deg_s)
        self.max_speed_rad_s.setflags(write=False)
        self._speeds_rad_s = self.max_speed_rad_s.tolist()
        self._limits = (self.lower_rad.tolist(), self.upper_rad.tolist())
        self._data = self.model.createData()
        self._flange = self.model.getFrameId("flange")
        self.levers_m, self._p_flange_wrist, self.reach_m = self._measure()

    def flange_pose(self, q: Array) -> pin.SE3:
        """Return T_base_flange at joint angles q [rad]. Shape (n,)."""
        pin.forwardKinematics(self.model, self._data, q)
        return pin.updateFramePlacement(self.model, self._data, self._flange).copy()

    def full_speed_s(self, travel_rad: Array) -> float:
        """Return the duration of a joint motion at the joints' full speed [s]. Shape (n,)."""
        return float(max(map(truediv, map(abs, travel_rad.tolist()), self._speeds_rad_s)))

    def jacobian(self, q: Array) -> Array:
        """Return the flange's Jacobian at q, in flange axes: rows m/s then rad/s. Shape (6, n)."""
        pin.computeJointJacobians(self.model, self._data, q)
        pin.updateFramePlacement(self.model, self._data, self._flange)
        return np.asarray(pin.getFrameJacobian(self.model, self._data, self._flange, _LOCAL))

    def solve(
        self, T_base_flange: pin.SE3, q_start: Array, *, jump_rad: float, any_range: bool = False
    ) -> IkResult:
        """Return the joint angles that reach a pose, on the branch of q_start.

        Newton's method on log6(T(q)^-1 T_goal), damped in proportion to the remaining error.

        Args:
            T_base_flange: Target pose.
            q_start: Where the search starts [rad]. Shape (n,).
            jump_rad: Largest permitted change of any joint from its start [rad].
            any_range: The caller judges the ranges of the joints.
        """
        if not is_finite_pose(T_base_flange):
            return IkResult(None, "the pose contains a number that is not finite")
        q, size = np.array(q_start, dtype=float), math.inf
        model, data, flange = self.model, self._data, self._flange
        for _ in range(_MAX_ITERATIONS):
            pin.computeJointJacobians(model, data, q)
            present = pin.updateFramePlacement(model, data, flange)
            error = pin.log6(present.actInv(T_base_flange)).vector
            size = math.hypot(*error.tolist())
            if size < _TOLERANCE:
                break
            J = pin.getFrameJacobian(model, data, flange, _LOCAL)
            damping = _LEAST_DAMPING + _DAMPING * size
            A = J.dot(J.T) + damping * damping * _EYE  # `dot` takes a third of the time of `@`
            step = J.T.dot(LLT(A).solve(error))
            longest = max(map(abs, step.tolist()))
            q += step if longest <= _MAX_STEP_RAD else step * (_MAX_STEP_RAD / longest)
        if size > 1e-7:
            return IkResult(None, self._failure(T_base_flange, q, size))
        if not any_range and (violation := self.limit_violation(q)):
            return IkResult(None, violation)
        moved = abs(q - q_start).tolist()
        if (farthest := max(moved)) <= jump_rad:
            return IkResult(q)
        text = (
            f"joint {moved.index(farthest) + 1} would jump by {math.degrees(farthest):.1f} deg,"
            f" limit {math.degrees(jump_rad):.1f} deg"
        )
        return IkResult(None, text)

    def step_towards(self, T_base_flange: pin.SE3, q: Array) -> NewtonStep:
        """Return one damped Newton step from q towards a finite pose."""
        J = self.jacobian(q)
        twist = pin.log6(self._data.oMf[self._flange].actInv(T_base_flange)).vector
        A = J.dot(J.T) + _STEP_DAMPING * _STEP_DAMPING * _EYE
        inverse = LLT(A).solve(_EYE)
        return NewtonStep(J.T.dot(inverse), twist, math.sqrt(inverse.trace()))

    def limit_violation(self, q: Array) -> str:
        """Return a message about the first joint outside its limits, or an empty string."""
        angles, (lowest, highest) = q.tolist(), self._limits
        if all(map(le, lowest, angles)) and all(map(le, angles, highest)):
            return ""
        for number, (angle, low, high) in enumerate(zip(angles, *self._limits, strict=True), 1):
            if angle < low or angle > high:
                return (
                    f"joint {number} would be at {math.degrees(angle):.2f} deg,"
                    f" its limits are {math.degrees(low):g} .. {math.degrees(high):g} deg"
                )
        return ""

    def _measure(self) -> tuple[Array, Array, float]:
        """Return the joints' levers, the wrist, and its largest distance from joint 1 [m].

        A lever, one of shape (n,), is the largest distance of the flange from a joint's axis. The
        wrist, in the flange frame, shape (3,), is the point of the last axis nearest to the joint
        before: it does not move with the last joint, so a flange pose determines it.
        """
        axes = self.jacobian(pin.neutral(self.model))[3:].T  # in flange axes, as all of the below
        flange = self._data.oMf[self._flange]
        origins = [flange.actInv(joint.translation) for joint in self._data.oMi.tolist()[1:]]
        links = np.diff([*origins, np.zeros(3)], axis=0)
        lengths = np.linalg.norm(links, axis=1)
        levers = np.linalg.norm(np.cross(axes, links), axis=1)
        levers += lengths.sum() - lengths.cumsum()
        wrist = origins[-1] - axes[-1] * axes[-1].dot(links[-2])
        return levers, wrist, float(lengths[:-2].sum() + np.linalg.norm(wrist - origins[-2]))

    def _failure(self, goal: pin.SE3, q: Array, error: float) -> str:
        wrist_m = goal.act(self._p_flange_wrist) - self.model.jointPlacements[1].translation
        far_m = math.hypot(*wrist_m)
        if far_m > self.reach_m:
            return (
                f"out of reach: the wrist would be {1e3 * far_m:.0f} mm from the shoulder,"
                f" the arm is {1e3 * self.reach_m:.0f} mm long"
            )
        least = float(np.linalg.svd(self.jacobian(q), compute_uv=False)[-1])
        where = "singular pose" if least < 0.02 else "the iteration did not converge"
        return f"not reachable from here: {where} (error {error:.1e})"
