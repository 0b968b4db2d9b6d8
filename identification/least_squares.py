"""Weighted least squares of the payload model with priors: one chosen model, one set of readings.

Gauss-Newton on the posterior. The noise of force and of torque and the quality of the model come
from the evidence: the probability of the readings under the model with its unknowns marginalised
(MacKay: Bayesian interpolation, Neural Computation 1992).
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

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
from identification.recording import Samples

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


@dataclass(frozen=True, slots=True)
class Noise:
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
    widths: dict[str, float]
    covariance: Array
    conditioning: float
    amplified: Array
    converged: bool
    evidence: float
    loo_residual: Array


@dataclass(frozen=True, slots=True)
class _FitProblem:
    """Model with the readings that it is fitted to."""

    samples: Samples
    weight: Array
    model: Model


@dataclass(frozen=True, slots=True)
class _NormalEquations:
    """Normal equations at one state; the covariance is half @ half.T.

    `scale` is one over the noise of each reading, shape (2, n, 1); `rows` are the derivatives in
    units of that noise, shape (2, n, 3, unknowns).
    """

    scale: Array
    rows: Array
    squares: tuple[Array, Array]
    slope: Array
    half: Array
    conditioning: float
    log_det: float

    @property
    def covariance(self) -> Array:
        return np.asarray(self.half @ self.half.T)


def solve(samples: Samples, weight: Array, model: Model, start: State) -> Solution:
    """Fit one model, starting from the directions of `start`.

    Args:
        samples: Readings in sensor axes.
        weight: Weight of each reading. Shape (n,).
        model: Parameters to fit.
        start: Directions to start from.
    """
    task = _FitProblem(samples, weight, model)
    state = make_mass_positive(_fitted_linear(task, start))
    widths = {name: PRIOR_STD[name] for name in model.places}
    residual = residuals(state, samples)
    noise = _noise(residual, weight, np.array([4.0, 6.0]))
    converged = False
    for _ in range(ITERATIONS):
        normal = _normal_equations(state, task, noise, widths, residual=residual)
        covariance = normal.covariance
        step = covariance @ normal.slope
        state = make_mass_positive(updated_state(state, step, model))
        residual = residuals(state, samples)
        widths = _prior_widths(state, model)
        unknowns = [float(np.sum(covariance * square)) for square in normal.squares]
        before, noise = noise, _noise(residual, weight, np.array(unknowns))
        # A rough convergence of the noise is enough: the directions converge long before it.
        settled = bool(np.all(np.abs(np.log(noise / before)) < 1e-2))
        if settled and np.linalg.norm(step) < CONVERGED * (1.0 + np.linalg.norm(state.linear)):
            converged = True
            break
    normal = _normal_equations(state, task, noise, widths, residual=residual)
    covariance = normal.covariance
    information = np.diag(normal.squares[0] + normal.squares[1]) + 1.0 / _variances(model, widths)
    return Solution(
        model=model,
        state=state,
        noise=Noise(float(noise[0]), float(noise[1])),
        widths=widths,
        covariance=covariance,
        conditioning=normal.conditioning,
        amplified=np.sqrt(np.diag(covariance) * information),
        converged=converged,
        evidence=_evidence(state, task, noise, widths, residual=residual, log_det=normal.log_det),
        loo_residual=_loo_residual(normal, residual),
    )


def plain_conditioning(samples: Samples, weight: Array) -> float:
    """Return the conditioning of the plain fit, which depends on attitudes and weights alone.

    Force and torque share no unknown there, so neither their noise nor the readings change it, and
    no fit is needed.

    Args:
        samples: Readings in sensor axes.
        weight: Weight of each reading. Shape (n,).
    """
    return _plain_normal(_FitProblem(samples, weight, Model()), start_state()).conditioning


def _variances(model: Model, widths: dict[str, float]) -> Array:
    """Return the prior variance of each unknown: infinite for the linear ones."""
    variances = np.full(model.size, np.inf)
    for name, place in model.places.items():
        variances[place] = widths[name] ** 2
    return variances


def _prior_widths(state: State, model: Model) -> dict[str, float]:
    """Return the prior deviation of each group, or its rms if the recording shows more."""
    found = {n: float(np.sqrt(np.mean(v**2))) for n, v in extra_parameters(state, model).items()}
    return {name: max(PRIOR_STD[name], size) for name, size in found.items()}


def _normal_equations(
    state: State, task: _FitProblem, noise: Array, widths: dict[str, float], *, residual: Array
) -> _NormalEquations:
    """Build and factorise the normal equations; `residual` are the residuals at this state."""
    samples, model = task.samples, task.model
    scale = np.sqrt(task.weight)[None, :, None] / noise[:, None, None]
    rows = jacobian(state, samples, model) * scale[..., None]
    A, r = rows.reshape(2, -1, model.size), (residual * scale).reshape(2, -1)
    squares = (A[0].T @ A[0], A[1].T @ A[1])
    prior = 1.0 / _variances(model, widths)
    slope = A[0].T @ r[0] + A[1].T @ r[1]
    for name, value in extra_parameters(state, model).items():
        slope[model.places[name]] -= value * prior[model.places[name]]
    total = squares[0] + squares[1] + np.diag(prior)
    length = np.sqrt(np.diag(total))
    length[length == 0.0] = 1.0
    # Columns of length 1 make the conditioning free of units (Belsley, Kuh, Welsch 1980).
    eigenvalues, V = np.linalg.eigh(total / np.outer(length, length))
    s = np.sqrt(np.maximum(eigenvalues, 0.0))
    conditioning = float(s[-1] / s[0]) if s[0] > 0.0 else np.inf
    is_significant = s > s[-1] * RANK_TOLERANCE
    half = V[:, is_significant] / s[is_significant] / length[:, None]
    log_det = 2.0 * float(np.log(s[is_significant]).sum() + np.log(length).sum())
    return _NormalEquations(scale, rows, squares, slope, half, conditioning, log_det)


def _evidence(
    state: State,
    task: _FitProblem,
    noise: Array,
    widths: dict[str, float],
    *,
    residual: Array,
    log_det: float,
) -> float:
    """Return the logarithm of the evidence (Laplace's approximation), up to a common constant."""
    squares = (task.weight[:, None] * residual**2).sum(axis=(1, 2))
    equations = 3.0 * len(task.samples) + QUIET_EQUATIONS
    squares = squares + QUIET_EQUATIONS * QUIET**2
    fit = float(np.sum(squares / noise**2 + 2.0 * equations * np.log(noise)))
    prior = 0.0
    for name, value in extra_parameters(state, task.model).items():
        prior += float(value @ value) / widths[name] ** 2 + 2.0 * value.size * np.log(widths[name])
    return -0.5 * (fit + prior + log_det)


def _loo_residual(normal: _NormalEquations, residual: Array) -> Array:
    """Return the leave-out residuals of the poses, by the hat matrix.

    Exact for linear models, close for small rotations. Each pose is left out alone; in long
    recordings blocks are, as neighbours are correlated. Infinite where there is no fit.
    """
    loo_residual = np.full_like(residual, np.inf)
    errors = residual * normal.scale
    for folds in _folds(residual.shape[1]):
        count, each = folds.shape
        rows = normal.rows[:, folds].swapaxes(0, 1).reshape(count, 6 * each, -1) @ normal.half
        error = errors[:, folds].swapaxes(0, 1).reshape(count, 6 * each, 1)
        # (I - B B^T)^-1 = I + B (I - B^T B)^-1 B^T keeps the matrix small for long recordings.
        complement = np.eye(rows.shape[2]) - rows.swapaxes(1, 2) @ rows
        fits = np.linalg.eigvalsh(complement)[:, 0] > 1e-9
        rows, error, complement = rows[fits], error[fits], complement[fits]
        error = error + rows @ np.linalg.solve(complement, rows.swapaxes(1, 2) @ error)
        places = folds[fits]
        loo_error = error.reshape(len(places), 2, each, 3).swapaxes(0, 1)
        loo_residual[:, places] = loo_error / normal.scale[:, places]
    return loo_residual


def _folds(n: int) -> list[npt.NDArray[np.intp]]:
    """Return the poses to leave out together, in one or two tables of folds of one length."""
    count = min(n, FOLDS_AT_MOST)
    each, longer = divmod(n, count)
    poses, split = np.arange(n), longer * (each + 1)
    tables = [poses[:split].reshape(longer, each + 1), poses[split:].reshape(-1, each)]
    return tables if longer else tables[1:]


def _fitted_linear(task: _FitProblem, start: State) -> State:
    """Return the start with the linear unknowns fitted; the blocks share none of them."""
    still = replace(start, linear=np.zeros(LINEAR))
    normal = _plain_normal(replace(task, model=Model()), still)
    return replace(still, linear=normal.covariance @ normal.slope)


def _plain_normal(task: _FitProblem, state: State) -> _NormalEquations:
    return _normal_equations(state, task, np.ones(2), {}, residual=residuals(state, task.samples))


def _noise(residual: Array, weight: Array, unknowns: Array) -> Array:
    """Return the noise of force and torque; `unknowns` is the number of unknowns of each block."""
    squares = (weight[:, None] * residual**2).sum(axis=(1, 2)) + QUIET_EQUATIONS * QUIET**2
    equations = 3.0 * len(weight) + QUIET_EQUATIONS
    return np.asarray(np.maximum(np.sqrt(squares / np.maximum(equations - unknowns, 1.0)), FLOOR))
