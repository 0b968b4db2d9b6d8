"""Choice of the columns of a force log: as named by the user, else by names that leave no doubt.

Everything that was not named is a note of the log, so that the user can check it.
"""

import difflib
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cli.report.log_table import MOST_NUMBER, LogTable, columns_text, read_numbers
from cli.report.log_units import (
    DEFAULTS,
    FORCE,
    SI_NAMES,
    TIME,
    TORQUE,
    UNITS,
    LogUnit,
    named_units,
    unit_of_columns,
)
from common.motion.frames import Array
from forcemesh.errors import DataError
from tuning.force_log import LEAST_SAMPLES, Signal
from tuning.log_quality import Band, LogColumn

UNIT_WORDS = frozenset(("n", "nm", "s", "ms", "us", "ns"))  # of a name, beside its words
TIME_WORDS = (("t", "time", "timestamp", "seconds"), ("stamp",))  # the first that occurs
AXIS_NAMES = "xyz"
MOST_PERIOD_S = 0.5  # a longer median distance is probably a time in another unit
BAND = re.compile(r"([0-9.eE+-]+)\s*(%|[A-Za-z][\w·.-]*)?")


@dataclass(frozen=True, slots=True)
class ColumnChoice:
    """Names as on the command line; empty: to be found."""

    time: str = ""
    force: tuple[str, ...] = ()
    torque: tuple[str, ...] = ()
    setpoint: str = ""  # a column or a number
    axis: str = ""  # of the set point; a leading - reverses its sign
    units: str = ""


@dataclass(frozen=True, slots=True)
class ForceLog:
    """A log in SI units, from time 0."""

    columns: tuple[LogColumn, ...]
    judged: LogColumn
    setpoint: Signal | float | None
    quantity: str
    units: dict[str, LogUnit]
    notes: tuple[str, ...]


def read_force_log(table: LogTable, choice: ColumnChoice) -> ForceLog:
    """Return the log in the chosen columns of a table.

    Raises:
        DataError: A column is missing or not unambiguous, a number is none, time decreases, or
            there are fewer than LEAST_SAMPLES samples.
    """
    named = named_units(choice.units)
    choice, notes = _completed(table, choice)
    level, setpoint_name = _level_or_column(choice.setpoint)
    chosen = (choice.time, *choice.force, *choice.torque, *filter(None, (setpoint_name,)))
    values = read_numbers(table, tuple(dict.fromkeys(chosen)))
    units = {
        TIME: unit_of_columns([choice.time], TIME, named),
        FORCE: unit_of_columns(choice.force, FORCE, named),
        TORQUE: unit_of_columns(choice.torque, TORQUE, named),
    }
    notes += _unit_notes(units, named, choice)
    time_s = units[TIME].factor * _checked_times(table, choice.time, values[choice.time])
    if (distance_s := float(np.median(np.diff(time_s)))) > MOST_PERIOD_S:
        notes.append(f"the samples are {distance_s:.3g} s apart: is the unit of time right?")
    columns = tuple(
        _column(table, name, Signal(time_s, values[name]), units[quantity])
        for quantity, names in ((FORCE, choice.force), (TORQUE, choice.torque))
        for name in names
    )
    name, is_reversed = _axis(table, columns, choice, notes)
    judged = next(column for column in columns if column.name == name)
    quantity = FORCE if name in choice.force else TORQUE
    setpoint: Signal | float | None = None if level is None else level * units[quantity].factor
    if setpoint_name:
        recorded = Signal(time_s, values[setpoint_name] * units[quantity].factor)
        setpoint = _setpoint(table, setpoint_name, recorded)
    if not choice.axis and _is_opposite(judged.signal, setpoint):
        is_reversed = True
        notes.append(f"{name} is judged with the opposite sign, which its set point has")
    judged = _reversed(judged) if is_reversed else judged
    return ForceLog(columns, judged, setpoint, quantity, units, (*table.notes, *notes))


