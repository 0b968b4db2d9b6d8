"""Payload model and its fit: least squares with priors, with some errors of the cell. Pure.

    F = (1 + e) * m g_s + b_F + d_F u/2        g_s = (R_base_sensor R_mount)^T g
    M = h x g_s + b_M + d_M u/2                u = -1 at the first pose, +1 at the last

with h = m c, and `*` axis by axis. The plain fit has the unknowns m, h, b_F and b_M. Errors that it
may fit too: tilt of g, mounting R_mount, gain error e of the force, and drift d of the bias.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from common.motion.frames import GRAVITY_M_S2, Array, rotation_from_vector, skew
from identification.recording import Poses, Samples

PLAIN = {
    "mass": slice(0, 1),
    "moment": slice(1, 4),
    "bias_force": slice(4, 7),
    "bias_torque": slice(7, 10),
}
ERRORS = {
    "tilt": slice(10, 12),
    "mounting": slice(12, 15),
    "gain": slice(15, 18),
    "drift": slice(18, 24),
}
PLACES = PLAIN | ERRORS  # of the unknowns
SIZE = 24
# Prior standard deviation of one component: a usual error, also with few poses.
PRIOR_STD = np.full(SIZE, np.inf)
PRIOR_STD[ERRORS["tilt"]] = np.radians(1.0)
PRIOR_STD[ERRORS["mounting"]] = np.radians(2.0)
PRIOR_STD[ERRORS["gain"]] = 0.03
PRIOR_STD[ERRORS["drift"]] = [1.0] * 3 + [0.03] * 3  # [N], [N m]
PRIOR_STD.setflags(write=False)
DOWN = np.array([0.0, 0.0, -1.0])
DOWN.setflags(write=False)
# Lower limit of the noise, so that noise-free data do not divide by zero.
FLOOR = np.array([1e-6, 1e-8])  # [N], [N m]
# Six poses with twenty unknowns hardly determine the noise: one pseudo-observation with the noise
# of a good sensor regularises it.
QUIET = np.array([2e-3, 1e-4])
LEAST_MASS_KG = 1e-4
ITERATIONS = 60
CONVERGED = 1e-7
RANK_TOLERANCE = 1e-13  # of eigenvalues: the squares of the singular values
FOLDS_AT_MOST = 20

Errors = tuple[str, ...]  # keys of ERRORS


class Directions(NamedTuple):
    """Direction of gravity, a unit vector, and rotation of the mounting. Shapes (3,), (3, 3)."""

    down_in_base: Array = DOWN
    R_mount: Array = np.eye(3)

    def turned(self, x: Array) -> "Directions":
        """Return the directions after the tilt and the mounting rotation of these unknowns."""
        tilt = perpendicular_axes(self.down_in_base) @ x[PLACES["tilt"]]
        mounting = rotation_from_vector(x[PLACES["mounting"]])
        down = rotation_from_vector(tilt) @ self.down_in_base
        return Directions(down / np.linalg.norm(down), self.R_mount @ mounting)


@dataclass(frozen=True, slots=True)
class Solution:
    """Result of a fit.

    `x` has shape (24,); `covariance` (24, 24), zero for what is not fitted. `noise` is that of one
    component of force [N] and torque [N m]. `residual` and `left_out` are the residuals of each
    pose in the fit and in a fit without it, shape (2, n, 3).
    """

    errors: Errors
    x: Array
    directions: Directions
    noise: Array
    covariance: Array
    converged: bool
    residual: Array
    left_out: Array

    def std(self, name: str) -> Array:
        """Return the standard deviation of the unknowns of this name."""
        return np.asarray(np.sqrt(np.diag(self.covariance)[PLACES[name]]))

    @property
    def name(self) -> str:
        """Return the errors that it fits, joined by plus signs."""
        return "+".join(self.errors) or "plain"

    @property
    def weighs(self) -> bool:
        """Return whether its mass exceeds three standard deviations."""
        return bool(self.x[0] >= max(3.0 * self.std("mass")[0], LEAST_MASS_KG))

    @property
    def rms(self) -> Array:
        """Return the rms of the norms of the residuals, of force and torque. Shape (2,)."""
        return _rms(self.residual)

    @property
    def left_out_rms(self) -> Array:
        """Return that at left-out poses; infinite if the other poses are insufficient."""
        return _rms(self.left_out)


class _NormalEquations:
    """Normal equations; `rows`, shape (2, n, 3, k), and `error`, (2, n, 3), in units of the noise.

    `squares` has shape (2, k, k): the information in the forces and in the torques.
    """

    def __init__(self, rows: Array, error: Array, prior: Array) -> None:
        A = rows.reshape(2, -1, rows.shape[-1])
        self.rows, self.error, self.squares = rows, error, A.swapaxes(1, 2) @ A
        self.total = self.squares.sum(axis=0) + np.diag(prior)
        length = np.sqrt(np.diag(self.total))
        length[length == 0.0] = 1.0
        self.sizes = np.outer(length, length)  # without units the rank can be judged
        inverse = np.linalg.pinv(self.total / self.sizes, RANK_TOLERANCE, hermitian=True)
        self.inverse = inverse / self.sizes

    def left_out(self) -> Array:
        """Return the error of poses in a fit without them; exact for a linear model.

        Each pose is left out alone; in long recordings blocks are, as neighbours are correlated.
        Infinite where the others do not determine a fit.
        """
        found, poses = np.full_like(self.error, np.inf), self.error.shape[1]
        for fold in np.array_split(np.arange(poses), min(poses, FOLDS_AT_MOST)):
            A, e = self.rows[:, fold].reshape(-1, len(self.total)), self.error[:, fold].ravel()
            others = self.total - A.T @ A
            if np.linalg.eigvalsh(others / self.sizes)[0] > 1e-9:
                found[:, fold] = (e + A @ np.linalg.solve(others, A.T @ e)).reshape(2, -1, 3)
        return found


def solve(poses: Poses, errors: Errors, start: Directions) -> Solution:
    """Fit the plain unknowns and these errors, from these directions, by Gauss-Newton steps.

    The noise of force and torque comes from the residuals.
    """
    samples = poses.means
    fitted: npt.NDArray[np.intp] = np.concatenate(
        [np.arange(SIZE)[PLACES[name]] for name in (*PLAIN, *errors)]
    )
    prior = PRIOR_STD[fitted] ** -2
    read = np.array([samples.force_N, samples.torque_Nm])
    x, directions, noise, converged = np.zeros(SIZE), start, np.ones(2), False
    residual = read - predicted(x, samples, directions)

    def equations() -> _NormalEquations:
        scale = np.sqrt(poses.weight)[:, None] / noise[:, None, None]
        J = jacobian(x, samples, directions)[..., fitted]
        return _NormalEquations(J * scale[..., None], residual * scale, prior)

    for _ in range(ITERATIONS):
        normal = equations()
        slope = np.einsum("bnik,bni->k", normal.rows, normal.error) - prior * x[fitted]
        step = np.zeros(SIZE)
        step[fitted] = normal.inverse @ slope
        x, directions = x + step, directions.turned(step)
        residual = read - predicted(x, samples, directions)
        unknowns = (normal.squares * normal.inverse).sum(axis=(1, 2))
        before, noise = noise, _noise(residual, poses.weight, unknowns)
        # A rough convergence of the noise is enough: the directions converge long before it.
        settled = bool(np.all(np.abs(np.log(noise / before)) < 1e-2))
        converged = settled and bool(np.linalg.norm(step) < CONVERGED * (1.0 + np.linalg.norm(x)))
        if converged:
            break
    normal = equations()
    covariance = np.zeros((SIZE, SIZE))
    covariance[np.ix_(fitted, fitted)] = normal.inverse
    scale = np.sqrt(poses.weight)[:, None] / noise[:, None, None]
    left_out = normal.left_out() / scale
    return Solution(errors, x, directions, noise, covariance, converged, residual, left_out)


def predicted(x: Array, samples: Samples, directions: Directions) -> Array:
    """Return the readings of force [N] and torque [N m]. Shape (2, n, 3)."""
    g_s = gravity_in_sensor(samples.R_base_sensor @ directions.R_mount, directions.down_in_base)
    load = np.array([(1.0 + x[PLACES["gain"]]) * x[0] * g_s, g_s @ skew(x[PLACES["moment"]]).T])
    drift = half_course(samples)[:, None] * x[PLACES["drift"]].reshape(2, 1, 3)
    return np.asarray(load + x[4:10].reshape(2, 1, 3) + drift)


def jacobian(x: Array, samples: Samples, directions: Directions) -> Array:
    """Return the derivatives of the readings by the unknowns. Shape (2, n, 3, 24).

    Those by tilt and mounting are of a further turn from the directions.
    """
    down, R_base_true = directions.down_in_base, samples.R_base_sensor @ directions.R_mount
    g_s = gravity_in_sensor(R_base_true, down)
    g_cross = np.cross(np.eye(3), g_s[:, None, :])  # [g_s]x: its rows are e_x x g_s, ...
    tilt = R_base_true.swapaxes(1, 2) @ -skew(GRAVITY_M_S2 * down) @ perpendicular_axes(down)
    turn, gain = np.concatenate([tilt, g_cross], axis=2), 1.0 + x[PLACES["gain"]]
    J = np.zeros((2, len(samples), 3, SIZE))
    J[0, :, :, 0] = gain * g_s
    J[1, :, :, PLACES["moment"]] = -g_cross
    J[0, :, :, PLACES["bias_force"]] = J[1, :, :, PLACES["bias_torque"]] = np.eye(3)
    J[:, :, :, 10:15] = gain[:, None] * x[0] * turn, skew(x[PLACES["moment"]]) @ turn
    J[0, :, :, PLACES["gain"]] = x[0] * g_s[:, :, None] * np.eye(3)
    J[0, :, :, 18:21] = J[1, :, :, 21:24] = half_course(samples)[:, None, None] * np.eye(3)
    return J


def conditioning(R_base_sensor: Array, down_in_base: Array) -> float:
    """Return the condition number of the plain fit, which depends on the attitudes alone."""
    zeros = np.zeros((len(R_base_sensor), 3))
    unread = Samples(R_base_sensor, zeros, zeros)
    J = jacobian(np.zeros(SIZE), unread, Directions(down_in_base))[..., :10].reshape(-1, 10)
    # Columns of length 1 make it free of units (Belsley, Kuh, Welsch 1980).
    return float(np.linalg.cond(J / np.maximum(np.linalg.norm(J, axis=0), 1e-12)))


def gravity_in_sensor(R_base_sensor: Array, down_in_base: Array) -> Array:
    """Return g_s = R^T g in each attitude [m/s^2]. Shape (n, 3, 3) to (n, 3)."""
    return np.asarray(R_base_sensor.swapaxes(1, 2) @ (GRAVITY_M_S2 * down_in_base))


def half_course(samples: Samples) -> Array:
    """Return u/2 of each reading: -1/2 to 1/2, zeros without times. Shape (n,)."""
    t = samples.time_s
    if t is None or np.ptp(t) == 0.0:
        return np.zeros(len(samples))
    return np.asarray((t - t.min()) / np.ptp(t) - 0.5)


def perpendicular_axes(direction: Array) -> Array:
    """Return two unit vectors perpendicular to a direction. Shape (3, 2)."""
    cross_matrix = skew(direction)
    first = cross_matrix[:, int(np.argmin(np.abs(direction)))]
    first = first / np.linalg.norm(first)
    return np.stack([first, cross_matrix @ first], axis=1)


def _rms(residual: Array) -> Array:
    return np.asarray(np.sqrt((residual**2).sum(axis=2).mean(axis=1)))


def _noise(residual: Array, weight: Array, unknowns: Array) -> Array:
    """Return the noise of force and torque; `unknowns` is the number of unknowns of each."""
    squares = (weight[:, None] * residual**2).sum(axis=(1, 2)) + QUIET**2
    freedom = np.maximum(3.0 * len(weight) + 1.0 - unknowns, 1.0)
    return np.asarray(np.maximum(np.sqrt(squares / freedom), FLOOR))
