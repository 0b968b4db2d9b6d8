"""Verb `forecast`: a table, JSON and warnings, without a hub."""

import json
from functools import partial

from cli.context import OK, USAGE
from tests.fakes import verb_calls
from tests.fakes.bench import CELL, DEMO
from tuning.forecast import ForceJob, forecast

run = partial(verb_calls.run, "forecast")


def test_the_table_has_each_quantity_and_json_its_interval() -> None:
    """In SI units, with the entries of the command line; no warning while no limit is broken."""
    done = run(15, "--cell", DEMO)
    assert (done.exit_code, done.stderr) == (OK, "")
    for part in ("settles after touch", "peak of the press", "error at 20 mm/s", "60 N", "within"):
        assert part in done.stdout
    words = ("--law", "adaptive", "--stiffness", 9000, "--speed", 30, "--slope", 5)
    tree = json.loads(run(12, *words, "--cell", DEMO, "--json").stdout)
    found = forecast(CELL, ForceJob(12.0, 9000.0, "adaptive", feed_m_s=0.03, slope_deg=5.0))
    assert found.follow_error_N is not None
    assert tree["settling_s"] == [found.settling_s.low, found.settling_s.high]
    assert tree["peak_N"] == [found.peak_N.low, found.peak_N.high]
    assert tree["follow_error_N"] == [found.follow_error_N.low, found.follow_error_N.high]
    assert (tree["law"], tree["stiffness_N_m"], tree["warnings"]) == ("adaptive", 9000.0, [])


def test_a_limit_that_is_broken_and_what_is_not_covered_have_their_reason() -> None:
    """On standard error, and in the JSON; the exit code is that of a forecast."""
    words: tuple[object, ...] = (35, "--speed", 45, "--slope", 30, "--cell", DEMO)
    done = run(*words)
    assert done.exit_code == OK
    assert "limits.force_N is 60 N, where the arm holds: feed at most" in done.stderr
    assert json.loads(run(*words, "--json").stdout)["warnings"] == [done.stderr.rstrip("\n")]
    words = (15, "--speed", 900, "--cell", DEMO)
    assert "no forecast: stiffness times speed of the surface" in run(*words).stderr
    assert json.loads(run(*words, "--json").stdout)["follow_error_N"] is None
    done = run(15, "--host", "controller", "--cell", DEMO)
    assert (done.exit_code, done.stderr.count("\n")) == (USAGE, 1)
    assert "the map was measured with host pc" in done.stderr
