"""Choice of the columns: named, found by name, or refused, and the log in SI units from time 0."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cli.report.log_columns import ColumnChoice, ForceLog, band_of, read_force_log
from cli.report.log_table import CsvTable
from forcemesh.errors import DataError
from tests.fakes.force_logs import (
    first_order,
    setpoint_at,
    times,
    write_csv,
)
from tuning.force_log import Signal

COUNT = 100
TIME = [0.01 * number for number in range(COUNT)]
RISING = [float(number) for number in range(COUNT)]
FLAT = [0.5] * COUNT
ROS_FORCES = " ".join(f"/ft/{kind}.{axis}" for kind in ("force", "torque") for axis in "xyz")
UR_FORCES = " ".join(f"actual_TCP_force_{number}" for number in range(6))
Columns = dict[str, Iterable[object]]


def read(tmp_path: Path, columns: Columns, choice: ColumnChoice | None = None) -> ForceLog:
    """Return the log in the chosen columns of a CSV file."""
    table = CsvTable(write_csv(tmp_path / "log.csv", columns))
    return read_force_log(table, choice or ColumnChoice())


def named(log: ForceLog) -> list[str]:
    """Return the names of the columns."""
    return [column.name for column in log.columns]


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
    columns: dict[str, Iterable[object]] = {"stamp_ns": FLAT, time: TIME, "note": ["a"] * COUNT}
    log = read(tmp_path, columns | dict.fromkeys(six, FLAT))
    assert named(log) == six
    assert [column.unit for column in log.columns] == ["N"] * 3 + ["N m"] * 3
    assert log.notes[0] == f"time is column '{time}', by its name"
    forces, torques = ", ".join(six[:3]), ", ".join(six[3:])
    assert log.notes[1] == f"force is {forces}, torque {torques}, by their names"


GOOD: Columns = {"t": TIME, "fz": FLAT}


@pytest.mark.parametrize(
    ("columns", "choice", "sentence"),
    [
        ({"a": TIME, "fz": FLAT}, {}, "no column is certainly the time: name it with --time; the"),
        ({"t": TIME, "time": TIME, "fz": FLAT}, {}, "t and time may be time: name it with --time"),
        ({"t": TIME, "a": FLAT}, {}, "no column is certainly a force: name them with --force; the"),
        (GOOD, {"force": ("fx",)}, "column 'fx' is missing; the columns are: t,"),
        (GOOD, {"setpoint": "nan"}, "--setpoint nan: must be a number within"),
        (GOOD, {"axis": "fzz"}, "--axis 'fzz' is no force or torque of the log: did"),
        ({"t": TIME[:19], "fz": FLAT[:19]}, {}, "19 samples; at least 20 are needed for a report"),
        (GOOD | {"t": [*TIME[:50], "", *TIME[51:]]}, {}, "line 52, column 't': the time is mi"),
        (GOOD | {"t": [*TIME[:50], 0.1, *TIME[51:]]}, {}, "line 52, column 't': time decreases"),
        (GOOD | {"t": [3.0] * COUNT}, {}, "column 't' is constant and no time"),
        (GOOD | {"fz": ["nan"] * 90 + FLAT[90:]}, {}, "column 'fz' has 10 values; at least 20"),
        (GOOD | {"sp": [""] * COUNT}, {}, "column 'sp', the set point, has no valu"),
    ],
)
def test_every_mistake_is_one_message(
    tmp_path: Path, columns: Columns, choice: dict[str, Any], sentence: str
) -> None:
    """It names the file or the option, the place, and the remedy."""
    with pytest.raises(DataError) as raised:
        read(tmp_path, columns, ColumnChoice(**choice))
    assert sentence in str(raised.value)
    assert "\n" not in str(raised.value)


def test_an_ambiguous_torque_is_left_out(tmp_path: Path) -> None:
    """A force alone can be judged."""
    columns = {"t": TIME, "fz": RISING, "tz": FLAT, "mz": FLAT}
    assert named(read(tmp_path, columns)) == ["fz"]
    log = read(tmp_path, columns, ColumnChoice(torque=("mz",), units="Nmm"))
    assert named(log) == ["mz"]
    assert log.judged.signal.value[0] == pytest.approx(5e-4)


def test_missing_values_are_gaps_of_their_column_alone(tmp_path: Path) -> None:
    """They are counted, and never zero."""
    log = read(tmp_path, {"t": TIME, "fx": FLAT, "fz": [*RISING[:50], "", "nan", *RISING[52:]]})
    fx, fz = log.columns
    assert (fx.missing, fz.missing) == (0, 2)
    assert len(fz.signal.value) == COUNT - 2
    assert np.all(fz.signal.value[1:] > 0.0)
    assert np.max(np.diff(fz.signal.time_s)) == pytest.approx(0.03)


def test_the_axis_that_changes_most_is_judged_with_the_sign_of_the_set_point(
    tmp_path: Path,
) -> None:
    """Both choices are noted; a named axis keeps its sign."""
    force, aimed = -10.0 * first_order(times(), 0.05), setpoint_at(times(), 10.0)
    columns = {"t": times(), "fx": 0.01 * force, "fz": force, "force_setpoint": aimed}
    log = read(tmp_path, columns)
    assert log.judged.name == "-fz"
    assert log.judged.signal.value[-1] == pytest.approx(10.0)
    assert "the set point is column 'force_setpoint', by its name" in log.notes
    assert "fz is judged, because it changes most; --axis names another" in log.notes
    assert "fz is judged with the opposite sign, which its set point has" in log.notes
    assert read(tmp_path, columns, ColumnChoice(axis="fz")).judged.name == "fz"
    assert read(tmp_path, columns, ColumnChoice(axis="-fx")).judged.name == "-fx"
    assert read(tmp_path, columns, ColumnChoice(setpoint="10")).judged.name == "-fz"
    assert read(tmp_path, columns, ColumnChoice(setpoint="-10")).judged.name == "fz"


def test_a_set_point_holds_until_the_next_one(tmp_path: Path) -> None:
    """A log may store it when it changes only; before the first one there is none."""
    aimed = ["", "", 5.0, *[""] * 47, 8.0, *[""] * 49]
    log = read(
        tmp_path, {"t": TIME, "fz": RISING, "set point [kN]": aimed}, ColumnChoice(units="kN")
    )
    assert isinstance(log.setpoint, Signal)
    assert log.setpoint.time_s[0] == pytest.approx(0.02)
    assert log.setpoint.value[47:49].tolist() == [5000.0, 8000.0]
    assert len(log.setpoint.value) == COUNT - 2


def test_times_begin_at_zero_and_an_improbable_unit_is_noted(tmp_path: Path) -> None:
    """Milliseconds that are taken for seconds give samples that are seconds apart."""
    columns = {"t": [1.7e12 + 4.0 * number for number in range(COUNT)], "fz": RISING}
    log = read(tmp_path, columns)
    assert "the samples are 4 s apart: is the unit of time right?" in log.notes
    right = read(tmp_path, columns, ColumnChoice(units="ms"))
    assert right.judged.signal.time_s[[0, -1]] == pytest.approx([0.0, 0.396])
    assert not any("unit of time" in note for note in right.notes)


def test_a_band_is_a_share_or_a_force(tmp_path: Path) -> None:
    """Without a unit it has that of the log; anything else is refused with the form."""
    log = read(tmp_path, {"t": TIME, "fz": RISING}, ColumnChoice(units="kN"))
    found = {text: band_of(text, log) for text in ("5%", " 2.5 % ", "1N", "2")}
    assert [band.value for band in found.values()] == [5.0, 2.5, 1.0, 2000.0]
    assert [band.is_percent for band in found.values()] == [True, True, False, False]
    refused = r"--band .*(must be a positive number|is no unit of a for)"
    for text in ("", "x", "-5%", "0", "nan", "1e999", "5 5", "e%", "1Nm", "1lb"):
        with pytest.raises(DataError, match=refused):
            band_of(text, log)
