"""Reader of recordings: accepted files, and errors that name file, line and column."""

import re

import numpy as np
import pytest

from common.motion.frames import R_from_quaternion
from forcemesh.errors import DataError
from identification.recording import COLUMNS, read_recording

HEADER = ",".join(COLUMNS)
ROW = "0,0.1,0.2,0.3,0,0,0.6,0.8,1,2,3,0.1,0.2,0.3"


def written(tmp_path, *lines, name="poses.csv"):
    """Write lines to a file and return its path."""
    path = tmp_path / name
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def cells(**changes):
    """Return ROW with some cells changed, by column."""
    values = dict(zip(COLUMNS, ROW.split(","), strict=True))
    return ",".join({**values, **changes}.values())


def test_every_number_of_a_valid_file_is_read(tmp_path):
    """Pose, wrench, time and line of every row are those of the file."""
    recording = read_recording(written(tmp_path, HEADER, ROW, cells(t="10", fx="-1.5")))
    assert recording.line == (2, 3)
    assert recording.time_s.tolist() == [0.0, 10.0]
    assert recording.position_m[0].tolist() == [0.1, 0.2, 0.3]
    assert recording.force_N.tolist() == [[1.0, 2.0, 3.0], [-1.5, 2.0, 3.0]]
    assert recording.torque_Nm[0].tolist() == [0.1, 0.2, 0.3]
    np.testing.assert_allclose(
        recording.R_base_sensor[0], R_from_quaternion((0.0, 0.0, 0.6, 0.8)), atol=1e-15
    )


def test_columns_may_have_any_order_and_unknown_ones_are_ignored(tmp_path):
    """Columns are found by name; unknown ones, a byte order mark and blank lines are ignored."""
    names, values = [*reversed(COLUMNS), "note"], [*reversed(ROW.split(",")), "tool down"]
    path = written(tmp_path, "\ufeff" + ", ".join(names), ",".join(values), "")
    assert read_recording(path).force_N.tolist() == [[1.0, 2.0, 3.0]]


def test_a_wrench_in_base_axes_is_rotated_into_sensor_axes_with_the_same_reference_point(tmp_path):
    """v_sensor = R_base_sensor^T v_base for force and torque alike; lengths stay."""
    recording = read_recording(written(tmp_path, HEADER, ROW))
    kept, turned = recording.samples("sensor"), recording.samples("base")
    R = recording.R_base_sensor[0]
    np.testing.assert_allclose(R @ turned.force_N[0], kept.force_N[0], atol=1e-12)
    np.testing.assert_allclose(R @ turned.torque_Nm[0], kept.torque_Nm[0], atol=1e-12)


def test_a_rounded_quaternion_is_normalised(tmp_path):
    """Four digits are enough to give an orthonormal matrix."""
    R = read_recording(written(tmp_path, HEADER, cells(qz="0.6005", qw="0.8"))).R_base_sensor[0]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)


def test_a_folder_or_a_missing_file_is_refused(tmp_path):
    """The error of a folder or a missing file differs from that of bad content."""
    with pytest.raises(DataError, match="cannot be read: Is a directory"):
        read_recording(tmp_path)
    with pytest.raises(DataError, match=r"none\.csv: cannot be read: No such file"):
        read_recording(tmp_path / "none.csv")


@pytest.mark.parametrize(
    ("lines", "problem"),
    [
        ([HEADER.replace("qx,", ""), ROW], "line 1: column qx is missing"),
        ([HEADER + ",fx", ROW + ",1"], "line 1: column fx occurs 2 times"),
        ([HEADER], "line 2: no rows"),
        ([HEADER, ROW, ROW.rsplit(",", 2)[0]], "line 3, column ty: no value; the row has 12 of 14"),
        ([HEADER, ROW, ROW + ",7"], "line 3, column 15: the row has 15 values, the header only 14"),
        ([HEADER, ROW, '"' + ROW], "line 3: is not CSV text"),
    ],
)
def test_a_wrong_table_is_refused_with_its_line(tmp_path, lines, problem):
    """A missing or double column, no rows, a ragged row, an open quote."""
    with pytest.raises(DataError, match=re.escape(f"poses.csv, {problem}")):
        read_recording(written(tmp_path, *lines))


@pytest.mark.parametrize("column", COLUMNS)
def test_every_column_is_needed_and_must_be_finite(tmp_path, column):
    """Each of the fourteen."""
    others = [name for name in COLUMNS if name != column]
    with pytest.raises(DataError, match=f"line 1: column {column} is missing"):
        read_recording(written(tmp_path, ",".join(others), ROW))
    path = written(tmp_path, HEADER, ROW, cells(**{column: "nan"}))
    with pytest.raises(DataError, match=f"line 3, column {column}: nan is not a finite number"):
        read_recording(path)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("abc", "'abc' is not a number"),
        ("1_0", "'1_0' is not a number"),
        ("-inf", "-inf is not a finite number"),
        ("1e999", "1e999 is not a finite number"),
        ("", "no value"),
    ],
)
def test_a_cell_that_is_no_finite_number_is_named(tmp_path, text, problem):
    """Text, infinity, overflow and emptiness."""
    path = written(tmp_path, HEADER, cells(fz=text))
    with pytest.raises(DataError, match=f"poses.csv, line 2, column fz: {problem}"):
        read_recording(path)


@pytest.mark.parametrize("scale", [0.998, 1.002])
def test_a_quaternion_that_is_not_of_unit_length_is_refused(tmp_path, scale):
    """The length must be 1 within a thousandth."""
    row = cells(qz=str(0.6 * scale), qw=str(0.8 * scale))
    with pytest.raises(DataError, match=r"poses\.csv, line 2, columns qx to qw: .*length"):
        read_recording(written(tmp_path, HEADER, row))


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"", f", line 1: the file is empty; .*{HEADER}"),
        (HEADER.encode("utf-16"), ": is not UTF-8 text"),
        (b"t,x\xe9", ": is not UTF-8 text"),
    ],
)
def test_bytes_that_are_no_text_are_refused(tmp_path, content, problem):
    """The error of an empty file gives the header that it lacks."""
    path = tmp_path / "poses.csv"
    path.write_bytes(content)
    with pytest.raises(DataError, match="poses.csv" + problem):
        read_recording(path)
