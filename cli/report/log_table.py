"""Force logs as tables: a CSV file of any robot, read by column, with errors that name the cell.

The delimiter is that of the header: `;`, tab, `,` or spaces. With `;` or tab a comma in a number is
its decimal point. Lines that begin with `#` are comments.
"""

import csv
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np

from common.motion.frames import Array
from forcemesh.errors import DataError
from identification.recording import bounded_lines

TEXT_SUFFIXES = (".csv", ".tsv", ".txt", ".dat", ".log")
DELIMITERS = (";", "\t", ",", " ")
MISSING = frozenset(("", "nan", "na", "n/a", "null", "none", "-"))
COMMENT = "#"
KINDS = (  # how files of other kinds begin, and the remedy
    (b"PK\x03\x04", "is a spreadsheet or a zip file; save it as CSV"),
    (b"SQLite format 3", "is a ROS 2 bag in SQLite; convert it with `ros2 bag convert` to MCAP"),
    (
        b"#ROSBAG V2",
        "is a ROS 1 bag; convert it with `rosbags-convert`, or export its topic as CSV",
    ),
    (b"PAR1", "is a Parquet file; save it as CSV"),
    (b"\x89HDF", "is an HDF5 file; save it as CSV"),
    (b"\x1f\x8b", "is compressed; unpack it"),
)
MOST_NUMBER = 1e30  # beyond any force, torque and time: squares of such numbers are finite
LONGEST_START_B = 4096


class LogTable(Protocol):
    """Rows of a log with named columns."""

    path: Path
    names: tuple[str, ...]
    row_word: str  # name of a row in an error: line, message
    time_names: tuple[str, ...]  # columns that are certainly times [s], the best first
    notes: list[str]  # on the reading, for the user

    def rows(self, chosen: Sequence[str]) -> Iterator[tuple[int, list[object]]]:
        """Yield number and cells of each row, the cells in the order of `chosen`."""
        ...


class CsvTable:
    """A text file with one header line. Raises DataError if it has none."""

    row_word = "line"
    time_names: tuple[str, ...] = ()

    def __init__(self, path: Path) -> None:
        """Read the header."""
        self.path = path
        self.notes: list[str] = []
        refuse_other_kinds(path)
        number, line = next(self._lines(), (0, ""))
        if not number:
            raise DataError(f"{path}: the file is empty: the first line must name the columns")
        self._header_line = number
        self._delimiter = max(DELIMITERS[:3], key=line.count)
        if not line.count(self._delimiter):
            self._delimiter = " "
        self.names = tuple(cell.strip() for cell in self._cells(line))
        if all(_is_number(name) for name in self.names):
            raise DataError(
                f"{path}: line {number} has only numbers: a header line must name the columns"
            )

    def rows(self, chosen: Sequence[str]) -> Iterator[tuple[int, list[object]]]:
        """Yield line number and cells of each row."""
        places = [self.names.index(name) for name in chosen]
        for number, line in self._lines():
            if number <= self._header_line:
                continue
            cells = self._cells(line)
            if len(cells) < len(self.names):
                raise DataError(
                    f"{self.path}: line {number} has {len(cells)} values, the header has "
                    f"{len(self.names)} columns; a last line that is cut off must be removed"
                )
            yield number, [self._with_point(cells[place]) for place in places]

    def _with_point(self, cell: str) -> str:
        return cell.replace(",", ".") if self._delimiter in ";\t" else cell

    def _cells(self, line: str) -> list[str]:
        if self._delimiter == " ":
            return line.split()
        return next(csv.reader([line], delimiter=self._delimiter))

    def _lines(self) -> Iterator[tuple[int, str]]:
        """Yield number and text of each line with content that is not a comment."""
        try:
            with self.path.open(encoding="utf-8-sig") as stream:
                for number, line in enumerate(bounded_lines(self.path, stream), 1):
                    if (text := line.strip("\r\n")).strip() and not text.startswith(COMMENT):
                        yield number, text
        except UnicodeDecodeError:
            raise DataError(f"{self.path}: is not text in UTF-8; save it as CSV in UTF-8") from None


def refuse_other_kinds(path: Path) -> None:
    """Raise DataError for a file that cannot be read, or is of a known other kind."""
    try:
        with path.open("rb") as stream:
            start = stream.read(LONGEST_START_B)
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}") from None
    for magic, text in KINDS:
        if start.startswith(magic):
            raise DataError(f"{path}: {text}")
    if b"\0" in start:
        raise DataError(f"{path}: is not a text file; save it as CSV in UTF-8")


def read_numbers(table: LogTable, chosen: Sequence[str]) -> dict[str, Array]:
    """Return the chosen columns, shape (N,) each; a missing value is NaN.

    Raises:
        DataError: A column is missing or occurs twice, or a cell holds text.
    """
    for name in chosen:
        if table.names.count(name) != 1:
            what = "occurs twice" if name in table.names else "is missing"
            raise DataError(f"{table.path}: column {name!r} {what}; {columns_text(table)}")
    found: list[list[float]] = []
    for number, cells in table.rows(chosen):
        try:
            found.append([number_in(cell) for cell in cells])
        except ValueError:
            name, cell = next(
                (name, cell)
                for name, cell in zip(chosen, cells, strict=True)
                if not _is_number(cell)
            )
            raise DataError(
                f"{table.path}: {table.row_word} {number}, column {name!r}: {cell!r} is not a "
                "number within ±1e30; a missing value is an empty cell or nan"
            ) from None
    values = np.array(found, dtype=float).reshape(len(found), len(chosen))
    return {name: values[:, place].copy() for place, name in enumerate(chosen)}


def columns_text(table: LogTable) -> str:
    """Return the list of the columns for an error."""
    return f"the columns are: {', '.join(table.names)}"


def number_in(cell: object) -> float:
    """Return the number in a cell, NaN for a missing one. Raises ValueError for anything else."""
    if cell is None or (isinstance(cell, str) and cell.strip().lower() in MISSING):
        return math.nan
    is_scalar = isinstance(cell, str | int | float) and not isinstance(cell, bool)
    value = float(str(cell)) if is_scalar else math.inf
    if abs(value) > MOST_NUMBER:
        raise ValueError(cell)
    return value


def _is_number(cell: object) -> bool:
    try:
        number_in(cell)
    except ValueError:
        return False
    return True
