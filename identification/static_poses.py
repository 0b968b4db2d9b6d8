"""Poses of a recording: grouping of its rows, and the conditioning of a fit to them."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from common.motion.frames import Array
from forcemesh.errors import DataError
from identification.least_squares import plain_conditioning, solve
from identification.payload_model import Model, start_state
from identification.recording import Samples

SAME_POSE_RAD = np.radians(0.5)  # consecutive rows this close belong to one pose
DISTINCT_RAD = np.radians(3.0)  # attitudes closer than this add no information
ROWS_AT_MOST = 10.0
LEAST_POSES = 4
WORST_CONDITIONING = 30.0  # amplification of the noise; 10 is fair, 1 is ideal
ADVICE = "turn the wrist by at least 60 degrees about two axes"


@dataclass(frozen=True, slots=True)
class Poses:
    """Mean reading of each pose, in recorded order, with its weight.

    `first_row` has shape (n,): the row of the recording at which each pose begins.
    """

    means: Samples
    weight: Array
    first_row: npt.NDArray[np.intp]

    def __len__(self) -> int:
        """Return the number of poses."""
        return len(self.means)


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


def check_poses(poses: Poses) -> None:
    """Raise DataError with the reason when the poses do not determine the plain model."""
    attitudes = _distinct(poses.means.R_base_sensor)
    if attitudes < LEAST_POSES:
        raise DataError(
            f"only {attitudes} distinct pose(s), attitudes within 3 degrees count as one; "
            f"record at least {LEAST_POSES}, better 8: {ADVICE}"
        )
    if carries_a_fit(poses):
        return
    plain = solve(poses.means, poses.weight, Model(), start_state())
    widest_deg, narrowest_deg = _extent_deg(poses.means.R_base_sensor)
    if widest_deg < 1.0:
        problem = "the poses differ only by turns about the vertical, which do not change gravity"
    elif widest_deg < 60.0:
        problem = f"the poses differ by only {widest_deg:.0f} degrees"
    else:
        problem = (
            f"the poses tilt about one axis only ({narrowest_deg:.0f} degrees about the other)"
        )
    raise DataError(
        f"{problem} (condition number {plain.conditioning:.3g}, "
        f"at most {WORST_CONDITIONING:.0f}); {ADVICE}"
    )


def carries_a_fit(poses: Poses) -> bool:
    """Return whether number and spread of the poses determine the plain model."""
    if len(poses) == 0 or _distinct(poses.means.R_base_sensor) < LEAST_POSES:
        return False
    return plain_conditioning(poses.means, poses.weight) <= WORST_CONDITIONING


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
    """Return the angles between attitudes [rad]. Shapes (3, 3) or (n, 3, 3), and (n, 3, 3)."""
    # From the chord |R1 - R2| = 2 sqrt(2) sin(angle / 2): exact also for small angles.
    chord = np.linalg.norm(R_others - R, axis=(1, 2))
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


def _extent_deg(R: Array) -> tuple[float, float]:
    """Return the extent of gravity's direction in the sensor, along its widest axis and across."""
    down = -R[:, 2, :]
    centre = down.mean(axis=0)
    _, _, Vt = np.linalg.svd(down - centre)
    reach = np.ptp((down - centre) @ Vt[:2].T, axis=0)
    widest_deg, narrowest_deg = np.degrees(2.0 * np.arcsin(np.clip(reach / 2.0, 0.0, 1.0)))
    return float(widest_deg), float(narrowest_deg)
