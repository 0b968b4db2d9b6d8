"""Weighted least squares of the payload model: one chosen model, one set of readings.

F = m g_s + b_F and M = h x g_s + b_M with h = m c and g_s = (R_base_sensor R_mount)^T g. With known
directions this is linear in (m, h, b_F, b_M); tilt of g and R_mount are added by Gauss-Newton.
"""

from dataclasses import dataclass, replace

import numpy as np

from common.frames import GRAVITY_M_S2, Array, rotation_from_vector, skew
from services.wrench.recording import Samples

LINEAR = 10
FORCE_FLOOR_N, TORQUE_FLOOR_NM = 1e-6, 1e-8  # noise-free data must not divide by zero
ITERATIONS = 50
REFINEMENTS = 8  # enough where the start is the solution for nearly the same readings
LARGEST_TURN_RAD = 0.5  # of one step; a longer one leaves the region where it is a step downhill
CONVERGED = 1e-7
RANK_TOLERANCE = 1e-7  # of singular values: squared, it is still above the rounding error
DOWN = np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True, slots=True)
class Model:
    """Which parameters beyond mass, moment and bias are fitted."""

    name: str
    tilt: bool = False
    mounting: bool = False

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return LINEAR + 2 * self.tilt + 3 * self.mounting


@dataclass(frozen=True, slots=True)
class State:
    """The unknowns: mass [kg], first moment h [kg m], bias force [N] and torque [Nm], directions.

    `linear` is (m, h, b_F, b_M), shape (10,); `down_in_base` a unit vector; `R_mount` (3, 3).
    """

    linear: Array
    down_in_base: Array
    R_mount: Array


@dataclass(frozen=True, slots=True)
class Noise:
    """Standard deviation of one component of force and of torque."""

    force_N: float
    torque_Nm: float


@dataclass(frozen=True, slots=True)
class Solution:
    """What the fit found. `covariance` is in the order of the step: linear, tilt (2), mount (3)."""

    state: State
    noise: Noise
    covariance: Array
    conditioning: float
    converged: bool
    noise_ml: Noise  # without the allowance for the fitted parameters: for likelihoods


def start_state() -> State:
    """Return level gravity, no mounting rotation, no payload."""
    return State(np.zeros(LINEAR), DOWN, np.eye(3))


def gravity(state: State, samples: Samples) -> Array:
    """Return g_s of each reading [m/s^2]. Shape (n, 3)."""
    g = GRAVITY_M_S2 * state.down_in_base
    return np.asarray(np.einsum("nji,j->ni", samples.R_base_sensor @ state.R_mount, g))


def residuals(state: State, samples: Samples) -> tuple[Array, Array]:
    """Return reading minus model: force [N] and torque [Nm], each (n, 3)."""
    g_s = gravity(state, samples)
    m, h, b_F, b_M = np.split(state.linear, [1, 4, 7])
    return samples.force_N - m * g_s - b_F, samples.torque_Nm - np.cross(h, g_s) - b_M


def solve(
    samples: Samples, weight: Array, model: Model, start: State, *, iterations: int = ITERATIONS
) -> Solution:
    """Fit one model: directions of `start` first kept, then fitted where the model has them.

    Args:
        samples: Readings in sensor axes.
        weight: Weight of each reading. Shape (n,).
        model: What is fitted.
        start: Directions to start from.
        iterations: At most so many steps.
    """
    state = _upright(_fitted_linear(samples, weight, start))
    noise, noise_ml = _noise(state, samples, weight, np.array([4.0, 6.0]))
    converged = False
    for _ in range(iterations):
        step, shares, _, _ = _step(state, samples, weight, model=model, noise=noise)
        state = _upright(_moved(state, step, model))
        noise, noise_ml = _noise(state, samples, weight, shares)
        # Signs and turns settle long before the last digit of the variances does.
        if bool(np.linalg.norm(step) < CONVERGED * (1.0 + np.linalg.norm(state.linear))):
            converged = True
            break
    _, _, covariance, conditioning = _step(state, samples, weight, model=model, noise=noise)
    return Solution(state, noise, covariance, conditioning, converged, noise_ml)


def jacobians(state: State, samples: Samples, model: Model) -> tuple[Array, Array]:
    """Return the derivatives of the model's force and torque, each (n, 3, model.size)."""
    g_s = gravity(state, samples)
    n = len(samples)
    force, torque = np.zeros((n, 3, LINEAR)), np.zeros((n, 3, LINEAR))
    force[:, :, 0] = g_s
    force[:, :, 4:7] = np.eye(3)
    torque[:, :, 1:4] = -_skews(g_s)
    torque[:, :, 7:10] = np.eye(3)
    turns = []
    if model.tilt:  # g' = exp([e]x) g, e perpendicular to g
        g = GRAVITY_M_S2 * state.down_in_base
        turn = -skew(g) @ _across(state.down_in_base)
        turns.append(np.swapaxes(samples.R_base_sensor @ state.R_mount, 1, 2) @ turn)
    if model.mounting:  # R_mount' = R_mount exp([d]x), so g_s' = g_s + [g_s]x d
        turns.append(_skews(g_s))
    if not turns:
        return force, torque
    g_turn = np.concatenate(turns, axis=2)
    m, h = state.linear[0], state.linear[1:4]
    return (
        np.concatenate([force, m * g_turn], axis=2),
        np.concatenate([torque, skew(h) @ g_turn], axis=2),
    )


