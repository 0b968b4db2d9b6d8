"""Weighted least squares of the payload model with priors: one chosen model, one set of poses.

Gauss-Newton on the posterior. The noise of force and of torque and the quality of the model come
from the evidence: the probability of the readings under the model with its unknowns marginalised
(MacKay: Bayesian interpolation, Neural Computation 1992).
"""

from dataclasses import dataclass, replace
from math import hypot
from typing import NamedTuple

import numpy as np

from common.motion.frames import Array
from identification.payload_model import (
    LINEAR,
    PRIOR_STD,
    Model,
    State,
    extra_parameters,
    jacobian,
    make_mass_positive,
    residuals,
    start_state,
    updated_state,
)
from identification.recording import Poses

# Lower limit of the noise, so that noise-free data do not divide by zero.
FORCE_FLOOR_N, TORQUE_FLOOR_NM = 1e-6, 1e-8
FLOOR = np.array([FORCE_FLOOR_N, TORQUE_FLOOR_NM])
# Six poses with thirty unknowns hardly determine the noise: one pseudo-observation with the noise
# of a good sensor regularises it.
QUIET = np.array([2e-3, 1e-4])
QUIET_EQUATIONS = 1.0
ITERATIONS = 60
CONVERGED = 1e-7
RANK_TOLERANCE = 1e-7  # of singular values: squared, it is still above the rounding error
FOLDS_AT_MOST = 20


class Noise(NamedTuple):
    """Standard deviation of one component of force and of torque."""

    force_N: float
    torque_Nm: float


@dataclass(frozen=True, slots=True)
class Solution:
    """Result of a fit. `covariance` and `amplified` are in the order of the model's unknowns.

    `conditioning` is that of all unknowns with their priors; `amplified` is the factor on the
    deviation of each unknown from fitting the others too. `evidence` is a logarithm, of which only
    differences are meaningful. `loo_residual` has shape (2, n, 3): the leave-one-out residual of
    each pose.
    """

    model: Model
    state: State
    noise: Noise
    covariance: Array
    conditioning: float
    amplified: Array
    converged: bool
    evidence: float
    loo_residual: Array


@dataclass(frozen=True, slots=True)
class _NormalEquations:
    """Normal equations at one state; the covariance is half @ half.T.

    `scale` is one over the noise of each reading, shape (2, n, 1); `rows` are the derivatives in
    units of that noise, shape (2, n, 3, unknowns); `squares` their sums of squares, shape
    (2, unknowns, unknowns); `length` the root of the information on each unknown by itself.
    `prior` is minus twice the logarithm of the prior density, up to a constant.
    """

    scale: Array
    rows: Array
    squares: Array
    slope: Array
    half: Array
    length: Array
    conditioning: float
    log_det: float
    prior: float

    @property
    def covariance(self) -> Array:
        return np.asarray(self.half @ self.half.T)


def solve(poses: Poses, model: Model, start: State) -> Solution:
    """Fit one model, starting from the directions of `start`."""
    still = replace(start, linear=np.zeros(LINEAR))
    plain = _plain_normal(poses, still)
    state = make_mass_positive(replace(still, linear=plain.covariance @ plain.slope))
    widths = PRIOR_STD
    residual = residuals(state, poses.means)
    noise = _noise(residual, poses.weight, np.array([4.0, 6.0]))
    converged = False
    for _ in range(ITERATIONS):
        normal = _normal_equations(poses, model, state, noise, widths=widths, residual=residual)
        step = normal.covariance @ normal.slope
        state = make_mass_positive(updated_state(state, step, model))
        residual = residuals(state, poses.means)
        widths = _prior_widths(state, model)
        unknowns = np.sum(normal.covariance * normal.squares, axis=(1, 2))
        before, noise = noise, _noise(residual, poses.weight, unknowns)
        # A rough convergence of the noise is enough: the directions converge long before it.
        settled = bool(np.all(np.abs(np.log(noise / before)) < 1e-2))
        if settled and hypot(*step) < CONVERGED * (1.0 + hypot(*state.linear)):
            converged = True
            break
    normal = _normal_equations(poses, model, state, noise, widths=widths, residual=residual)
    squares, equations = _squares(residual, poses.weight)
    misfit = float(np.sum(squares / noise**2 + 2.0 * equations * np.log(noise)))
    return Solution(
        model=model,
        state=state,
        noise=Noise(*noise.tolist()),
        covariance=normal.covariance,
        conditioning=normal.conditioning,
        amplified=np.sqrt(np.diag(normal.covariance)) * normal.length,
        converged=converged,
        # Laplace's approximation, up to a common constant.
        evidence=-0.5 * (misfit + normal.prior + normal.log_det),
        loo_residual=_loo_residual(normal, residual),
    )