def band_of(text: str, log: ForceLog) -> Band:
    """Return the band of `--band`: `5%` of the step, or a force or torque such as `1N`."""
    match = BAND.fullmatch(text.strip())
    try:
        value = float(match[1]) if match else math.nan
    except ValueError:
        value = math.nan
    if match is None or not math.isfinite(value) or value <= 0.0:
        raise DataError(f"--band {text!r}: must be a positive number with % or a unit: 5% or 1N")
    if match[2] == "%":
        return Band(value, is_percent=True)
    unit = log.units[log.quantity] if match[2] is None else UNITS.get(match[2])
    if unit is None or unit.quantity != log.quantity:
        raise DataError(f"--band {text!r}: {match[2]} is no unit of a {log.quantity}")
    return Band(value * unit.factor, is_percent=False)


def _completed(table: LogTable, choice: ColumnChoice) -> tuple[ColumnChoice, list[str]]:
    """Return the choice with every column that was not named, and a note for each."""
    notes: list[str] = []
    if not choice.time:
        choice = replace(choice, time=_found_time(table))
        notes.append(f"time is column {choice.time!r}, by its name")
    if not choice.force and not choice.torque:
        force = _candidates(table, "force", ("f",), 0)
        torque = _candidates(table, "torque", ("t", "m"), 3)
        if not any(force) or not _is_unambiguous(force):
            several = ", ".join(name for names in force for name in names)
            what = f"{several} may be forces" if several else "no column is certainly a force"
            raise DataError(f"{table.path}: {what}: name them with --force; {columns_text(table)}")
        choice = replace(choice, force=sum(force, ()))
        if _is_unambiguous(torque):
            choice = replace(choice, torque=sum(torque, ()))
        and_torque = f", torque {', '.join(choice.torque)}" if choice.torque else ""
        notes.append(f"force is {', '.join(choice.force)}{and_torque}, by their names")
    if not choice.setpoint:
        columns = [name for name in table.names if _words(name)[-2:] == ["set", "point"]]
        columns += [name for name in table.names if _words(name)[-1:] in (["setpoint"], ["sp"])]
        if len(columns) == 1:
            choice = replace(choice, setpoint=columns[0])
            notes.append(f"the set point is column {columns[0]!r}, by its name")
    return choice, notes


def _found_time(table: LogTable) -> str:
    if table.time_names:
        return table.time_names[0]
    last = {name: _words(name)[-1:] for name in table.names}
    ranks = ([name for name in last if set(last[name]) & set(words)] for words in TIME_WORDS)
    found = next(filter(None, ranks), [])
    if len(found) == 1:
        return found[0]
    what = "no column is certainly the time" if not found else f"{' and '.join(found)} may be time"
    raise DataError(f"{table.path}: {what}: name it with --time; {columns_text(table)}")


def _candidates(
    table: LogTable, word: str, letters: tuple[str, ...], first: int
) -> list[tuple[str, ...]]:
    """Return the columns that may be the component x, y and z of a force or torque.

    `fx`, `force_x`, `wrench.force.x`, `Force X [N]`; numbers are those of Universal Robots'
    `actual_TCP_force_0` .. `_5`: forces, then torques.
    """
    found = []
    for number, axis in enumerate(AXIS_NAMES, first):
        last = {f"{letter}{axis}" for letter in letters} | {f"{word}{axis}"}
        pairs = ([word, axis], ["force", str(number)])
        words = {name: _words(name) for name in table.names}
        found.append(
            tuple(name for name in words if words[name][-1:] and words[name][-1] in last)
            + tuple(name for name in words if words[name][-2:] in pairs)
        )
    return found


def _is_unambiguous(candidates: Sequence[tuple[str, ...]]) -> bool:
    return all(len(names) <= 1 for names in candidates)


def _words(name: str) -> list[str]:
    """Return the words of a column's name without its unit."""
    words = re.findall(r"[a-z0-9]+", re.sub(r"[\[(].*?[\])]", "", name).lower())
    return [word for word in words if word not in UNIT_WORDS or len(words) == 1]


def _level_or_column(text: str) -> tuple[float | None, str]:
    try:
        level = float(text)
    except ValueError:
        return None, text
    if not abs(level) <= MOST_NUMBER:
        raise DataError(f"--setpoint {text}: must be a number within ±1e30 or a column")
    return level, ""


