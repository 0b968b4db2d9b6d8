"""Demos during other work: what is started, and how results are counted."""

import json
import os
import subprocess
import sys
import threading

import pytest

from bench import demos
from bench.demos import (
    A_USERS,
    CASES,
    ROOTS_OWN,
    DemoCase,
    DemoResults,
    LongPress,
    building,
    play,
)
from forcemesh.messages import Health

GOOD = {"settled": True, "overshoot_pct": 2.5, "settling_s": 0.12}
ASKS_FOR_PRIORITY = """
import os
try:
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
except PermissionError:
    print("refused")
"""


def test_results_are_counted_and_failures_keep_their_reason() -> None:
    """A demo that held, one that did not settle, one that printed no JSON."""
    results = DemoResults()
    for printed in (
        json.dumps(GOOD),
        json.dumps(GOOD | {"overshoot_pct": 0.0}),
        json.dumps({"settled": False, "error": "the arm holds: sensor silent"}),
        json.dumps(GOOD | {"settled": False}),
        "usage: demo\nno such option",
        "",
    ):
        results.add(printed)
    assert (results.settled, results.overshoot_pct) == (2, [2.5, 0.0])
    assert results.failures == [
        "the arm holds: sensor silent",
        "the force did not settle",
        "no such option",
        "no output",
    ]


def test_each_case_has_its_words() -> None:
    """They are the rows of the page."""
    assert str(DemoCase()) == "nothing; SCHED_FIFO"
    busy = "4 busy loops, 2 builds, another cell, not armed; ordinary priority"
    assert str(DemoCase(busy=True, realtime=False)) == busy
    assert len(set(map(str, CASES))) == len(CASES)


def test_without_priority_the_right_to_it_is_gone() -> None:
    """Root has it by a capability, a user by a limit."""
    words = ROOTS_OWN if os.geteuid() == 0 else A_USERS
    command = [*words, sys.executable, "-c", ASKS_FOR_PRIORITY]
    found = subprocess.run(command, capture_output=True, text=True, check=True)
    assert found.stdout == "refused\n"


@pytest.mark.parametrize("realtime", [True, False])
def test_each_run_is_a_demo_as_a_user_starts_it(
    monkeypatch: pytest.MonkeyPatch, realtime: bool
) -> None:
    """One after the other; each into the results."""
    commands: list[list[str]] = []

    def run(words: list[str], **_: object) -> subprocess.CompletedProcess[str]:
        commands.append(words)
        return subprocess.CompletedProcess(words, 0, stdout=json.dumps(GOOD), stderr="")

    monkeypatch.setattr("subprocess.run", run)
    assert play(DemoCase(realtime=realtime), runs=3).settled == 3
    assert len(commands) == 3
    assert all("--law adaptive --json" in " ".join(words) for words in commands)
    assert all((words[0] == sys.executable) == realtime for words in commands)


@pytest.mark.processes
def test_builds_run_until_the_end_of_the_block(monkeypatch: pytest.MonkeyPatch) -> None:
    """They are started again and again; none is left."""
    started, enough = [], threading.Event()

    def run(words: list[str], **_: object) -> None:
        started.append(words)
        if len(started) > 2 * demos.BUILDS:
            enough.set()

    monkeypatch.setattr("subprocess.run", run)
    with building():
        assert enough.wait(timeout=60.0)
    count = len(started)
    assert not any("build" in thread.name for thread in threading.enumerate())
    assert len(started) == count


def test_a_long_press_is_late_by_its_first_overrun_and_keeps_the_longest_gap() -> None:
    """Every report of health is noted; a gap of the hub's loop is none of the chain."""
    found = LongPress()
    found.note("hub", health(longest_gap_s=0.05))
    found.note("robot", health(longest_gap_s=0.004))
    assert (found.longest_gap_s, found.late) == (0.004, "")
    found.note("arbiter", health(longest_gap_s=0.09, overruns=1, late_cause="other processes ran"))
    found.note("wrench", health(longest_gap_s=0.03, overruns=2, late_cause="something else"))
    assert (found.longest_gap_s, found.late) == (0.09, "arbiter was late: other processes ran")


def health(**values: float | str) -> Health:
    """Return the health of a process."""
    defaults = {"pid": 1, "rate_hz": 250.0, "lateness_p99_s": 0.0, "version": "1"}
    return Health.from_dict({**defaults, "config_hash": "x", **values})
