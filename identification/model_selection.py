"""Model selection for the payload fit, by evidence and leave-one-out error, simplest first."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from common.motion.frames import GRAVITY_M_S2, Array
from identification.least_squares import FORCE_FLOOR_N, TORQUE_FLOOR_NM, Solution, solve
from identification.payload_model import DOWN, Model, State, residuals, start_state
from identification.static_poses import Poses

PLAIN = Model()
LEAST_POSES_TO_COMPARE = 6  # two more than the plain model needs
PRICE = 3.0  # penalty on the evidence for each further error: absent in three recordings of four
SCORE_GAIN = 0.9  # required ratio of leave-one-out errors, force and torque together,
NOT_WORSE = 1.1  # and neither clearly worse: a true tilt or mounting rotates both
FAR_RAD = np.radians(10.0)  # a larger rotation of the sensor is not found from an unrotated start


@dataclass(frozen=True, slots=True)
class Candidate:
    """One model, fitted and evaluated. `loo` is the error on poses left out of the fit.

    Rms values are over the norms of the poses' residuals; loo is infinite if leaving poses out
    makes the rest insufficient. `evidence` is a logarithm with the model's penalty subtracted.
    """

    model: Model
    solution: Solution
    rms_force_N: float
    rms_torque_Nm: float
    loo_force_N: float
    loo_torque_Nm: float
    evidence: float
    verdict: str
    chosen: bool = False

    @property
    def score(self) -> float:
        """Return the product of force and torque error on left-out poses, independent of units."""
        fit_error = max(self.rms_force_N, FORCE_FLOOR_N) * max(self.rms_torque_Nm, TORQUE_FLOOR_NM)
        loo_error = max(self.loo_force_N, FORCE_FLOOR_N) * max(self.loo_torque_Nm, TORQUE_FLOOR_NM)
        return loo_error if np.isfinite(loo_error) else fit_error

    @property
    def weighs(self) -> bool:
        """Return whether its mass exceeds three standard deviations."""
        deviation = np.sqrt(self.solution.covariance[0, 0])
        return bool(self.solution.state.linear[0] >= 3.0 * deviation)


def fitted_candidates(poses: Poses) -> tuple[Candidate, ...]:
    """Fit every model that the poses support; mark the one to use. The plain one comes first.

    The model with the highest evidence is used, if it also predicts left-out poses better than
    the plain one.
    """
    starts = _start_states(poses)
    plain = _fitted_candidate(poses, PLAIN, [start_state()])
    t = poses.means.time_s
    orders = (0,) if t is None or np.ptp(t) == 0.0 else (0, 1)
    models = [Model(*m) for m in product((False, True), (False, True), (False, True), orders)]
    extended = [
        _evaluated_candidate(poses, model, starts, plain) for model in models if model != PLAIN
    ]
    best = _best_candidate([plain, *extended])
    if len(orders) > 1:  # quadratic drift is tried only on top of the best model
        extended.append(_evaluated_candidate(poses, replace(best.model, drift=2), starts, plain))
        best = _best_candidate([plain, *extended])
    return tuple(
        replace(c, chosen=True, verdict="used")
        if c is best
        else replace(c, verdict=c.verdict or "another has more evidence")
        for c in (plain, *extended)
    )


def _best_candidate(candidates: Sequence[Candidate]) -> Candidate:
    eligible = [c for c in candidates if not c.verdict]
    return max(eligible, key=lambda c: (c.weighs, c.evidence))


def _evaluated_candidate(
    poses: Poses, model: Model, starts: Sequence[State], plain: Candidate
) -> Candidate:
    allowed = [_allowed_start(start, model) for start in starts]
    # Starts that differ only in directions that the model does not correct are one start.
    if all(_same_directions(start, allowed[0]) for start in allowed):
        allowed = allowed[:1]
    candidate = _fitted_candidate(poses, model, allowed)
    return replace(candidate, verdict=_rejection_reason(candidate, plain, len(poses)))


def _allowed_start(start: State, model: Model) -> State:
    """Return a start without the directions that its model does not correct."""
    return replace(
        start,
        down_in_base=start.down_in_base if model.tilt else DOWN,
        R_mount=start.R_mount if model.mounting else np.eye(3),
    )


def _same_directions(a: State, b: State) -> bool:
    return np.array_equal(a.R_mount, b.R_mount) and np.array_equal(a.down_in_base, b.down_in_base)


def _rejection_reason(candidate: Candidate, plain: Candidate, poses: int) -> str:
    """Return why a richer candidate must not replace the plain one; empty when it may."""
    if poses < LEAST_POSES_TO_COMPARE:
        return f"too few poses to decide ({poses}, at least {LEAST_POSES_TO_COMPARE})"
    if not candidate.solution.converged:
        return "the fit does not converge"
    if not np.isfinite(candidate.loo_force_N):
        return "it depends on a single pose"
    if not candidate.weighs:
        return "it finds no weight"
    if not plain.weighs:
        return ""
    if candidate.evidence <= plain.evidence:
        return "not significant"
    error_ratio = max(
        candidate.loo_force_N / max(plain.loo_force_N, FORCE_FLOOR_N),
        candidate.loo_torque_Nm / max(plain.loo_torque_Nm, TORQUE_FLOOR_NM),
    )
    if error_ratio > NOT_WORSE or candidate.score > plain.score * SCORE_GAIN**2:
        return "predicts left-out poses no better"
    return ""


def _fitted_candidate(poses: Poses, model: Model, starts: Sequence[State]) -> Candidate:
    solution = max(
        (solve(poses.means, poses.weight, model, start) for start in starts),
        key=lambda solution: solution.evidence,
    )
    force, torque = residuals(solution.state, poses.means)
    return Candidate(
        model=model,
        solution=solution,
        rms_force_N=_rms(force),
        rms_torque_Nm=_rms(torque),
        loo_force_N=_rms(solution.loo_residual[0]),
        loo_torque_Nm=_rms(solution.loo_residual[1]),
        evidence=solution.evidence - PRICE * model.groups,
        verdict="",
    )


def _start_states(poses: Poses) -> list[State]:
    """Return start directions: none corrected, and a rotated sensor if it is far off.

    F = A u + b is linear in A = m R_mount^T, whose nearest rotation comes from its singular
    vectors; det A < 0 is gravity pointing up.
    """
    level, samples = start_state(), poses.means
    u = GRAVITY_M_S2 * np.swapaxes(samples.R_base_sensor, 1, 2) @ DOWN
    A = _linear_fit(np.einsum("ij,nk->nijk", np.eye(3), u).reshape(len(u), 3, 9), samples.force_N)
    sign = 1.0 if np.linalg.det(A.reshape(3, 3)) >= 0.0 else -1.0
    U, _, Vt = np.linalg.svd(sign * A.reshape(3, 3))
    R_mount = (U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt).T
    if (np.trace(R_mount) - 1.0) / 2.0 > np.cos(FAR_RAD):
        return [level]
    return [level, replace(level, R_mount=R_mount, down_in_base=sign * DOWN)]


def _linear_fit(columns: Array, force_N: Array) -> Array:
    """Return x of F = columns x + b by least squares. columns has shape (n, 3, k)."""
    n, _, k = columns.shape
    bias = np.broadcast_to(np.eye(3), (n, 3, 3))
    A = np.concatenate([columns, bias], axis=2).reshape(3 * n, k + 3)
    return np.asarray(np.linalg.lstsq(A, force_N.ravel(), rcond=None)[0][:k])


def _rms(residual: Array) -> float:
    return float(np.sqrt((residual**2).sum(axis=1).mean()))