def _checked_times(table: LogTable, name: str, times: Array) -> Array:
    """Return times from 0 in their unit. Raises DataError where one is missing or decreases."""
    if len(times) < LEAST_SAMPLES:
        raise DataError(
            f"{table.path}: {len(times)} samples; at least {LEAST_SAMPLES} are needed for a report"
        )
    if len(missing := np.flatnonzero(np.isnan(times))):
        place = _place(table, int(missing[0]), name)
        raise DataError(f"{table.path}: {place}: the time is missing")
    if len(back := np.flatnonzero(np.diff(times) < 0.0)):
        at = int(back[0])
        raise DataError(
            f"{table.path}: {_place(table, at + 1, name)}: time decreases from {times[at]:.9g} to "
            f"{times[at + 1]:.9g}; samples must be in the order of time"
        )
    if times[0] == times[-1]:
        raise DataError(f"{table.path}: column {name!r} is constant and no time")
    from_zero: Array = times - times[0]
    return from_zero


def _place(table: LogTable, sample: int, name: str) -> str:
    """Return line or message of a sample, which is found by reading the rows again."""
    numbers = (number for number, _ in table.rows((name,)))
    number = next(number for at, number in enumerate(numbers) if at == sample)
    return f"{table.row_word} {number}, column {name!r}"


def _column(table: LogTable, name: str, raw: Signal, unit: LogUnit) -> LogColumn:
    """Return a column in N or N m, without the samples that have no value."""
    is_there = ~np.isnan(raw.value)
    count = int(np.count_nonzero(is_there))
    if count < LEAST_SAMPLES or np.ptp(raw.time_s[is_there]) == 0.0:
        raise DataError(
            f"{table.path}: column {name!r} has {count} values; at least {LEAST_SAMPLES} are "
            "needed, at different times"
        )
    signal = Signal(raw.time_s[is_there], raw.value[is_there] * unit.factor)
    return LogColumn(name, SI_NAMES[unit.quantity], signal, len(raw.value) - count)


def _reversed(column: LogColumn) -> LogColumn:
    opposite = Signal(column.signal.time_s, -column.signal.value)
    return replace(column, name=f"-{column.name}", signal=opposite)


def _axis(
    table: LogTable, columns: Sequence[LogColumn], choice: ColumnChoice, notes: list[str]
) -> tuple[str, bool]:
    """Return the name of the judged column, and whether its sign is reversed."""
    by_name = {column.name: column for column in columns}
    name, is_reversed = choice.axis, False
    if name.startswith("-") and name not in by_name:
        name, is_reversed = name[1:], True
    if not name:
        among = choice.force or choice.torque
        name = max(among, key=lambda each: float(np.ptp(by_name[each].signal.value)))
        if len(among) > 1:
            notes.append(f"{name} is judged, because it changes most; --axis names another")
    if name not in by_name:
        near = difflib.get_close_matches(name, by_name, n=1)
        hint = f"did you mean {near[0]}?" if near else f"choose from {', '.join(by_name)}"
        raise DataError(f"{table.path}: --axis {name!r} is no force or torque of the log: {hint}")
    return name, is_reversed


def _setpoint(table: LogTable, name: str, raw: Signal) -> Signal:
    """Return a recorded set point; a missing value is the one before it."""
    known = np.flatnonzero(~np.isnan(raw.value))
    if len(known) == 0:
        raise DataError(f"{table.path}: column {name!r}, the set point, has no value")
    samples = np.arange(known[0], len(raw.value))
    newest = known[np.searchsorted(known, samples, side="right") - 1]
    return Signal(raw.time_s[known[0] :], raw.value[newest])


def _is_opposite(signal: Signal, setpoint: Signal | float | None) -> bool:
    """Return whether a force has the sign opposite to that of its set point."""
    if setpoint is None:
        return False
    if isinstance(setpoint, float):
        return setpoint * float(np.mean(signal.value)) < 0.0
    at = np.searchsorted(setpoint.time_s, signal.time_s, side="right") - 1
    aimed = np.where(at >= 0, setpoint.value[np.maximum(at, 0)], 0.0)
    return float(aimed @ signal.value) < 0.0


def _unit_notes(
    units: dict[str, LogUnit], named: dict[str, LogUnit], choice: ColumnChoice
) -> list[str]:
    used = {TIME: True, FORCE: bool(choice.force), TORQUE: bool(choice.torque)}
    assumed = [units[each].symbol for each in used if used[each] and each not in named]
    is_default = all(units[each] == DEFAULTS[each] for each in used)
    how = "assumed" if is_default else "by the columns' names"
    return [f"units {', '.join(assumed)}: {how}; --units names others"] if assumed else []
