"""Results measured on the virtual clock: rows of docs/results, measured again, are the same.

That pages show what the results are is tested in tests/unit/bench/test_harness.py.
"""

from collections.abc import Iterable

import pytest

from bench import faults, over_tcp, sensor_faults, settling
from bench.force import axes, paths
from bench.force.tables import TABLES
from bench.harness import CaseTable
from bench.results import read, table

pytestmark = [pytest.mark.long, pytest.mark.timeout(600)]


def drift(result: str, name: str, cases: CaseTable, places: Iterable[int]) -> list[object]:
    """Return stored and new rows that differ in a column that is still measured."""
    stored, chosen = read(result).tables[name], [*places]
    again = table(stored.columns, [cases.row(cases.cases[place]) for place in chosen])
    before = table(again.columns, [stored.records[place] for place in chosen])
    assert len(again.columns) > 2
    return [pair for pair in zip(before.rows, again.rows, strict=True) if pair[0] != pair[1]]


@pytest.mark.parametrize(
    ("result", "name", "cases", "step"),
    [
        ("settling", "rows", settling.ROWS, 3),
        ("over-tcp", "rows", over_tcp.ROWS, 30),
        ("force", "slow-loops", TABLES["slow-loops"], 1),
        ("force", "over-tcp", TABLES["over-tcp"], 5),
        ("force", "limited-speed", TABLES["limited-speed"], 2),
        ("force", "release", TABLES["release"], 16),
        ("force", "slow-brakes", TABLES["slow-brakes"], 12),
        ("force", "one-gain", TABLES["one-gain"], 11),
        ("force", "press", TABLES["press"], 7),
        ("force", "slope", TABLES["slope"], 7),
        ("force", "guide-to-a-wall", TABLES["guide-to-a-wall"], 7),
        *(("force-axes", name, cases, len(cases.cases)) for name, cases in axes.TABLES.items()),
        ("faults", "rows", faults.ROWS, 20),
        ("sensor-faults", "faults", sensor_faults.FAULT_ROWS, 3),
        ("sensor-faults", "wirings", sensor_faults.WIRING_ROWS, 12),
    ],
)
def test_rows_measured_again_are_as_stored(result, name, cases, step) -> None:
    """All or some of a table; the whole bench takes a long time."""
    assert drift(result, name, cases, range(0, len(cases.cases), step)) == []


def test_a_path_with_force_is_as_stored() -> None:
    """The adaptive law at the place that is promised."""
    place = paths.ROWS.cases.index(paths.PROMISED)
    assert drift("force-path", "rows", paths.ROWS, [place]) == []
