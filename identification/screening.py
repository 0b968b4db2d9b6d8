"""Screening of a recording: rejects rows in motion, in contact or with a stale pose."""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from common.motion.frames import Array
from identification.least_squares import solve
from identification.payload_model import Model, residuals, start_state
from identification.recording import Samples
from identification.static_poses import Poses, angle, carries_a_fit, sort_into_poses

MOVING = "the arm was turning"
CONTACT = "in contact, or touched"
STALE = "the pose is stale: the reading is that of the pose before or after"
SCREENING_WINDOW_S = 0.1  # of the speed: in a shorter one the noise of the pose reads as motion
SPEED_RAD_S = np.radians(1.0)
LEAST_TURN_RAD = np.radians(0.05)
SINGLE_RAD = np.radians(10.0)  # rows further apart are separate poses, not a motion
ROWS_TO_JUDGE = 10  # a shorter dwell has no reliable statistics
UNUSUAL = 8.0  # robust standard deviations
APART_N, APART_NM = 0.5, 0.03  # smaller deviations are never taken for contact
SAME_DWELL_SHARE = 0.3  # ratio at which a reading belongs to another pose
POSES_TO_JUDGE = 7
MOST_TOUCHED = 20  # limit of the search
OUTLYING = 60.0  # F of three components: one false alarm in a million recordings

Rows = npt.NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Rejected:
    """Rejected rows, by index in the recording, with the reason."""

    reason: str
    rows: tuple[int, ...]


def screen_samples(samples: Samples) -> tuple[Poses, tuple[Rejected, ...]]:
    """Return the usable poses, and the rejected rows with the reason.

    A recording without rest is used as it is: slow rotation does less harm than no fit. Permanent
    contact in all poses cannot be distinguished from bias and weight.
    """
    rows = np.arange(len(samples))
    rejected = []
    moving = _moving_rows(samples)
    still = rows[~moving]
    if moving.any() and still.size and carries_a_fit(sort_into_poses(samples[still])):
        rejected.append(Rejected(MOVING, tuple(rows[moving].tolist())))
        rows = still
    for reason, outliers in _outlier_rows(samples[rows]).items():
        rejected.append(Rejected(reason, tuple(rows[outliers].tolist())))
    rows = np.setdiff1d(rows, [row for r in rejected for row in r.rows])
    poses = sort_into_poses(samples[rows])
    touched = _touched_poses(poses)
    if touched:
        dwell = np.repeat(np.arange(len(poses)), np.diff([*poses.first_row, len(rows)]))
        in_contact = np.isin(dwell, touched)
        rejected.append(Rejected(CONTACT, tuple(rows[in_contact].tolist())))
        rows = rows[~in_contact]
        poses = sort_into_poses(samples[rows])
    return replace(poses, first_row=rows[poses.first_row]), tuple(rejected)


def _moving_rows(samples: Samples) -> npt.NDArray[np.bool_]:
    """Return the rows during which the attitude changes, in small steps of time and angle."""
    n, t = len(samples), samples.time_s
    if t is None or n < 3 or np.any(np.diff(t) < 0.0):
        return np.zeros(n, dtype=bool)
    before = np.searchsorted(t, t - SCREENING_WINDOW_S / 2.0)
    after = np.searchsorted(t, t + SCREENING_WINDOW_S / 2.0, side="right") - 1
    before = np.where(before == np.arange(n), np.maximum(np.arange(n) - 1, 0), before)
    after = np.where(after == np.arange(n), np.minimum(np.arange(n) + 1, n - 1), after)
    R, duration_s = samples.R_base_sensor, t[after] - t[before]
    turned = angle(R[before], R[after])
    jumps = np.flatnonzero(angle(R[:-1], R[1:]) > SINGLE_RAD)
    jumped = np.searchsorted(jumps, after) > np.searchsorted(jumps, before)
    slow = turned <= np.maximum(SPEED_RAD_S * duration_s, LEAST_TURN_RAD)
    return np.asarray(~slow & ~jumped & (duration_s <= 1.0))


def _outlier_rows(samples: Samples) -> dict[str, Rows]:
    """Return the rows whose reading is an outlier of its dwell, by reason."""
    first = sort_into_poses(samples).first_row
    dwells = np.split(np.arange(len(samples)), first[1:])
    middles = [_median_reading(samples, rows) for rows in dwells]
    found: dict[str, list[int]] = {CONTACT: [], STALE: []}
    for place, rows in enumerate(dwells):
        if len(rows) < ROWS_TO_JUDGE:
            continue
        deviation = _readings(samples, rows) - middles[place]
        spread = UNUSUAL * 1.4826 * np.median(np.abs(deviation), axis=0)
        is_outlier = np.linalg.norm(deviation[:, :3], axis=1) > max(
            APART_N, np.linalg.norm(spread[:3])
        )
        is_outlier |= np.linalg.norm(deviation[:, 3:], axis=1) > max(
            APART_NM, np.linalg.norm(spread[3:])
        )
        neighbours = [middles[k] for k in (place - 1, place + 1) if 0 <= k < len(dwells)]
        for row, row_deviation in zip(rows[is_outlier], deviation[is_outlier], strict=True):
            reading = row_deviation + middles[place]
            distances_N = [np.linalg.norm((reading - other)[:3]) for other in neighbours]
            stale = bool(distances_N) and min(distances_N) < SAME_DWELL_SHARE * np.linalg.norm(
                row_deviation[:3]
            )
            found[STALE if stale else CONTACT].append(int(row))
    return {reason: np.array(rows, dtype=np.intp) for reason, rows in found.items() if rows}


def _touched_poses(poses: Poses) -> list[int]:
    """Return the outlying poses, by the decrease of the sum of squares without them."""
    remaining = list(range(len(poses)))
    outliers: list[int] = []
    while len(remaining) >= POSES_TO_JUDGE and len(outliers) < min(len(poses) // 4, MOST_TOUCHED):
        rows = np.array(remaining)
        means, weight = poses.means[rows], poses.weight[rows]
        plain = solve(means, weight, Model(), start_state())
        error = residuals(plain.state, means)
        if not np.isfinite(plain.loo_residual).all():
            break
        worst = max(
            range(len(remaining)),
            key=lambda i: _outlier_statistic(error, plain.loo_residual, weight, pose=i),
        )
        if _outlier_statistic(error, plain.loo_residual, weight, pose=worst) < OUTLYING:
            break
        outliers.append(remaining.pop(worst))
    return outliers


def _outlier_statistic(error: Array, loo_residual: Array, weight: Array, *, pose: int) -> float:
    """Return the F statistic of a pose: its share of the sum of squares over the residual."""
    largest = 0.0
    for block, (unknowns, least_deviation) in enumerate(((4.0, APART_N), (6.0, APART_NM))):
        total = float((weight[:, None] * error[block] ** 2).sum())
        added = float(weight[pose] * (error[block, pose] @ loo_residual[block, pose]))
        freedom = 3.0 * (len(weight) - 1) - unknowns
        residual_variance = max(total - added, 1e-12 * total, 1e-18) / freedom
        if np.linalg.norm(loo_residual[block, pose]) > least_deviation:
            largest = max(largest, added / 3.0 / residual_variance)
    return largest


def _readings(samples: Samples, rows: Rows) -> Array:
    return np.hstack([samples.force_N[rows], samples.torque_Nm[rows]])


def _median_reading(samples: Samples, rows: Rows) -> Array:
    return np.asarray(np.median(_readings(samples, rows), axis=0))
