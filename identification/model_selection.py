"""Model selection for the payload fit, by evidence and leave-one-out error, simplest first."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from common.motion.frames import Array
from identification.least_squares import FORCE_FLOOR_N, TORQUE_FLOOR_NM, Solution, solve
from identification.payload_model import (
    DOWN,
    Model,
    State,
    gravity_in_sensor,
    residuals,
    start_state,
)
from identification.recording import Poses

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

    @property
    def score(self) -> float:
        """Return the product of force and torque error on left-out poses, independent of units."""
        force_N, torque_Nm = self.loo_force_N, self.loo_torque_Nm
        if not np.isfinite(force_N * torque_Nm):
            force_N, torque_Nm = self.rms_force_N, self.rms_torque_Nm
        return max(force_N, FORCE_FLOOR_N) * max(torque_Nm, TORQUE_FLOOR_NM)

    @property
    def weighs(self) -> bool:
        """Return whether its mass exceeds three standard deviations."""
        deviation = np.sqrt(self.solution.covariance[0, 0])
        return bool(self.solution.state.linear[0] >= 3.0 * deviation)


def fitted_candidates(poses: Poses) -> tuple[Candidate, tuple[Candidate, ...]]:
    """Fit every model that the poses support; return the one to use, and all, the plain one first.

    The model with the highest evidence is used, if it also predicts left-out poses better than
    the plain one.
    """
    starts, t = _start_states(poses), poses.means.time_s
    orders = (0,) if t is None or np.ptp(t) == 0.0 else (0, 1)
    models = [Model(*m) for m in product((False, True), (False, True), (False, True), orders)]
    plain = _fitted_candidate(poses, models[0], starts)

    def judged_candidate(model: Model) -> Candidate:
        candidate = _fitted_candidate(poses, model, starts)
        return replace(candidate, verdict=_rejection_reason(candidate, plain, len(poses)))

    candidates = [plain, *map(judged_candidate, models[1:])]
    best = _best_candidate(candidates)
    if len(orders) > 1:  # quadratic drift is tried only on top of the best model
        candidates.append(judged_candidate(replace(best.model, drift=2)))
        best = _best_candidate(candidates)
    used = replace(best, verdict="used")
    return used, tuple(
        used if c is best else replace(c, verdict=c.verdict or "another has more evidence")
        for c in candidates
    )


def _best_candidate(candidates: Sequence[Candidate]) -> Candidate:
    eligible = [c for c in candidates if not c.verdict]
    return max(eligible, key=lambda c: (c.weighs, c.evidence))


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
    """Fit a model from each start, less the directions that it does not correct; take the best."""
    allowed = (
        replace(
            start,
            down_in_base=start.down_in_base if model.tilt else DOWN,
            R_mount=start.R_mount if model.mounting else np.eye(3),
        )
        for start in starts
    )
    solution = max(
        (solve(poses, model, start) for start in allowed),
        key=lambda solution: solution.evidence,
    )
    return Candidate(
        model,
        solution,
        *_rms(residuals(solution.state, poses.means)),
        *_rms(solution.loo_residual),
        evidence=solution.evidence - PRICE * model.groups,
        verdict="",
    )


def _start_states(poses: Poses) -> list[State]:
    """Return start directions: none corrected, and a rotated sensor if it is far off.

    F = A u + b is linear in A = m R_mount^T, whose nearest rotation comes from its singular
    vectors; det A < 0 is gravity pointing up.
    """
    level, samples = start_state(), poses.means
    u = gravity_in_sensor(samples.R_base_sensor, DOWN)
    columns = np.column_stack([u, np.ones(len(u))])
    A = np.linalg.lstsq(columns, samples.force_N, rcond=None)[0][:3].T
    sign = 1.0 if np.linalg.det(A) >= 0.0 else -1.0
    U, _, Vt = np.linalg.svd(sign * A)
    R_mount = (U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt).T
    if (np.trace(R_mount) - 1.0) / 2.0 > np.cos(FAR_RAD):
        return [level]
    return [level, replace(level, R_mount=R_mount, down_in_base=sign * DOWN)]


def _rms(residual: Array) -> tuple[float, float]:
    """Return the rms of the norms of force [N] and torque [N m]."""
    force_N, torque_Nm = np.sqrt((residual**2).sum(axis=2).mean(axis=1)).tolist()
    return force_N, torque_Nm
