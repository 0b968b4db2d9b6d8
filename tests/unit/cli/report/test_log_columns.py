"""Force logs of any robot: forms of a CSV file, columns, units, and mistakes in one message."""

import math
from pathlib import Path
from typing import Any

import pytest

from cli.report.log_columns import ColumnChoice, ForceLog, band_of, read_force_log
from cli.report.log_table import KINDS, MISSING, CsvTable, number_in, read_numbers
from cli.report.log_units import DEFAULTS, UNITS, named_units, unit_in_name
from forcemesh.errors import DataError
from tests.fakes.force_logs import first_order, setpoint_at, times, write_csv

COUNT = 100
TIME = [0.01 * number for number in range(COUNT)]
RISING = [float(number) for number in range(COUNT)]
FLAT = [0.5] * COUNT
Columns = dict[str, Any]  # of any values
GOOD: Columns = {"t": TIME, "fz": FLAT}


def read(tmp_path: Path, columns: Columns, **choice: Any) -> ForceLog:
    """Return the log in the chosen columns of a CSV file."""
    path = write_csv(tmp_path / "log.csv", columns)
    return read_force_log(CsvTable(path), ColumnChoice(**choice))


# --- text -----------------------------------------------------------------------------------------


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
    path = tmp_path / "log.csv"
    path.write_text(text, encoding="utf-8")
    found = read_numbers(CsvTable(path), ("fz", "t"))
    assert (found["t"].tolist(), found["fz"].tolist()) == ([0.0, 0.5], [1.5, 2.0])


def test_a_missing_value_is_nan_and_anything_else_is_no_number() -> None:
    """Never zero; also an infinite or a huge number, which no sensor reports."""
    assert all(math.isnan(number_in(cell)) for cell in (*MISSING, " NaN ", None))
    for cell in ("inf", "1e999", 1.1e30, "x", "1.5 N", True, [1.0]):
        with pytest.raises(ValueError):  # noqa: PT011 - its text is not used
            number_in(cell)


@pytest.mark.parametrize(
    ("data", "sentence"),
    [
        *KINDS,
        (b"t,fz\n\0\0", "is not a text file"),
        (b"t,f\xe4z\n", "is not text in UTF-8"),
        (b"", "the file is empty: the first line must name the columns"),
        (b"0,1\n1,2\n", "line 1 has only numbers: a header line must name the columns"),
        (b"t,fz\n0,1\n1\n", "line 3 has 1 values, the header has 2 columns"),
        (b"t,fz\n0,1\n# c\n1,high\n", "line 4, column 'fz': 'high' is not a number within"),
        (b"t,fx\n0,1\n", "column 'fz' is missing; the columns are: t, fx"),
        (b"t,fz,fz\n0,1,2\n", "column 'fz' occurs twice; the columns are: t, fz, fz"),
    ],
)
def test_a_file_that_cannot_be_read_is_refused_with_its_line(
    tmp_path: Path, data: bytes, sentence: str
) -> None:
    """Another kind of file by its first bytes, with the remedy."""
    path = tmp_path / "log.csv"
    path.write_bytes(data)
    with pytest.raises(DataError, match=r"log\.csv: ") as raised:
        read_numbers(CsvTable(path), ("t", "fz"))
    assert sentence in str(raised.value)


# --- columns --------------------------------------------------------------------------------------

ROS_FORCES = " ".join(f"/ft/{kind}.{axis}" for kind in ("force", "torque") for axis in "xyz")
UR_FORCES = " ".join(f"actual_TCP_force_{number}" for number in range(6))


@pytest.mark.parametrize(
    "names",
    [
        "t fx fy fz tx ty tz",
        "Timestamp Force_X Force_Y Force_Z Torque_X Torque_Y Torque_Z",
        f"__time {ROS_FORCES}",
        f"timestamp {UR_FORCES}",
    ],
)
def test_the_usual_names_are_found_and_noted(tmp_path: Path, names: str) -> None:
    """Of forcemesh, ROS, PlotJuggler, Universal Robots and others."""
    time, *six = names.split()
    columns: Columns = {"stamp_ns": FLAT, time: TIME, "note": ["a"] * COUNT}
    log = read(tmp_path, columns | dict.fromkeys(six, FLAT))
    assert [column.name for column in log.columns] == six
    assert [column.unit for column in log.columns] == ["N"] * 3 + ["N m"] * 3
    assert log.notes[0] == f"time is column '{time}', by its name"


