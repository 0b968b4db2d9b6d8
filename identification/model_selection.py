"""Errors of the cell that a payload fit includes: those that predict left-out poses better."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from common.motion.frames import Array
from identification.installation.axis_fit import free_gain, free_gravity, nominal_rms
from identification.payload_fit import (
    ERRORS,
    FLOOR,
    Directions,
    Errors,
    Solution,
    half_course,
    solve,
)
from identification.recording import Poses

LEAST_POSES_TO_COMPARE = 6  # two more than the plain fit needs
PRICE = 0.85  # a further error leaves at most this share of the residual at left-out poses
FAR_COSINE = np.cos(np.radians(10.0))  # farther directions are not found from the nominal ones
CLEAR_RATIO = 2.0  # of residuals, at which one choice is clear


def score(solution: Solution) -> float:
    """Return the product of force and torque error on left-out poses, independent of units."""
    left_out = solution.left_out_rms
    found = left_out if np.isfinite(left_out).all() else solution.rms
    return float(np.prod(np.maximum(found, FLOOR)))


def cost(solution: Solution) -> float:
    """Return the score, raised for each error that it fits; infinite if it must not be used."""
    errors = len(solution.errors)
    is_sound = solution.converged and bool(np.isfinite(solution.left_out).all())
    if (errors and not is_sound) or not solution.weighs:
        return float("inf")
    return score(solution) / PRICE ** (2 * errors)


def fitted_candidates(
    poses: Poses, down_in_base: Array, *, found: bool = False
) -> tuple[Solution, ...]:
    """Fit each combination of errors that the poses support, the smallest first.

    Args:
        poses: Static readings, free of contact.
        down_in_base: Nominal direction of gravity, unit vector.
        found: Whether the direction is itself from the readings: its tilt is then always fitted.
    """
    names = []
    if len(poses) >= LEAST_POSES_TO_COMPARE:
        names = [name for name in ERRORS if name != "drift" or half_course(poses.means).any()]
    always: Errors = ()
    if found:
        always, names = ("tilt",), [name for name in names if name != "tilt"]
    counts = range(len(names) + 1)
    models = [(*always, *more) for count in counts for more in combinations(names, count)]
    nominal = Directions(down_in_base)
    far = _far_mounting(poses, nominal)
    candidates = []
    for errors in models:
        starts = [nominal, far] if far and "mounting" in errors else [nominal]
        fits = [solve(poses, errors, start) for start in starts]
        candidates.append(min(fits, key=lambda fit: (cost(fit), score(fit))))
    return tuple(candidates)


def chosen_candidate(candidates: Sequence[Solution]) -> Solution:
    """Return the candidate of the lowest cost, the smallest one if none may be used."""
    return min(candidates, key=cost)


def found_gravity(poses: Poses, down_in_base: Array) -> Array | None:
    """Return the direction of gravity of a free fit, if it is far from the nominal one and better.

    An arm on a wall or a ceiling, or a sensor that reports the reaction. None: the nominal one.
    """
    down, rms_N = free_gravity(poses)
    is_near = not down.any() or down @ down_in_base > FAR_COSINE
    return None if is_near or CLEAR_RATIO * rms_N > nominal_rms(poses, down_in_base) else down


def _far_mounting(poses: Poses, nominal: Directions) -> Directions | None:
    """Return the rotation of the sensor of a free fit, if it is far from the nominal one.

    F = A g_s + b is linear in A = m R_mount^T, whose nearest rotation comes from its singular
    vectors; det A < 0 is gravity pointing up.
    """
    A, _ = free_gain(poses, nominal.down_in_base)
    sign = 1.0 if np.linalg.det(A) >= 0.0 else -1.0
    U, _, Vt = np.linalg.svd(sign * A)
    R_mount = (U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt).T
    if (np.trace(R_mount) - 1.0) / 2.0 > FAR_COSINE:
        return None
    return Directions(sign * nominal.down_in_base, R_mount)
