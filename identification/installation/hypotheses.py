"""Error hypotheses for readings that no signed axis permutation explains. Pure.

Each hypothesis transforms the readings. The first one after which they fit a correctly installed
sensor is reported.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from common.motion.frames import GRAVITY_M_S2, Array, R_from_quaternion, quaternion_from_R
from identification.installation.axes import EYE, same
from identification.installation.axis_fit import (
    MISFIT_SHARE,
    ForceFit,
    fit_force,
    free_gain,
    free_gravity,
)
from identification.installation.terms import ExpectedInstallation, InstallationFinding
from identification.recording import Samples
from identification.static_poses import Poses, angle

LEAST_POSES_TO_OMIT, MOST_POSES_TO_OMIT = (
    5,
    60,
)  # number of poses for which leaving one out is tried
SIMILAR_RAD = math.radians(12.0)  # 180 degrees divided twice by 57.3 is less
HEAVY_KG = 50.0
LIGHT_KG, NO_WEIGHT_SHARE = 0.1, 0.1
UNEQUAL = 1.25
POSES = "turn the wrist by at least 60 degrees about two axes, free of contact"


def _with_attitudes(samples: Samples, of: Callable[[Array], Array]) -> Samples:
    return replace(samples, R_base_sensor=np.array([of(R) for R in samples.R_base_sensor]))


def _attitude_w_first(R: Array) -> Array:
    """Return the attitude of a quaternion w x y z that was read as x y z w."""
    x, y, z, w = quaternion_from_R(R)
    return R_from_quaternion((y, z, w, x))


def _from_base_axes(samples: Samples) -> Samples:
    R = samples.R_base_sensor
    force, torque = (
        np.asarray(np.einsum("nji,nj->ni", R, v)) for v in (samples.force_N, samples.torque_Nm)
    )
    return replace(samples, force_N=force, torque_Nm=torque)


HYPOTHESES: tuple[tuple[str, str, Callable[[Samples], Samples]], ...] = (
    (
        "each attitude is that of the base in the sensor, not of the sensor in the base",
        "transpose the matrices, or conjugate the quaternions",
        lambda samples: _with_attitudes(samples, lambda R: R.T),
    ),
    (
        "the quaternions are in the order w x y z",
        "write them in the order x y z w",
        lambda samples: _with_attitudes(samples, _attitude_w_first),
    ),
    (
        "the readings are in base axes, not in sensor axes",
        "let the driver publish them in the axes of the sensor, or use --wrench-axes base",
        _from_base_axes,
    ),
    (
        "forces and torques are exchanged",
        "exchange the first and the last three of the six numbers in the driver",
        lambda samples: replace(samples, force_N=samples.torque_Nm, torque_Nm=samples.force_N),
    ),
)


def is_correctly_installed(force: ForceFit) -> bool:
    """Return whether a fit is certainly that of a correctly installed sensor."""
    straight = same(force.wiring, EYE) and not force.turned
    return force.explained and force.determined and straight


def hypothesis_finding(
    poses: Poses, force: ForceFit, expected: ExpectedInstallation
) -> InstallationFinding:
    """Return the first hypothesis that explains readings that no axis permutation explains."""
    down = expected.down_in_base
    for text, remedy, transform in HYPOTHESES:
        if is_correctly_installed(fit_force(replace(poses, means=transform(poses.means)), down)):
            return InstallationFinding("attitude", text, remedy)
    return (
        _no_weight_finding(force, expected)
        or _gravity_finding(poses)
        or _gain_finding(poses, down)
        or InstallationFinding(
            "attitude",
            "no mounting and no axis map explains the readings as a weight: the attitudes do not "
            "match (degrees taken for radians, another order of the angles, another robot), "
            "the tool was in contact, or the tool is too light for the sensor's drift",
            f"compare the recorded attitudes with the pendant's, then record again: {POSES}",
        )
    )


def similar_poses_finding(
    poses: Poses, force: ForceFit, expected: ExpectedInstallation
) -> InstallationFinding:
    """Return the finding for too similar attitudes, whose unit may be wrong."""
    R = poses.means.R_base_sensor
    widest = max(float(angle(attitude, R).max()) for attitude in R)
    per_turn_kg = force.spread_N / (GRAVITY_M_S2 * max(widest, 1e-6) / 2.0)
    most_kg = HEAVY_KG if expected.mass_kg is None else 5.0 * expected.mass_kg
    if widest < SIMILAR_RAD and per_turn_kg > most_kg:
        text = (
            f"the attitudes differ by only {math.degrees(widest):.2g} degrees, but the force "
            f"as if {per_turn_kg:.3g} kg had been turned by that: radians are taken for degrees"
        )
        return InstallationFinding(
            "attitude", text, "multiply the angles of the attitudes by 57.2958"
        )
    text = f"{len(poses)} poses this similar do not identify the axes"
    return InstallationFinding("poses", text, POSES, "unsure")


def _no_weight_finding(
    force: ForceFit, expected: ExpectedInstallation
) -> InstallationFinding | None:
    """Return the finding for forces that do not change with the attitude."""
    expected_kg = LIGHT_KG if expected.mass_kg is None else expected.mass_kg
    if force.spread_N > NO_WEIGHT_SHARE * GRAVITY_M_S2 * expected_kg:
        return None
    text = f"the forces hardly change with the attitude ({force.spread_N:.2g} N): no weight is read"
    remedy = "check that the sensor is live, its unit, and that the tool is mounted on it"
    return InstallationFinding("no_weight", text, remedy)


def without_disturbed_poses(poses: Poses, down_in_base: Array) -> tuple[Poses, list[int]]:
    """Leave out the few poses that spoil the fit: in contact, or read in motion.

    Returns the rest and the indices of those left out; all poses when that does not help.
    """
    rows, out = list(range(len(poses))), list[int]()
    while LEAST_POSES_TO_OMIT < len(rows) <= MOST_POSES_TO_OMIT and len(out) < len(poses) // 4:
        fits = {row: fit_force(_subset(poses, rows, row), down_in_base) for row in rows}
        worst = min(rows, key=lambda row: fits[row].rms_N)
        rows.remove(worst)
        out.append(worst)
        if fits[worst].explained and fits[worst].determined:
            return _subset(poses, rows), sorted(out)
    return poses, []


def _subset(poses: Poses, rows: list[int], excluded: int | None = None) -> Poses:
    rows_kept = np.array([row for row in rows if row != excluded])
    return Poses(poses.means[rows_kept], poses.weight[rows_kept], poses.first_row[rows_kept])


def _gravity_finding(poses: Poses) -> InstallationFinding | None:
    """Return the finding for correct axes on an arm mounted on a wall or a slope."""
    direction, residual_N = free_gravity(poses)
    force = fit_force(poses, direction)
    if not (is_correctly_installed(force) and residual_N <= MISFIT_SHARE * force.weight_N):
        return None
    direction_text = ", ".join(f"{x + 0.0:.3f}" for x in direction.round(3))
    text = (
        f"gravity points along ({direction_text}) in the base: the arm is not mounted as the cell "
        "file says"
    )
    return InstallationFinding(
        "gravity", text, f"write payload.gravity_direction_in_base: [{direction_text}]"
    )


def _gain_finding(poses: Poses, down_in_base: Array) -> InstallationFinding | None:
    """Return the finding for axes of unequal gain, dead ones included."""
    A, residual_N = free_gain(poses, down_in_base)
    gains = np.linalg.norm(A, axis=1)
    weight_N = GRAVITY_M_S2 * float(gains.max())
    if len(poses) < LEAST_POSES_TO_OMIT or weight_N <= 0.0 or residual_N > MISFIT_SHARE * weight_N:
        return None
    if gains.max() < UNEQUAL * gains.min():
        return None
    shares = ", ".join(f"F{c} {g / gains.max():.2f}" for c, g in zip("xyz", gains, strict=True))
    text = f"the axes read the same weight with unequal gain ({shares} of the largest)"
    silent_axes = [f"F{c}" for c, g in zip("xyz", gains, strict=True) if g < 0.1 * gains.max()]
    remedy = (
        f"{' and '.join(silent_axes)} without signal: check the cable"
        if silent_axes
        else ("check the calibration matrix and the counts per newton of each axis")
    )
    return InstallationFinding("gain", text, remedy)
