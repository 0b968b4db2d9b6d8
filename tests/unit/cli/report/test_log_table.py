"""CSV files of any robot: delimiters, headers, missing values, and errors that name the cell."""

import math
from pathlib import Path

import pytest

from cli.report.log_table import KINDS, MISSING, CsvTable, number_in, read_numbers
from forcemesh.errors import DataError


def table(tmp_path: Path, text: str) -> CsvTable:
    """Return a table of a text."""
    path = tmp_path / "log.csv"
    path.write_text(text, encoding="utf-8")
    return CsvTable(path)


@pytest.mark.parametrize(
    "text",
    [
        "t,fz\n0,1.5\n0.5,2\n",
        "t;fz\n0;1,5\n0,5;2\n",
        "t\tfz\r\n0\t1,5\r\n0.5\t2\r\n",
        "t  fz\n0  1.5\n 0.5 2\n",
        "\ufeff# a comment\n\nt , fz\n0, 1.5\n# another\n0.5, 2,\n",
        '"t","fz"\n"0","1.5"\n"0.5","2"\n',
    ],
)
def test_every_usual_form_of_a_csv_file_is_read(tmp_path: Path, text: str) -> None:
    """Comma, semicolon with decimal commas, tab, spaces, byte order mark, comments, quotes."""
    found = read_numbers(table(tmp_path, text), ("fz", "t"))
    assert found["t"].tolist() == [0.0, 0.5]
    assert found["fz"].tolist() == [1.5, 2.0]


@pytest.mark.parametrize("cell", [*sorted(MISSING), " NaN ", None])
def test_a_missing_value_is_nan_and_never_zero(cell: object) -> None:
    """An empty cell, a dash, and the usual words."""
    assert math.isnan(number_in(cell))


@pytest.mark.parametrize(
    "cell", ["inf", "-Infinity", "1e999", 1.1e30, "x", "1.5 N", True, [1.0], {}]
)
def test_anything_else_is_no_number(cell: object) -> None:
    """Also an infinite or a huge number, which no sensor reports."""
    with pytest.raises(ValueError):  # noqa: PT011 - its text is not used
        number_in(cell)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "the file is empty: the first line must name the columns"),
        ("0,1\n1,2\n", "line 1 has only numbers: a header line must name the columns"),
        ("t,fz\n0,1\n1\n", "line 3 has 1 values, the header has 2 columns"),
        ("t,fz\n0,1\n# c\n1,high\n", "log.csv: line 4, column 'fz': 'high' is not a number within"),
        ("t,fx\n0,1\n", "column 'fz' is missing; the columns are: t, fx"),
        ("t,fz,fz\n0,1,2\n", "column 'fz' occurs twice; the columns are: t, fz, fz"),
    ],
)
def test_a_file_without_header_or_with_a_short_line_is_refused(
    tmp_path: Path, text: str, sentence: str
) -> None:
    """The message names the line."""
    with pytest.raises(DataError, match=sentence):
        read_numbers(table(tmp_path, text), ("t", "fz"))


@pytest.mark.parametrize(
    ("data", "sentence"),
    [(magic, text) for magic, text in KINDS]
    + [(b"t,fz\n\0\0", "is not a text file"), (b"t,f\xe4z\n", "is not text in UTF-8")],
)
def test_a_file_of_another_kind_is_refused_with_the_remedy(
    tmp_path: Path, data: bytes, sentence: str
) -> None:
    """By its first bytes, whatever its name."""
    path = tmp_path / "log.csv"
    path.write_bytes(data)
    with pytest.raises(DataError, match=r"log\.csv: ") as raised:
        CsvTable(path)
    assert sentence in str(raised.value)
