"""Reader for CSV recordings of sensor poses and wrenches; errors name file, line and column."""

import csv
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, TextIO

import numpy as np
import numpy.typing as npt

from common.motion.frames import Array, R_from_quaternion
from forcemesh.errors import DataError
from forcemesh.records import checked_unit

WrenchAxes = Literal["sensor", "base"]

BOTH_AXES: tuple[WrenchAxes, ...] = ("sensor", "base")
COLUMNS = ("t", "x", "y", "z", "qx", "qy", "qz", "qw", "fx", "fy", "fz", "tx", "ty", "tz")
LONGEST_TEXT_LINE = 1 << 20  # characters: ten thousands of columns
HEADER_RULE = f"the header must be {','.join(COLUMNS)}"


@dataclass(frozen=True, slots=True)
class Samples:
    """Readings in sensor axes, about the sensor origin, with the attitude of each.

    R_base_sensor has shape (n, 3, 3); force_N and torque_Nm have shape (n, 3), time_s (n,);
    without times no drift can be identified.
    """

    R_base_sensor: Array
    force_N: Array
    torque_Nm: Array
    time_s: Array | None = None

    def __len__(self) -> int:
        """Return the number of readings."""
        return len(self.force_N)

    def __getitem__(self, rows: npt.NDArray[np.intp]) -> "Samples":
        """Return some of the readings, selected by index."""
        time_s = None if self.time_s is None else self.time_s[rows]
        return Samples(self.R_base_sensor[rows], self.force_N[rows], self.torque_Nm[rows], time_s)

    def from_base_axes(self) -> "Samples":
        """Return the readings in sensor axes, when these ones are in base axes.

        They are about the sensor origin too: only their axes are rotated.
        """
        force, torque = (
            np.einsum("nji,nj->ni", self.R_base_sensor, v) for v in (self.force_N, self.torque_Nm)
        )
        return replace(self, force_N=force, torque_Nm=torque)


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

    def __getitem__(self, rows: npt.NDArray[np.intp]) -> "Poses":
        """Return some of the poses, selected by index."""
        return Poses(self.means[rows], self.weight[rows], self.first_row[rows])


@dataclass(frozen=True, slots=True)
class WrenchRecording:
    """Recording as stored in the file; the axes of its wrench are not known here.

    time_s has shape (n,), R_base_sensor (n, 3, 3), the others (n, 3). `line` is the line of the
    file that each row came from.
    """

    source: str
    line: tuple[int, ...]
    time_s: Array
    position_m: Array
    R_base_sensor: Array
    force_N: Array
    torque_Nm: Array

    def samples(self, wrench_axes: WrenchAxes) -> Samples:
        """Return the readings in sensor axes; the recorded ones are in `wrench_axes`."""
        recorded = Samples(self.R_base_sensor, self.force_N, self.torque_Nm, self.time_s)
        return recorded if wrench_axes == "sensor" else recorded.from_base_axes()


def read_recording(path: Path) -> WrenchRecording:
    """Read a CSV recording with the columns t,x,y,z,qx,qy,qz,qw,fx,fy,fz,tx,ty,tz.

    Pose of the sensor in base [m, unit quaternion x y z w], wrench [N, Nm]. The columns may be in
    any order, other columns are ignored. Raises DataError naming file, line and column.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = list(_rows(path, bounded_lines(path, file)))
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise DataError(
            f"{path}: is not UTF-8 text (byte {error.start}); save the recording as UTF-8 CSV"
        ) from error
    if not rows:
        raise DataError(f"{path}, line 2: no rows after the header")
    numbers = np.array([values for _, values in rows])
    return WrenchRecording(
        source=str(path),
        line=tuple(line for line, _ in rows),
        time_s=numbers[:, 0],
        position_m=numbers[:, 1:4],
        R_base_sensor=np.array([R_from_quaternion(q) for q in numbers[:, 4:8]]),
        force_N=numbers[:, 8:11],
        torque_Nm=numbers[:, 11:14],
    )


def bounded_lines(path: Path, file: TextIO) -> Iterator[str]:
    """Yield the lines of a text file. Raise DataError for one that fills the memory."""
    number = 0
    while line := file.readline(LONGEST_TEXT_LINE + 1):
        number += 1
        if len(line) > LONGEST_TEXT_LINE:
            raise DataError(
                f"{path}, line {number}: longer than {LONGEST_TEXT_LINE} characters: not a table "
                "of numbers, or its line ends are missing"
            )
        yield line


def _rows(path: Path, file: Iterator[str]) -> Iterator[tuple[int, list[float]]]:
    """Yield line number and the 14 numbers of each row."""
    reader = csv.reader(file, strict=True)
    try:
        header = next(reader, None)
        if header is None:
            raise DataError(f"{path}, line 1: the file is empty; {HEADER_RULE}")
        header = [name.strip() for name in header]
        places = _places(path, header)
        for cells in reader:
            if not cells or (len(cells) == 1 and not cells[0].strip()):
                continue  # a blank line, mostly the last
            location = f"{path}, line {reader.line_num}"
            if len(cells) != len(header):
                raise DataError(f"{location}{_ragged(header, cells)}")
            values = [_number(location, name, cells[place]) for name, place in places.items()]
            try:
                values[4:8] = checked_unit(tuple(values[4:8]))
            except DataError as error:
                raise DataError(f"{location}, columns qx to qw: {error}") from None
            yield reader.line_num, values
    except csv.Error as error:
        raise DataError(f"{path}, line {reader.line_num}: is not CSV text: {error}") from error


def _places(path: Path, header: list[str]) -> dict[str, int]:
    for name in COLUMNS:
        if name not in header:
            raise DataError(f"{path}, line 1: column {name} is missing; {HEADER_RULE}")
        if header.count(name) > 1:
            raise DataError(f"{path}, line 1: column {name} occurs {header.count(name)} times")
    return {name: header.index(name) for name in COLUMNS}


def _ragged(header: list[str], cells: list[str]) -> str:
    count, columns = len(cells), len(header)
    if count < columns:
        return f", column {header[count]}: no value; the row has {count} of {columns} values"
    return f", column {columns + 1}: the row has {count} values, the header only {columns} columns"


def _number(location: str, column: str, text: str) -> float:
    try:
        number = float(text.replace("_", "?"))  # Python would read 1_000 as a number
    except ValueError:
        problem = f"{text!r} is not a number" if text.strip() else "no value"
        raise DataError(f"{location}, column {column}: {problem}") from None
    if not math.isfinite(number):
        raise DataError(f"{location}, column {column}: {text.strip()} is not a finite number")
    return number
