"""Reader of recordings: accepted files, and errors that name file, line and column."""

import re

import numpy as np
import pytest

from common.motion.frames import R_from_quaternion
from forcemesh.errors import DataError
from identification.recording import COLUMNS, read_recording

HEADER = ",".join(COLUMNS)
ROW = "0,0.1,0.2,0.3,0,0,0.6,0.8,1,2,3,0.1,0.2,0.3"


def written(tmp_path, *lines):
    """Write lines to a file and return its path."""
    path = tmp_path / "poses.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def cells(**changes):
    """Return ROW with some cells changed, by column."""
    values = dict(zip(COLUMNS, ROW.split(","), strict=True))
    return ",".join({**values, **changes}.values())


def test_every_number_of_a_valid_file_is_read(tmp_path) -> None:
    """Pose, wrench, time and line of every row; a rounded quaternion is normalised."""
    recording = read_recording(written(tmp_path, HEADER, ROW, cells(t="10", fx="-1.5", qz=".6005")))
    assert recording.line == (2, 3)
    assert recording.time_s.tolist() == [0.0, 10.0]
    assert recording.position_m[0].tolist() == [0.1, 0.2, 0.3]
    assert recording.force_N.tolist() == [[1.0, 2.0, 3.0], [-1.5, 2.0, 3.0]]
    assert recording.torque_Nm[0].tolist() == [0.1, 0.2, 0.3]
    R = recording.R_base_sensor
    np.testing.assert_allclose(R[0], R_from_quaternion((0.0, 0.0, 0.6, 0.8)), atol=1e-15)
    np.testing.assert_allclose(R[1] @ R[1].T, np.eye(3), atol=1e-14)


def test_columns_may_have_any_order_and_unknown_ones_are_ignored(tmp_path) -> None:
    """Columns are found by name; unknown ones, a byte order mark and blank lines are ignored."""
    names, values = [*reversed(COLUMNS), "note"], [*reversed(ROW.split(",")), "tool down"]
    path = written(tmp_path, "\ufeff" + ", ".join(names), ",".join(values), "")
    assert read_recording(path).force_N.tolist() == [[1.0, 2.0, 3.0]]


LONG, SHORT = (cells(qz=str(0.6 * scale), qw=str(0.8 * scale)) for scale in (1.002, 0.998))


@pytest.mark.parametrize(
    ("lines", "problem"),
    [
        ([HEADER.replace("qx,", ""), ROW], "line 1: column qx is missing"),
        ([HEADER + ",fx", ROW + ",1"], "line 1: column fx occurs 2 times"),
        ([HEADER], "line 2: no rows"),
        ([HEADER, ROW, ROW.rsplit(",", 2)[0]], "line 3, column ty: no value; the row has 12 of 14"),
        ([HEADER, ROW, ROW + ",7"], "line 3, column 15: the row has 15 values, the header only 14"),
        ([HEADER, ROW, '"' + ROW], "line 3: is not CSV text"),
        ([HEADER, cells(fz="abc")], "line 2, column fz: 'abc' is not a number"),
        ([HEADER, cells(fz="1_0")], "line 2, column fz: '1_0' is not a number"),
        ([HEADER, cells(fz="1e999")], "line 2, column fz: 1e999 is not a finite number"),
        ([HEADER, cells(fz="")], "line 2, column fz: no value"),
        ([HEADER, LONG], "line 2, columns qx to qw: "),
        ([HEADER, SHORT], "line 2, columns qx to qw: "),
        *(
            ([HEADER, cells(**{name: "nan"})], f"line 2, column {name}: nan is not")
            for name in COLUMNS
        ),
    ],
)
def test_a_wrong_table_is_refused_with_its_line(tmp_path, lines, problem) -> None:
    """A missing or double column, a ragged row, an open quote, a cell that is no number."""
    with pytest.raises(DataError, match=re.escape(f"poses.csv, {problem}")):
        read_recording(written(tmp_path, *lines))


@pytest.mark.parametrize(
    ("content", "problem"),
    [(b"", f", line 1: the file is empty; .*{HEADER}"), (b"t,x\xe9", ": is not UTF-8 text")],
)
def test_bytes_that_are_no_text_are_refused(tmp_path, content, problem) -> None:
    """The error of an empty file gives the header that it lacks; a folder is no file."""
    path = tmp_path / "poses.csv"
    path.write_bytes(content)
    with pytest.raises(DataError, match="poses.csv" + problem):
        read_recording(path)
    with pytest.raises(DataError, match="cannot be read: Is a directory"):
        read_recording(tmp_path)
