"""Poses of a recording: screening and grouping of its rows, and the conditioning of a fit to them.

Screening rejects rows in motion, in contact or with a stale pose.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from common.motion.frames import Array
from forcemesh.errors import DataError
from identification.payload_fit import DOWN, Directions, conditioning, solve
from identification.recording import Poses, Samples

SAME_POSE_RAD = np.radians(0.5)  # consecutive rows this close belong to one pose
DISTINCT_RAD = np.radians(3.0)  # attitudes closer than this add no information
ROWS_AT_MOST = 10.0
LEAST_POSES = 4
WORST_CONDITIONING = 30.0  # amplification of the noise; 10 is fair, 1 is ideal
ADVICE = "turn the wrist by at least 60 degrees about two axes"

MOVING = "the arm was turning"
CONTACT = "in contact, or touched"
STALE = "the pose is stale: the reading is that of the pose before or after"
SCREENING_WINDOW_S = 0.1  # of the speed: in a shorter one the noise of the pose reads as motion
SPEED_RAD_S = np.radians(1.0)
LEAST_TURN_RAD = np.radians(0.05)
SINGLE_RAD = np.radians(10.0)  # rows further apart are separate poses, not a motion
ROWS_TO_JUDGE = 10  # a shorter dwell has no reliable statistics
UNUSUAL = 8.0  # robust standard deviations
APART = np.array([0.5, 0.03])  # [N], [N m]; smaller deviations are never taken for contact
SAME_DWELL_SHARE = 0.3  # ratio at which a reading belongs to another pose
POSES_TO_JUDGE = 7
MOST_TOUCHED = 20  # limit of the search
OUTLYING = 60.0  # F of three components: one false alarm in a million recordings


def sort_into_poses(samples: Samples) -> Poses:
    """Average the rows of each dwell: consecutive rows within half a degree of its first one.

    Errors of attitude and calibration are common to a dwell, so its weight grows more slowly than
    its number of rows and saturates at ten rows (as with an intra-dwell correlation of 0.1).
    """
    first = _starts(samples.R_base_sensor)
    count = np.diff(np.append(first, len(samples)))
    sums = [
        np.add.reduceat(v, first, axis=0)
        for v in (samples.R_base_sensor, samples.force_N, samples.torque_Nm)
    ]
    U, _, Vt = np.linalg.svd(sums[0])  # the rotation nearest to the mean matrix
    t = samples.time_s
    time_s = None if t is None else np.add.reduceat(t, first) / count
    means = Samples(U @ Vt, sums[1] / count[:, None], sums[2] / count[:, None], time_s)
    return Poses(means, count / (1.0 + (count - 1.0) / ROWS_AT_MOST), first)


def check_poses(poses: Poses, down_in_base: Array = DOWN) -> None:
    """Raise DataError with the reason when the poses do not determine the plain model."""
    attitudes = _distinct(poses.means.R_base_sensor)
    if attitudes < LEAST_POSES:
        raise DataError(
            f"only {attitudes} distinct pose(s), attitudes within 3 degrees count as one; "
            f"record at least {LEAST_POSES}, better 8: {ADVICE}"
        )
    found = conditioning(poses.means.R_base_sensor, down_in_base)
    if found <= WORST_CONDITIONING:
        return
    widest_deg, narrowest_deg = _extent_deg(poses.means.R_base_sensor, down_in_base)
    if widest_deg < 1.0:
        problem = "the poses differ only by turns about the vertical, which do not change gravity"
    elif widest_deg < 60.0:
        problem = f"the poses differ by only {widest_deg:.0f} degrees"
    else:
        problem = (
            f"the poses tilt about one axis only ({narrowest_deg:.0f} degrees about the other)"
        )
    raise DataError(
        f"{problem} (condition number {found:.3g}, at most {WORST_CONDITIONING:.0f}); {ADVICE}"
    )


def carries_a_fit(poses: Poses, down_in_base: Array = DOWN) -> bool:
    """Return whether number and spread of the poses determine the plain model."""
    try:
        check_poses(poses, down_in_base)
    except DataError:
        return False
    return True


def _starts(R: Array) -> npt.NDArray[np.intp]:
    """Return the first row of each dwell; each row is compared with the first of its dwell."""
    first = [0]
    while True:
        start = first[-1]
        # In blocks: linear time for a long recording of short dwells.
        block, row = 64, start + 1
        while row < len(R):
            is_far = np.flatnonzero(angle(R[start], R[row : row + block]) > SAME_POSE_RAD)
            if is_far.size:
                first.append(row + int(is_far[0]))
                break
            row, block = row + block, block * 2
        else:
            return np.array(first, dtype=np.intp)


def angle(R: Array, R_others: Array) -> Array:
    """Return the angles between attitudes [rad]. Shapes (3, 3) or (n, 3, 3) each."""
    # From the chord |R1 - R2| = 2 sqrt(2) sin(angle / 2): exact also for small angles.
    chord = np.linalg.norm(R_others - R, axis=(-2, -1))
    return np.asarray(2.0 * np.arcsin(np.clip(chord / np.sqrt(8.0), 0.0, 1.0)))


def _distinct(R: Array) -> int:
    """Count distinct attitudes, up to LEAST_POSES."""
    found = R[:1]
    for attitude in R[1:]:
        if angle(attitude, found).min() > DISTINCT_RAD:
            found = np.concatenate([found, attitude[None]])
            if len(found) >= LEAST_POSES:
                break
    return len(found)


def _extent_deg(R: Array, down_in_base: Array) -> Array:
    """Return the extent of gravity's direction in the sensor, along its widest axis and across."""
    down = down_in_base @ R
    down = down - down.mean(axis=0)
    reach = np.ptp(down @ np.linalg.svd(down)[2][:2].T, axis=0)
    return np.asarray(np.degrees(2.0 * np.arcsin(np.clip(reach / 2.0, 0.0, 1.0))))


