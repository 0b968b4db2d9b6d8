"""Chooses how rich a payload model the data carry: simplest first, more only when it is earned."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from common.frames import GRAVITY_M_S2, Array
from services.wrench.least_squares import (
    DOWN,
    FORCE_FLOOR_N,
    REFINEMENTS,
    TORQUE_FLOOR_NM,
    Model,
    Solution,
    State,
    residuals,
    solve,
    start_state,
)
from services.wrench.poses import WORST_CONDITIONING, Poses

PLAIN = Model("plain")
TILT = Model("tilt", tilt=True)
MOUNTING = Model("mounting", mounting=True)
BOTH = Model("tilt+mounting", tilt=True, mounting=True)

SPARE_POSES = 2  # beyond those that the plain model needs
FOLDS_AT_MOST = 20
BIC_GAIN = 10.0  # "very strong" evidence (Kass, Raftery: Bayes factors, JASA 1995)
SCORE_GAIN = 0.9  # left-out poses must be predicted this much closer, force and torque together,
NOT_WORSE = 1.01  # and neither worse: a true tilt or mounting turns both, a sensor's faults do not


@dataclass(frozen=True, slots=True)
class Candidate:
    """One model, fitted and judged. `loo` is the error on poses that the fit has not seen.

    Rms values are over the norms of the poses' residuals; loo is infinite where leaving poses out
    makes the rest insufficient.
    """

    model: Model
    solution: Solution
    rms_force_N: float
    rms_torque_Nm: float
    loo_force_N: float
    loo_torque_Nm: float
    bic: float
    verdict: str
    chosen: bool = False

    @property
    def score(self) -> float:
        """Product of force and torque error on unseen poses: neither unit outweighs the other."""
        seen = max(self.rms_force_N, FORCE_FLOOR_N) * max(self.rms_torque_Nm, TORQUE_FLOOR_NM)
        unseen = max(self.loo_force_N, FORCE_FLOOR_N) * max(self.loo_torque_Nm, TORQUE_FLOOR_NM)
        return unseen if np.isfinite(unseen) else seen


def choose(poses: Poses) -> tuple[Candidate, ...]:
    """Fit every model that the poses can carry; mark the one to use. The plain one comes first.

    A richer model must explain the recording better by BIC *and* predict left-out poses better.
    """
    plain = _fitted(poses, PLAIN, [start_state()])
    starts = _starts(poses)
    singles = [_judged(poses, model, starts, plain) for model in (TILT, MOUNTING)]
    best = min([plain, *(c for c in singles if not c.verdict)], key=lambda c: c.bic)
    both = _judged(poses, BOTH, starts, best)
    best = both if not both.verdict else best
    return tuple(
        replace(c, chosen=True, verdict="used")
        if c is best
        else replace(c, verdict=c.verdict or "another explains more")
        for c in (plain, *singles, both)
    )


def _judged(poses: Poses, model: Model, starts: Sequence[State], rival: Candidate) -> Candidate:
    candidate = _fitted(poses, model, [_allowed(start, model) for start in starts])
    return replace(candidate, verdict=_objection(candidate, rival, len(poses)))


def _allowed(start: State, model: Model) -> State:
    """Take out of a start what its model does not correct."""
    return State(
        start.linear,
        start.down_in_base if model.tilt else DOWN,
        start.R_mount if model.mounting else np.eye(3),
    )


def _objection(candidate: Candidate, best: Candidate, poses: int) -> str:
    """Return why a richer candidate is not to replace a simpler one; empty when it is."""
    solution = candidate.solution
    if poses < SPARE_POSES + 4:
        return f"too few poses to tell ({poses}, at least {SPARE_POSES + 4})"
    if not solution.converged:
        return "the fit does not settle"
    if solution.conditioning > WORST_CONDITIONING:
        return f"the poses cannot tell it (condition number {solution.conditioning:.3g})"
    if not np.isfinite(candidate.loo_force_N):
        return "it hangs on a single pose"
    if candidate.bic > best.bic - BIC_GAIN:
        return "not significant"
    worse = max(
        candidate.loo_force_N / max(best.loo_force_N, FORCE_FLOOR_N),
        candidate.loo_torque_Nm / max(best.loo_torque_Nm, TORQUE_FLOOR_NM),
    )
    if worse > NOT_WORSE or candidate.score > best.score * SCORE_GAIN**2:
        return "predicts left-out poses no better"
    return ""


def _fitted(poses: Poses, model: Model, starts: Sequence[State]) -> Candidate:
    solution = min(
        (solve(poses.means, poses.weight, model, start) for start in starts),
        key=lambda solution: solution.noise_ml.force_N * solution.noise_ml.torque_Nm,
    )
    force, torque = residuals(solution.state, poses.means)
    loo_force, loo_torque = _left_out(poses, model, solution)
    noise, equations = solution.noise_ml, 3 * len(poses)
    likelihood = 2.0 * equations * (np.log(noise.force_N) + np.log(noise.torque_Nm))
    return Candidate(
        model=model,
        solution=solution,
        rms_force_N=_rms(force),
        rms_torque_Nm=_rms(torque),
        loo_force_N=_rms(loo_force),
        loo_torque_Nm=_rms(loo_torque),
        bic=float(likelihood + model.size * np.log(2 * equations)),
        verdict="",
    )


def _left_out(poses: Poses, model: Model, solution: Solution) -> tuple[Array, Array]:
    """Return the residuals of poses under fits without them; infinite where there is no fit.

    Each pose is left out alone; in long recordings whole stretches are, as neighbours are alike.
    """
    n = len(poses)
    force, torque = np.full((n, 3), np.inf), np.full((n, 3), np.inf)
    for fold in np.array_split(np.arange(n), min(n, FOLDS_AT_MOST)):
        kept = np.setdiff1d(np.arange(n), fold)
        partial = solve(
            poses.means[kept],
            poses.weight[kept],
            model,
            solution.state,
            iterations=REFINEMENTS,
        )
        if partial.conditioning < 1e6:
            force[fold], torque[fold] = residuals(partial.state, poses.means[fold])
    return force, torque


def _starts(poses: Poses) -> list[State]:
    """Return directions to start from: none corrected, and the closed forms of tilt and mounting.

    Tilt: F = R^T p + b is linear in p = m g. Mounting: F = A u + b is linear in A = m R_mount^T,
    whose nearest rotation comes from its singular vectors; det A < 0 is gravity pointing up.
    """
    level, samples = start_state(), poses.means
    R_sensor_base = np.swapaxes(samples.R_base_sensor, 1, 2)
    p = _linear(R_sensor_base, samples.force_N)
    down = p / max(float(np.linalg.norm(p)), 1e-12)
    u = GRAVITY_M_S2 * R_sensor_base @ DOWN
    A = _linear(np.einsum("ij,nk->nijk", np.eye(3), u).reshape(len(u), 3, 9), samples.force_N)
    sign = 1.0 if np.linalg.det(A.reshape(3, 3)) >= 0.0 else -1.0
    U, _, Vt = np.linalg.svd(sign * A.reshape(3, 3))
    R_mount = (U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt).T
    starts = [level, replace(level, R_mount=R_mount, down_in_base=sign * DOWN)]
    if np.linalg.norm(p) > 0.0:
        starts.append(replace(level, down_in_base=down))
    return starts


def _linear(columns: Array, force_N: Array) -> Array:
    """Return x of F = columns x + b by least squares. columns has shape (n, 3, k)."""
    n, _, k = columns.shape
    bias = np.broadcast_to(np.eye(3), (n, 3, 3))
    A = np.concatenate([columns, bias], axis=2).reshape(3 * n, k + 3)
    return np.asarray(np.linalg.lstsq(A, force_N.ravel(), rcond=None)[0][:k])


def _rms(residual: Array) -> float:
    return float(np.sqrt((residual**2).sum(axis=1).mean()))
