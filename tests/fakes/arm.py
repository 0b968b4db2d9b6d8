"""A six-axis arm without dynamics: joints and flange pose that always agree (RS007L lengths)."""

import numpy as np
import pinocchio as pin

READY_RAD = np.radians([0.0, 0.0, -90.0, 0.0, -90.0, 0.0])  # tool exactly down: A = 180
JOINT_MIN_RAD = np.radians([-180.0, -135.0, -157.0, -200.0, -125.0, -360.0])
JOINT_MAX_RAD = np.radians([180.0, 135.0, 157.0, 200.0, 125.0, 360.0])
_AXES = ([0, 0, -1], [-1, 0, 0], [1, 0, 0], [0, 0, 1], [1, 0, 0], [0, 0, 1])
_LENGTHS_M = (0.0, 0.0, 0.455, 0.0925, 0.3825, 0.078)


class FakeArm:
    """Forward and inverse kinematics."""

    def __init__(self) -> None:
        self._model = pin.Model()
        parent = 0
        for number, (axis, length) in enumerate(zip(_AXES, _LENGTHS_M, strict=True), start=1):
            joint = pin.JointModelRevoluteUnaligned(*(float(a) for a in axis))
            origin = pin.SE3(np.eye(3), np.array([0.0, 0.0, length]))
            parent = self._model.addJoint(parent, joint, origin, f"joint{number}")
        self._data = self._model.createData()

    def pose(self, joint_rad: np.ndarray) -> pin.SE3:
        """Return the flange in base."""
        pin.forwardKinematics(self._model, self._data, joint_rad)
        return self._data.oMi[6].copy()

    def joints(self, T_base_flange: pin.SE3, near_rad: np.ndarray) -> np.ndarray | None:
        """Return joint angles near the given ones, or None when the pose is out of reach."""
        q = near_rad.copy()
        for _ in range(100):
            error = pin.log6(self.pose(q).actInv(T_base_flange)).vector
            if np.linalg.norm(error) < 1e-9:
                inside = (q >= JOINT_MIN_RAD) & (q <= JOINT_MAX_RAD)
                return q if inside.all() else None
            pin.computeJointJacobians(self._model, self._data, q)
            J = pin.getJointJacobian(self._model, self._data, 6, pin.ReferenceFrame.LOCAL)
            step = J.T @ np.linalg.solve(J @ J.T + 1e-8 * np.eye(6), error)
            q = q + step * min(1.0, 0.5 / max(np.abs(step).max(), 1e-12))
        return None
