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


@pytest.mark.parametrize("column", COLUMNS)
def test_a_missing_column_is_named(tmp_path, column):
    """Each of the fourteen columns must be there."""
    header = HEADER.replace(column + ",", "", 1) if column != "tz" else HEADER[:-3]
    with pytest.raises(DataError, match=rf"poses\.csv, line 1: column {column} is missing"):
        read_recording(written(tmp_path, header, ROW))


def test_a_duplicate_column_is_named(tmp_path):
    """Two columns of one name are ambiguous."""
    with pytest.raises(DataError, match=r"poses\.csv, line 1: column fx occurs 2 times"):
        read_recording(written(tmp_path, HEADER + ",fx", ROW + ",1"))


@pytest.mark.parametrize("column", COLUMNS)
@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("abc", "'abc' is not a number"),
        ("1_0", "'1_0' is not a number"),
        ("nan", "nan is not a finite number"),
        ("-inf", "-inf is not a finite number"),
        ("1e999", "1e999 is not a finite number"),
        ("", "no value"),
    ],
)
def test_a_cell_that_is_no_finite_number_is_named(tmp_path, column, text, problem):
    """Text, NaN, infinity, overflow and emptiness are refused in every column."""
    path = written(tmp_path, HEADER, ROW, cells(**{column: text}))
    with pytest.raises(
        DataError, match=re.escape(f"poses.csv, line 3, column {column}: {problem}")
    ):
        read_recording(path)


@pytest.mark.parametrize(
    ("row", "problem"),
    [
        (ROW.rsplit(",", 2)[0], ", column ty: no value; the row has 12 of 14 values"),
        (ROW + ",7", ", column 15: the row has 15 values, the header only 14 columns"),
    ],
)
def test_a_ragged_row_is_named(tmp_path, row, problem):
    """A row is as long as the header."""
    with pytest.raises(DataError, match=re.escape("poses.csv, line 3" + problem)):
        read_recording(written(tmp_path, HEADER, ROW, row))


@pytest.mark.parametrize("scale", [0.0, 0.998, 1.002, 2.0])
def test_a_quaternion_that_is_not_of_unit_length_is_refused(tmp_path, scale):
    """The length must be 1 within a thousandth."""
    row = cells(qz=str(0.6 * scale), qw=str(0.8 * scale))
    with pytest.raises(DataError, match=r"poses\.csv, line 3, columns qx to qw: .*length"):
        read_recording(written(tmp_path, HEADER, ROW, row))


def test_a_rounded_quaternion_is_normalised(tmp_path):
    """Four digits are enough to give an orthonormal matrix."""
    R = read_recording(written(tmp_path, HEADER, cells(qz="0.6005", qw="0.8"))).R_base_sensor[0]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)


def test_a_file_without_rows_is_refused(tmp_path):
    """A header without rows is not a recording."""
    with pytest.raises(DataError, match=r"poses\.csv, line 2: no rows"):
        read_recording(written(tmp_path, HEADER))


def test_an_empty_file_is_refused(tmp_path):
    """The error gives the header that an empty file lacks."""
    path = tmp_path / "poses.csv"
    path.write_bytes(b"")
    with pytest.raises(DataError, match=rf"poses\.csv, line 1: the file is empty; .*{HEADER}"):
        read_recording(path)


def test_a_folder_or_a_missing_file_is_refused(tmp_path):
    """The error of a folder or a missing file differs from that of bad content."""
    with pytest.raises(DataError, match="cannot be read: Is a directory"):
        read_recording(tmp_path)
    with pytest.raises(DataError, match=r"none\.csv: cannot be read: No such file"):
        read_recording(tmp_path / "none.csv")


@pytest.mark.parametrize("content", [HEADER.encode("utf-16"), b"\xff\xfe\x00", b"t,x\xe9"])
def test_a_file_in_another_encoding_is_refused(tmp_path, content):
    """Bytes that are not UTF-8 are refused."""
    path = tmp_path / "poses.csv"
    path.write_bytes(content)
    with pytest.raises(DataError, match=r"poses\.csv: is not UTF-8 text"):
        read_recording(path)


def test_text_that_is_not_csv_is_refused_with_its_line(tmp_path):
    """The error of an unclosed quote names the line where reading stopped."""
    with pytest.raises(DataError, match=r"poses\.csv, line 3: is not CSV text"):
        read_recording(written(tmp_path, HEADER, ROW, '"' + ROW))
