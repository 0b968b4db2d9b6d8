"""Study of scale: what counts as late, fitted costs, and the page."""

import pytest

from bench.chain.load import Load
from bench.scale import ScaleCase, ScaleRun, cost, note, page
from forcemesh.messages import Health


def measured_run(cells: int, subscribers: int, hub_pct: float, late: str = "") -> ScaleRun:
    """Return a run whose hub takes so much, and whose robot takes 40 % for each cell."""
    load = {"one hub": Load(hub_pct, 0.0, {}), "one robot": Load(40.0 * cells, 0.0, {})}
    return ScaleRun(ScaleCase(cells, subscribers), load, late=late)


def health(**values: float | str) -> Health:
    """Return the health of a process."""
    defaults = {"pid": 1, "rate_hz": 250.0, "lateness_p99_s": 0.0, "version": "1"}
    return Health.from_dict({**defaults, "config_hash": "x", **values})


def test_costs_are_the_slopes_of_the_runs_that_held() -> None:
    """Cells without subscribers, subscribers of one cell; a late run does less work."""
    runs = [measured_run(1, count, 10.0 + 0.5 * count) for count in (0, 10, 50)]
    runs += [measured_run(2, 0, 20.0), measured_run(3, 0, 5.0, late="an arm held")]
    assert cost(runs, "subscribers") == pytest.approx(0.5)
    assert cost(runs, "cells") == pytest.approx(50.0)
    assert cost(runs[:1], "cells") is None


def test_a_run_is_late_by_its_first_overrun_and_keeps_the_longest_gap() -> None:
    """Every report of health is noted."""
    found = ScaleRun(ScaleCase(1))
    note(found, "hub", health(longest_gap_s=0.05))
    note(found, "robot", health(longest_gap_s=0.004))
    assert (found.longest_gap_s, found.late) == (0.004, "")
    note(found, "arbiter", health(longest_gap_s=0.09, overruns=1, late_cause="other processes ran"))
    note(found, "wrench", health(longest_gap_s=0.03, overruns=2, late_cause="something else"))
    assert (found.longest_gap_s, found.late) == (0.09, "arbiter was late: other processes ran")


def test_the_page_has_a_row_for_each_run_and_the_costs() -> None:
    """A run that never pressed has no processor time; cells in a tree have a table of their own."""
    runs = [measured_run(1, 0, 10.0), measured_run(2, 0, 20.0)]
    runs += [ScaleRun(ScaleCase(3, duration_s=600.0), late="no hub")]
    text = page(runs)
    assert "| 2, 0, 20 | 100 | 20 | 0 ms | all held |" in text
    assert "| 3, 0, 600 | - | - | 0 ms | no hub |" in text
    assert text.endswith(
        "By least squares over the runs that held: 50.0 % of a core for each cell."
    )
    assert "least squares" not in page(runs[2:])
    assert "tree" not in text
    tree = ScaleRun(ScaleCase(4, tree=True), top_hz=500.0)
    assert "| 4 | - | - | 0 ms | 500 Hz | all held |" in page([*runs, tree])
