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


@pytest.mark.parametrize("mode", settling.MODES)
def test_the_releases_of_the_demo_settle_as_stored(mode) -> None:
    """Settling, tau and overshoot of one mode, in every place."""
    places = [n for n, case in enumerate(settling.ROWS.cases) if case["mode"] == mode]
    assert drift("settling", "rows", settling.ROWS, places) == []


@pytest.mark.parametrize("number", range(0, len(over_tcp.CASES), 30))
def test_a_release_over_tcp_settles_as_stored(number: int) -> None:
    """One of thirty rows: all of them take a quarter of an hour."""
    assert drift("over-tcp", "rows", over_tcp.ROWS, [number]) == []


@pytest.mark.parametrize(
    ("name", "step"),
    [
        ("slow-loops", 1),
        ("over-tcp", 5),
        ("limited-speed", 2),
        ("release", 16),
        ("slow-brakes", 12),
        ("one-gain", 11),
        ("press", 7),
        ("slope", 7),
        ("guide-to-a-wall", 7),
    ],
)
def test_rows_of_the_force_bench_are_as_stored(name: str, step: int) -> None:
    """All or some of a table; the whole bench takes a long time."""
    cases = TABLES[name]
    assert drift("force", name, cases, range(0, len(cases.cases), step)) == []


def test_a_path_with_force_is_as_stored() -> None:
    """The adaptive law at the place that is promised."""
    place = paths.ROWS.cases.index(paths.PROMISED)
    assert drift("force-path", "rows", paths.ROWS, [place]) == []


@pytest.mark.parametrize("name", axes.TABLES)
def test_tasks_per_axis_are_as_stored(name: str) -> None:
    """The first case of the adaptive law."""
    assert drift("force-axes", name, axes.TABLES[name], [0]) == []


@pytest.mark.parametrize("number", range(0, len(faults.ROWS.cases), 20))
def test_a_fault_in_motion_is_as_stored(number: int) -> None:
    """One of twenty."""
    assert drift("faults", "rows", faults.ROWS, [number]) == []


def test_faults_and_wirings_of_the_sensor_are_as_stored() -> None:
    """Every third fault, and one of twelve wirings."""
    for name, cases, step in (
        ("faults", sensor_faults.FAULT_ROWS, 3),
        ("wirings", sensor_faults.WIRING_ROWS, 12),
    ):
        assert drift("sensor-faults", name, cases, range(0, len(cases.cases), step)) == []