@pytest.mark.parametrize(
    ("columns", "choice", "sentence"),
    [
        ({"a": TIME, "fz": FLAT}, {}, "no column is certainly the time: name it with --time; the"),
        ({"t": TIME, "time": TIME, "fz": FLAT}, {}, "t and time may be time: name it with --time"),
        ({"t": TIME, "a": FLAT}, {}, "no column is certainly a force: name them with --force; the"),
        (GOOD, {"setpoint": "nan"}, "--setpoint nan: must be a number within"),
        (GOOD, {"axis": "fzz"}, "--axis 'fzz' is no force or torque of the log: did"),
        ({"t": TIME[:19], "fz": FLAT[:19]}, {}, "19 samples; at least 20 are needed for a report"),
        (GOOD | {"t": [*TIME[:50], "", *TIME[51:]]}, {}, "line 52, column 't': the time is mi"),
        (GOOD | {"t": [*TIME[:50], 0.1, *TIME[51:]]}, {}, "line 52, column 't': time decreases"),
        (GOOD | {"t": [3.0] * COUNT}, {}, "column 't' is constant and no time"),
        (GOOD | {"fz": ["nan"] * 90 + FLAT[90:]}, {}, "column 'fz' has 10 values; at least 20"),
        (GOOD | {"sp": [""] * COUNT}, {}, "column 'sp', the set point, has no valu"),
        (GOOD, {"units": "s,ms"}, "--units: s and ms are both units of time"),
        (GOOD, {"units": "newton"}, "unknown unit 'newton': choose from N, mN, kN"),
        (
            {"t": TIME, "fx [kN]": FLAT, "fy [N]": FLAT},
            {},
            "columns of force have the units N and kN: name one in",
        ),
    ],
)
def test_every_mistake_is_one_message(
    tmp_path: Path, columns: Columns, choice: dict[str, Any], sentence: str
) -> None:
    """It names the file or the option, the place, and the remedy."""
    with pytest.raises(DataError) as raised:
        read(tmp_path, columns, **choice)
    assert sentence in str(raised.value)
    assert "\n" not in str(raised.value)


def test_the_axis_that_changes_most_is_judged_with_the_sign_of_the_set_point(
    tmp_path: Path,
) -> None:
    """Both choices are noted; a named axis keeps its sign."""
    force, aimed = -10.0 * first_order(times(), 0.05), setpoint_at(times(), 10.0)
    columns = {"t": times(), "fx": 0.01 * force, "fz": force, "force_setpoint": aimed}
    log = read(tmp_path, columns)
    assert (log.judged.name, log.judged.signal.value[-1]) == ("-fz", pytest.approx(10.0))
    assert "the set point is column 'force_setpoint', by its name" in log.notes
    assert "fz is judged, because it changes most; --axis names another" in log.notes
    assert "fz is judged with the opposite sign, which its set point has" in log.notes
    for choice, name in (
        ({"axis": "fz"}, "fz"),
        ({"axis": "-fx"}, "-fx"),
        ({"setpoint": "10"}, "-fz"),
        ({"setpoint": "-10"}, "fz"),
    ):
        assert read(tmp_path, columns, **choice).judged.name == name


# --- units ----------------------------------------------------------------------------------------


def test_units_are_those_that_are_named_of_the_columns_or_the_defaults(tmp_path: Path) -> None:
    """In any spelling; factors of NIST SP 811, appendix B.8. An improbable one is noted."""
    for symbol, factor in (("lbf", 4.44822), ("lbf-in", 0.112985), ("Nmm", 0.001), ("us", 1e-6)):
        assert UNITS[symbol].factor == pytest.approx(factor, rel=1e-5)
    assert {unit.symbol for unit in named_units("µs, N·m ,kN").values()} == {"us", "Nm", "kN"}
    assert all(named_units(symbol) == {unit.quantity: unit} for symbol, unit in UNITS.items())
    for name, quantity, symbol in (("Fz [N]", "force", "N"), ("time_ms", "time", "ms")):
        assert unit_in_name(name, quantity) == UNITS[symbol]
    assert unit_in_name("force_N.x", "force") == UNITS["N"]
    assert unit_in_name("t_s", "force") is None
    assert DEFAULTS["force"].symbol == "N"
    columns: Columns = {"t": [4.0 * number for number in range(COUNT)], "fz [kN]": RISING}
    log = read(tmp_path, columns)
    assert log.judged.signal.value[1] == 1000.0
    assert "the samples are 4 s apart: is the unit of time right?" in log.notes
    log = read(tmp_path, columns, units="ms,lbf")
    assert log.judged.signal.time_s[[0, -1]] == pytest.approx([0.0, 0.396])
    assert log.judged.signal.value[1] == pytest.approx(4.44822, rel=1e-5)


def test_a_band_is_a_share_or_a_force(tmp_path: Path) -> None:
    """Without a unit it has that of the log; anything else is refused with the form."""
    log = read(tmp_path, {"t": TIME, "fz": RISING}, units="kN")
    bands = [band_of(text, log) for text in ("5%", " 2.5 % ", "1N", "2")]
    assert [band.value for band in bands] == [5.0, 2.5, 1.0, 2000.0]
    assert [band.is_percent for band in bands] == [True, True, False, False]
    for text in ("", "x", "-5%", "0", "nan", "1e999", "1Nm", "1lb"):
        with pytest.raises(DataError, match=r"--band .*(must be a positive number|is no unit of)"):
            band_of(text, log)