def _step(
    state: State, samples: Samples, weight: Array, *, model: Model, noise: Noise
) -> tuple[Array, Array, Array, float]:
    """Return Gauss-Newton step, unknowns borne by force and torque, covariance, conditioning."""
    blocks = zip(
        jacobians(state, samples, model),
        residuals(state, samples),
        (noise.force_N, noise.torque_Nm),
        strict=True,
    )
    squares, slope = [], np.zeros(model.size)
    for J, error, deviation in blocks:
        A = (J * (np.sqrt(weight) / deviation)[:, None, None]).reshape(-1, model.size)
        r = (error * (np.sqrt(weight) / deviation)[:, None]).ravel()
        squares.append(A.T @ A)
        slope += A.T @ r
    total = squares[0] + squares[1]
    length = np.sqrt(np.diag(total))
    length[length == 0.0] = 1.0
    # Columns of length 1 make the conditioning free of units (Belsley, Kuh, Welsch 1980).
    eigenvalues, V = np.linalg.eigh(total / np.outer(length, length))
    s = np.sqrt(np.maximum(eigenvalues, 0.0))
    conditioning = float(s[-1] / s[0]) if s[0] > 0.0 else np.inf
    keep = s > s[-1] * RANK_TOLERANCE
    half = V[:, keep] / s[keep] / length[:, None]
    covariance = half @ half.T
    shares = np.array([np.trace(covariance @ square) for square in squares])
    return covariance @ slope, shares, covariance, conditioning


def _fitted_linear(samples: Samples, weight: Array, start: State) -> State:
    noise = Noise(1.0, 1.0)  # the two blocks share no unknown here, so their weights do not matter
    still = replace(start, linear=np.zeros(LINEAR))
    step, _, _, _ = _step(still, samples, weight, model=Model("plain"), noise=noise)
    return replace(still, linear=step)


def _upright(state: State) -> State:
    """Make the mass positive: a negative one is the same as gravity pointing up."""
    if state.linear[0] >= 0.0:
        return state
    flip = np.array([-1.0] * 4 + [1.0] * 6)
    return replace(state, linear=state.linear * flip, down_in_base=-state.down_in_base)


def _moved(state: State, step: Array, model: Model) -> State:
    turn = step[LINEAR:]
    size = float(np.linalg.norm(turn))
    if size > LARGEST_TURN_RAD:
        turn = turn * (LARGEST_TURN_RAD / size)
    down, R_mount = state.down_in_base, state.R_mount
    if model.tilt:
        down = rotation_from_vector(_across(down) @ turn[:2]) @ down
        down = down / np.linalg.norm(down)
    if model.mounting:
        R_mount = R_mount @ rotation_from_vector(turn[-3:])
    return State(state.linear + step[:LINEAR], down, R_mount)


def _noise(state: State, samples: Samples, weight: Array, shares: Array) -> tuple[Noise, Noise]:
    """Return unbiased and maximum-likelihood noise; `shares` are the unknowns of each block."""
    pairs = []
    for v, share in zip(residuals(state, samples), shares, strict=True):
        total = float((weight[:, None] * v**2).sum())
        equations = v.size
        pairs.append((total / max(equations - float(share), 1.0), total / equations))
    (force, force_ml), (torque, torque_ml) = pairs
    return _floored(force, torque), _floored(force_ml, torque_ml)


def _floored(force_variance: float, torque_variance: float) -> Noise:
    return Noise(
        max(float(np.sqrt(force_variance)), FORCE_FLOOR_N),
        max(float(np.sqrt(torque_variance)), TORQUE_FLOOR_NM),
    )


def _across(direction: Array) -> Array:
    """Return two unit vectors across a direction. Shape (3, 2)."""
    _, _, Vt = np.linalg.svd(direction[None, :])
    return np.asarray(Vt[1:].T)


def _skews(v: Array) -> Array:
    """Return [v]x for each row. Shape (n, 3) to (n, 3, 3)."""
    x, y, z = v.T
    o = np.zeros_like(x)
    return np.stack([np.stack([o, -z, y], 1), np.stack([z, o, -x], 1), np.stack([-y, x, o], 1)], 1)
