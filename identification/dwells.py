"""Recorded readings of a calibration, in dwells, and their CSV file."""

import csv
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from common.motion.frames import Array, quaternion_from_R
from forcemesh.errors import DataError
from identification.recording import COLUMNS, Samples, WrenchRecording

Purpose = Literal["fit", "verify"]
DIGITS = 9


@dataclass(frozen=True, slots=True)
class Dwell:
    """Readings of an arm at rest: shapes (n,), (n, 3), (n, 3, 3), (n, 3), (n, 3).

    Poses are those of the sensor in base, readings in sensor axes. `residual_N` and `residual_Nm`
    are the running cell's residual wrench about the sensor's origin; None when none was received.
    """

    purpose: Purpose
    time_s: Array
    position_m: Array
    R_base_sensor: Array
    force_N: Array
    torque_Nm: Array
    residual_N: Array | None = None
    residual_Nm: Array | None = None

    def __len__(self) -> int:
        """Return the number of readings."""
        return len(self.time_s)

    @property
    def attitude(self) -> Array:
        """Attitude of the sensor in base: that of the last reading. Shape (3, 3)."""
        return np.asarray(self.R_base_sensor[-1])


def dwells_of_purpose(dwells: Iterable[Dwell], purpose: Purpose) -> list[Dwell]:
    """Return the dwells of a purpose: fit or verification."""
    return [dwell for dwell in dwells if dwell.purpose == purpose]


def samples_of(dwells: Sequence[Dwell]) -> Samples:
    """Return all readings concatenated, as input of a fit."""
    return recording_of(dwells).samples("sensor")


def means_of(dwells: Sequence[Dwell]) -> Samples:
    """Return the mean reading of each dwell."""
    return Samples(
        np.array([dwell.attitude for dwell in dwells]),
        np.array([dwell.force_N.mean(axis=0) for dwell in dwells]),
        np.array([dwell.torque_Nm.mean(axis=0) for dwell in dwells]),
        np.array([dwell.time_s.mean() for dwell in dwells]),
    )


def recording_of(dwells: Sequence[Dwell], source: Path | str = "") -> WrenchRecording:
    """Return the readings as `read_recording` would return their file."""
    joined = {
        name: np.concatenate([getattr(dwell, name) for dwell in dwells])
        for name in ("time_s", "position_m", "R_base_sensor", "force_N", "torque_Nm")
    }
    return WrenchRecording(str(source), tuple(range(2, len(joined["time_s"]) + 2)), **joined)


def save_dwells(dwells: Sequence[Dwell], path: Path) -> None:
    """Write every reading in the format of `forcemesh payload fit`; verification ones come last.

    Raises DataError when the file cannot be written.
    """
    ordered = [*dwells_of_purpose(dwells, "fit"), *dwells_of_purpose(dwells, "verify")]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file)
            writer.writerow([*COLUMNS, "pose", "use"])
            for number, dwell in enumerate(ordered, start=1):
                quaternions = [quaternion_from_R(R) for R in dwell.R_base_sensor]
                poses = dwell.time_s, dwell.position_m, quaternions
                for row in np.column_stack([*poses, dwell.force_N, dwell.torque_Nm]):
                    writer.writerow([*(f"{v:.{DIGITS}g}" for v in row), number, dwell.purpose])
    except OSError as error:
        raise DataError(f"{path}: cannot be written: {error.strerror}") from error