def plain_conditioning(poses: Poses) -> float:
    """Return the conditioning of the plain fit, which depends on attitudes and weights alone.

    Force and torque share no unknown there, so neither their noise nor the readings change it, and
    no fit is needed.
    """
    return _plain_normal(poses, start_state()).conditioning


def _plain_normal(poses: Poses, state: State) -> _NormalEquations:
    residual = residuals(state, poses.means)
    return _normal_equations(poses, Model(), state, np.ones(2), widths={}, residual=residual)


def _prior_widths(state: State, model: Model) -> dict[str, float]:
    """Return the prior deviation of each group, or its rms if the recording shows more."""
    return {
        name: max(PRIOR_STD[name], float(np.sqrt(np.mean(value**2))))
        for name, value in extra_parameters(state, model).items()
    }


def _normal_equations(
    poses: Poses,
    model: Model,
    state: State,
    noise: Array,
    *,
    widths: dict[str, float],
    residual: Array,
) -> _NormalEquations:
    """Build and factorise the normal equations; `residual` are the residuals at this state."""
    scale = np.sqrt(poses.weight)[None, :, None] / noise[:, None, None]
    rows = jacobian(state, poses.means, model) * scale[..., None]
    A, r = rows.reshape(2, -1, model.size), (residual * scale).reshape(2, -1)
    squares = A.swapaxes(1, 2) @ A
    slope = np.einsum("bri,br->i", A, r)
    prior_information, prior = np.zeros(model.size), 0.0  # the linear unknowns have no prior
    for name, value in extra_parameters(state, model).items():
        place, variance = model.places[name], widths[name] ** 2
        prior_information[place] = 1.0 / variance
        slope[place] -= value / variance
        prior += float(value @ value) / variance + value.size * np.log(variance)
    total = squares.sum(axis=0) + np.diag(prior_information)
    length = np.sqrt(np.diag(total))
    length[length == 0.0] = 1.0
    # Columns of length 1 make the conditioning free of units (Belsley, Kuh, Welsch 1980).
    eigenvalues, V = np.linalg.eigh(total / np.outer(length, length))
    s = np.sqrt(np.maximum(eigenvalues, 0.0))
    conditioning = float(s[-1] / s[0]) if s[0] > 0.0 else np.inf
    is_significant = s > s[-1] * RANK_TOLERANCE
    half = V[:, is_significant] / s[is_significant] / length[:, None]
    log_det = 2.0 * float(np.log(s[is_significant]).sum() + np.log(length).sum())
    return _NormalEquations(scale, rows, squares, slope, half, length, conditioning, log_det, prior)


def _loo_residual(normal: _NormalEquations, residual: Array) -> Array:
    """Return the leave-out residuals of the poses, by the hat matrix.

    Exact for linear models, close for small rotations. Each pose is left out alone; in long
    recordings blocks are, as neighbours are correlated. Infinite where there is no fit.
    """
    loo_residual = np.full_like(residual, np.inf)
    errors, poses = residual * normal.scale, residual.shape[1]
    for fold in np.array_split(np.arange(poses), min(poses, FOLDS_AT_MOST)):
        error = errors[:, fold].ravel()
        B = normal.rows[:, fold].reshape(len(error), -1) @ normal.half
        # (I - B B^T)^-1 = I + B (I - B^T B)^-1 B^T keeps the matrix small for long recordings.
        complement = np.eye(B.shape[1]) - B.T @ B
        if np.linalg.eigvalsh(complement)[0] > 1e-9:
            loo_error = error + B @ np.linalg.solve(complement, B.T @ error)
            loo_residual[:, fold] = loo_error.reshape(2, -1, 3) / normal.scale[:, fold]
    return loo_residual


def _squares(residual: Array, weight: Array) -> tuple[Array, float]:
    """Return the sums of squares of force and torque, and the number of equations of each."""
    squares = (weight[:, None] * residual**2).sum(axis=(1, 2)) + QUIET_EQUATIONS * QUIET**2
    return squares, 3.0 * len(weight) + QUIET_EQUATIONS


def _noise(residual: Array, weight: Array, unknowns: Array) -> Array:
    """Return the noise of force and torque; `unknowns` is the number of unknowns of each block."""
    squares, equations = _squares(residual, weight)
    return np.asarray(np.maximum(np.sqrt(squares / np.maximum(equations - unknowns, 1.0)), FLOOR))
