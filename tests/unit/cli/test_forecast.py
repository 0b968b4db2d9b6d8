"""Verb `forecast`: a table, JSON, warnings and refusals, without a hub."""

import json
from functools import partial

import pytest

from cli.context import OK, USAGE
from tests.fakes import verb_calls
from tests.fakes.bench import CELL, DEMO
from tuning.forecast import ForceJob, forecast

run = partial(verb_calls.run, "forecast")


def test_a_table_has_each_quantity_with_its_limit_and_verdict() -> None:
    """Nothing on standard error while no limit is broken."""
    done = run(15, "--cell", DEMO)
    assert (done.exit_code, done.stderr) == (OK, "")
    assert done.stdout.startswith(
        "cell demo: 15 N on 2e+04 N/m, law plain, 34 ms of delay in the loop\n"
    )
    for part in ("settles after touch", "peak of the press", "error at 20 mm/s", "60 N", "within"):
        assert part in done.stdout


def test_json_has_the_intervals_of_the_forecast() -> None:
    """In SI units, with the entries of the command line."""
    words = ("--law", "adaptive", "--stiffness", 9000, "--speed", 30, "--slope", 5)
    tree = json.loads(run(12, *words, "--cell", DEMO, "--json").stdout)
    found = forecast(CELL, ForceJob(12.0, 9000.0, "adaptive", feed_m_s=0.03, slope_deg=5.0))
    assert found.follow_error_N is not None
    assert tree["settling_s"] == [found.settling_s.low, found.settling_s.high]
    assert tree["peak_N"] == [found.peak_N.low, found.peak_N.high]
    assert tree["follow_error_N"] == [found.follow_error_N.low, found.follow_error_N.high]
    assert (tree["law"], tree["stiffness_N_m"], tree["warnings"]) == ("adaptive", 9000.0, [])


def test_a_broken_limit_is_warned_of_with_the_remedy() -> None:
    """On standard error, and in the JSON; the exit code is that of a forecast."""
    words = (35, "--speed", 45, "--slope", 30, "--cell", DEMO)
    done = run(*words)
    assert done.exit_code == OK
    assert "limits.force_N is 60 N, where the arm holds: feed at most" in done.stderr
    assert json.loads(run(*words, "--json").stdout)["warnings"] == [done.stderr.rstrip("\n")]


def test_a_slope_that_is_not_covered_has_its_reason() -> None:
    """Settling and peak are shown nevertheless."""
    done = run(15, "--speed", 900, "--cell", DEMO)
    assert "not covered" in done.stdout
    assert "no forecast: stiffness times speed of the surface" in done.stderr
    assert (
        json.loads(run(15, "--speed", 900, "--cell", DEMO, "--json").stdout)["follow_error_N"]
        is None
    )


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ((2,), "set point is 2 N, measured were"),
        ((15, "--stiffness", 30000), "contact.stiffness_N_m relative to this contact"),
        ((15, "--host", "controller"), "the map was measured with host pc"),
    ],
)
def test_a_job_outside_of_the_map_is_refused(words: tuple[object, ...], sentence: str) -> None:
    """In one sentence."""
    done = run(*words, "--cell", DEMO)
    assert done.exit_code == USAGE
    assert done.stderr.startswith("no forecast")
    assert sentence in done.stderr
    assert done.stderr.count("\n") == 1
