"""Paths in CSV files: points of the TCP, or poses of the flange, millimetres and degrees. Pure.

    x_mm,y_mm,z_mm                          points of the TCP, base axes: `forcemesh follow`
    t_s,x_mm,y_mm,z_mm,o_deg,a_deg,t_deg    poses of the flange in base: `forcemesh guide`

Lines that begin with # and other columns are ignored.
"""

import csv
from collections.abc import Iterable, Sequence
from math import degrees, hypot, isfinite, radians
from pathlib import Path

import numpy as np
import pinocchio as pin

from common.config.cell_terms import LARGEST_ANGLE_DEG
from common.motion.frames import (
    Array,
    Oat,
    R_from_oat,
    oat_from_R,
    pose,
    rotation_between,
)
from forcemesh.errors import DataError

POINT = ("x_mm", "y_mm", "z_mm")
POSE = (*POINT, "o_deg", "a_deg", "t_deg")
MOST_ROWS = 100_000
ARM_M = 0.1  # lever arm: a rotation counts as the travel of a point at this distance


def read_points(path: Path) -> list[Array]:
    """Return points of the TCP in base [m], each of shape (3,). Raises DataError."""
    return [np.array(row) / 1e3 for row in _rows(path, POINT)]


def read_poses(path: Path) -> list[pin.SE3]:
    """Return poses of the flange in base. Raises DataError."""
    return [
        pose(np.array(row[:3]) / 1e3, R_from_oat(Oat(*(radians(angle) for angle in row[3:]))))
        for row in _rows(path, POSE)
    ]


def write_poses(path: Path, times_s: Sequence[float], poses: Sequence[pin.SE3]) -> None:
    """Write poses of the flange in base. Raises DataError when the file cannot be written."""
    before: Oat | None = None
    lines = [",".join(("t_s", *POSE))]
    for t_s, T in zip(times_s, poses, strict=True):
        before = oat_from_R(T.rotation, before)
        numbers = [1e3 * float(part) for part in T.translation]
        numbers += [degrees(angle) for angle in before]
        lines.append(",".join([f"{t_s:.3f}", *(f"{number:.4f}" for number in numbers)]))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    except OSError as error:
        raise DataError(f"{path}: cannot be written: {error.strerror}") from error


def thinned(poses: Sequence[pin.SE3], tolerance_m: float) -> list[pin.SE3]:
    """Return the poses needed for linear interpolation within a tolerance (Douglas-Peucker).

    A rotation counts as the travel of a point 100 mm away.
    """
    if len(poses) < 3:
        return list(poses)
    kept_indices, spans = {0, len(poses) - 1}, [(0, len(poses) - 1)]
    while spans:
        first, last = spans.pop()
        deviations_m = [(_deviation_m(poses, first, last, at), at) for at in range(first + 1, last)]
        largest_m, at = max(deviations_m, default=(0.0, first))
        if largest_m > tolerance_m:
            kept_indices.add(at)
            spans += [(first, at), (at, last)]
    return [poses[at] for at in sorted(kept_indices)]


def _deviation_m(poses: Sequence[pin.SE3], first: int, last: int, at: int) -> float:
    """Return the distance of a pose from the straight line between two others [m]."""
    a, b, T = poses[first], poses[last], poses[at]
    segment_m = b.translation - a.translation
    rotation = rotation_between(a.rotation, b.rotation)
    segment = np.concatenate((segment_m, ARM_M * rotation))
    offset_m = T.translation - a.translation
    offset = np.concatenate((offset_m, ARM_M * rotation_between(a.rotation, T.rotation)))
    square = float(segment @ segment)
    share = min(max(float(offset @ segment) / square, 0.0), 1.0) if square > 0.0 else 0.0
    return hypot(*offset - share * segment)


def _rows(path: Path, names: tuple[str, ...]) -> list[tuple[float, ...]]:
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise DataError(f"{path}: cannot be read: {reason}") from error
    rows = list(_numbers(path, [line for line in lines if not line.startswith("#")], names))
    if not rows:
        raise DataError(f"{path}: no rows: columns {','.join(names)}, then one row per pose")
    if len(rows) > MOST_ROWS:
        raise DataError(f"{path}: {len(rows)} rows, the limit is {MOST_ROWS}")
    return rows


def _numbers(
    path: Path, lines: Sequence[str], names: tuple[str, ...]
) -> Iterable[tuple[float, ...]]:
    reader = csv.DictReader(lines)
    found = [name.strip() for name in reader.fieldnames or []]
    missing = [name for name in names if name not in found]
    if missing:
        raise DataError(f"{path}: no column {', '.join(missing)}; found {', '.join(found) or '-'}")
    reader.fieldnames = found
    for number, row in enumerate(reader, start=2):
        try:
            values = tuple(float(row[name]) for name in names)
        except (TypeError, ValueError):
            raise DataError(f"{path}, row {number}: not {len(names)} numbers") from None
        if not all(isfinite(value) for value in values):
            raise DataError(f"{path}, row {number}: a number is not finite")
        for name, value in zip(names, values, strict=True):
            if name.endswith("_deg") and abs(value) > LARGEST_ANGLE_DEG:
                text = f"{name} is {value:g}, the limit is {LARGEST_ANGLE_DEG:g} degrees"
                raise DataError(f"{path}, row {number}: {text}")
        yield values
