"""Residuals of a payload at each pose, and the verdict against their limits. Pure."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from common.config.calibration import Residuals
from common.config.payload import Payload
from common.motion.frames import Array
from common.motion.weight import residual
from forcemesh.errors import DataError
from identification.dwells import Dwell
from identification.recording import Samples


@dataclass(frozen=True, slots=True)
class VerificationBounds:
    """Limits of the residuals at any pose."""

    force_N: float = 0.5
    torque_Nm: float = 0.05


@dataclass(frozen=True, slots=True)
class Residual:
    """Norms of the residuals at each pose: force [N] and torque about the sensor [N m], (n,)."""

    force_N: Array
    torque_Nm: Array

    @property
    def summary(self) -> Residuals:
        """Mean and maximum, as in the calibration file."""
        return Residuals(
            poses=len(self.force_N),
            force_mean_N=float(self.force_N.mean()),
            force_max_N=float(self.force_N.max()),
            torque_mean_Nm=float(self.torque_Nm.mean()),
            torque_max_Nm=float(self.torque_Nm.max()),
        )


def residual_of(payload: Payload, samples: Samples) -> Residual:
    """Return the residuals of a payload."""
    force, torque = residual(
        payload, samples.R_base_sensor, force_N=samples.force_N, torque_Nm=samples.torque_Nm
    )
    return Residual(np.linalg.norm(force, axis=1), np.linalg.norm(torque, axis=1))


def active_residual(dwells: Sequence[Dwell]) -> Residual:
    """Return the residuals that the running cell published at each pose.

    Raises DataError when the wrench was not valid at one of them.
    """
    force = [dwell.residual_N for dwell in dwells if dwell.residual_N is not None]
    torque = [dwell.residual_Nm for dwell in dwells if dwell.residual_Nm is not None]
    if len(force) < len(dwells):
        raise DataError("the wrench was not valid at every pose: see `forcemesh status`")
    return Residual(np.linalg.norm(force, axis=1), np.linalg.norm(torque, axis=1))


@dataclass(frozen=True, slots=True)
class Verification:
    """PASS, FAIL, or NOT VERIFIED (None), with its reason."""

    passed: bool | None
    text: str

    @property
    def result(self) -> str:
        """The verdict as one term."""
        return {True: "PASS", False: "FAIL", None: "NOT VERIFIED"}[self.passed]


def judge_residual(residual: Residual | None, bounds: VerificationBounds) -> Verification:
    """Return the verdict on held-out poses; None when there are none."""
    if residual is None:
        text = "no held-out pose; the residuals of the fit alone do not verify it"
        return Verification(None, f"NOT VERIFIED: {text}")
    found = residual.summary
    passed = found.force_max_N <= bounds.force_N and found.torque_max_Nm <= bounds.torque_Nm
    poses = f"{found.poses} fresh pose{'' if found.poses == 1 else 's'}"
    text = (
        f"at {poses} the residual is {found.force_mean_N:.3f} N and {found.torque_mean_Nm:.4f} N m "
        f"(mean), {found.force_max_N:.3f} N and {found.torque_max_Nm:.4f} N m (max); limits "
        f"{bounds.force_N:g} N, {bounds.torque_Nm:g} N m"
    )
    return Verification(passed, f"{'PASS' if passed else 'FAIL'}: {text}")