# --- screening ------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Rejected:
    """Rejected rows, by index in the recording, with the reason."""

    reason: str
    rows: tuple[int, ...]


def screen_samples(
    samples: Samples, down_in_base: Array = DOWN
) -> tuple[Poses, tuple[Rejected, ...]]:
    """Return the usable poses, and the rejected rows with the reason.

    A recording without rest is used as it is: slow rotation does less harm than no fit. Permanent
    contact in all poses cannot be distinguished from bias and weight.
    """
    rows = np.arange(len(samples))
    rejected = []
    moving = _moving_rows(samples)
    still = rows[~moving]
    if moving.any() and still.size and carries_a_fit(sort_into_poses(samples[still]), down_in_base):
        rejected.append(Rejected(MOVING, tuple(rows[moving].tolist())))
        rows = still
    for reason, outliers in _outlier_rows(samples[rows]).items():
        rejected.append(Rejected(reason, tuple(rows[outliers].tolist())))
    rows = np.setdiff1d(rows, [row for r in rejected for row in r.rows])
    poses = sort_into_poses(samples[rows])
    if touched := _touched_poses(poses, down_in_base):
        dwells = np.split(rows, poses.first_row[1:])
        in_contact = np.concatenate([dwells[pose] for pose in sorted(touched)])
        rejected.append(Rejected(CONTACT, tuple(in_contact.tolist())))
        rows = np.setdiff1d(rows, in_contact)
        poses = sort_into_poses(samples[rows])
    return replace(poses, first_row=rows[poses.first_row]), tuple(rejected)


def _moving_rows(samples: Samples) -> npt.NDArray[np.bool_]:
    """Return the rows during which the attitude changes, in small steps of time and angle."""
    n, t = len(samples), samples.time_s
    if t is None or n < 3 or np.any(np.diff(t) < 0.0):
        return np.zeros(n, dtype=bool)
    first = np.searchsorted(t, t - SCREENING_WINDOW_S / 2.0)
    last = np.searchsorted(t, t + SCREENING_WINDOW_S / 2.0, side="right") - 1
    before = np.maximum(np.minimum(first, np.arange(n) - 1), 0)
    after = np.minimum(np.maximum(last, np.arange(n) + 1), n - 1)
    R, duration_s = samples.R_base_sensor, t[after] - t[before]
    turned = angle(R[before], R[after])
    jumps = np.flatnonzero(angle(R[:-1], R[1:]) > SINGLE_RAD)
    jumped = np.searchsorted(jumps, after) > np.searchsorted(jumps, before)
    slow = turned <= np.maximum(SPEED_RAD_S * duration_s, LEAST_TURN_RAD)
    return np.asarray(~slow & ~jumped & (duration_s <= 1.0))


def _outlier_rows(samples: Samples) -> dict[str, list[int]]:
    """Return the rows whose reading is an outlier of its dwell, by reason."""
    readings = np.stack([samples.force_N, samples.torque_Nm], axis=1)
    first = sort_into_poses(samples).first_row
    dwells = np.split(np.arange(len(samples)), first[1:])
    middles = [np.median(readings[rows], axis=0) for rows in dwells]
    found: dict[str, list[int]] = {CONTACT: [], STALE: []}
    for place, rows in enumerate(dwells):
        if len(rows) < ROWS_TO_JUDGE:
            continue
        deviation = readings[rows] - middles[place]
        spread = UNUSUAL * 1.4826 * np.median(np.abs(deviation), axis=0)
        largest = np.maximum(APART, np.linalg.norm(spread, axis=1))
        sizes = np.linalg.norm(deviation, axis=2)
        neighbours = [middles[k] for k in (place - 1, place + 1) if 0 <= k < len(dwells)]
        for k in np.flatnonzero((sizes > largest).any(axis=1)):
            to_others_N = [np.linalg.norm((readings[rows[k]] - other)[0]) for other in neighbours]
            stale = min(to_others_N, default=np.inf) < SAME_DWELL_SHARE * sizes[k, 0]
            found[STALE if stale else CONTACT].append(int(rows[k]))
    return {reason: rows for reason, rows in found.items() if rows}


def _touched_poses(poses: Poses, down_in_base: Array) -> list[int]:
    """Return the outlying poses, by the decrease of the sum of squares without them."""
    remaining = list(range(len(poses)))
    outliers: list[int] = []
    while len(remaining) >= POSES_TO_JUDGE and len(outliers) < min(len(poses) // 4, MOST_TOUCHED):
        rest = poses[np.array(remaining)]
        plain = solve(rest, (), Directions(down_in_base))
        if not np.isfinite(plain.left_out).all():
            break
        statistic = _outlier_statistic(plain.residual, plain.left_out, rest.weight)
        worst = int(np.argmax(statistic))
        if statistic[worst] < OUTLYING:
            break
        outliers.append(remaining.pop(worst))
    return outliers


def _outlier_statistic(error: Array, left_out: Array, weight: Array) -> Array:
    """Return the F statistic of each pose: its share of the sum of squares over the residual.

    The larger one of force and torque counts, where the pose is far from the fit to the others.
    """
    total = (weight[:, None] * error**2).sum(axis=(1, 2))[:, None]
    added = weight * (error * left_out).sum(axis=2)
    freedom = 3.0 * (len(weight) - 1) - np.array([[4.0], [6.0]])
    variance = np.maximum(total - added, np.maximum(1e-12 * total, 1e-18)) / freedom
    is_apart = np.linalg.norm(left_out, axis=2) > APART[:, None]
    return np.asarray(np.where(is_apart, added / 3.0 / variance, 0.0).max(axis=0, initial=0.0))
