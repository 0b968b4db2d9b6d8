"""Repetition of tests that failed while the machine itself stalled, and of no others.

Idle witnesses (`tests.chaos.witness`), one process for each processor, record the lateness of their
wake-ups. A failure of a test in real time is repeated once where one of them was late by more than
the deadline of the cell, within that test. Never repeated: tests marked `judged_once` (attacks,
misreads, movement), and every test that is not in real time.
"""

import time
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import pytest

from tests.chaos.witness import Witness, witness

DEADLINE_S = 0.1  # of commands and sensor data in the demo's cells; a marker may set another one
MOST_REPEATS = 3  # more fail the run: that machine is not suitable for a verdict


class Repeats:
    """Permits a second try where the witness recorded a stall, and reports every repetition."""

    def __init__(self, folder: Path) -> None:
        """Store the folder of the witnesses' records."""
        self._folder = folder
        self._exits = ExitStack()
        self.witness = Witness([])
        self._began_ns = 0
        self._reported: list[str] = []

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Let a failed test in real time be repeated if the witness recorded a stall."""
        for item in items:
            if may_be_repeated(item):
                stalled = partial(self._has_stalled, deadline_of(item))
                item.add_marker(pytest.mark.flaky(reruns=1, condition=stalled))

    def pytest_collection_finish(self, session: pytest.Session) -> None:
        """Start the witnesses if a collected test may be repeated."""
        if not session.config.option.collectonly and any(map(may_be_repeated, session.items)):
            self.witness = self._exits.enter_context(witness(self._folder))

    def pytest_runtest_logstart(self) -> None:
        """Store the start time of a try."""
        self._began_ns = time.monotonic_ns()

    def _has_stalled(self, deadline_s: float) -> bool:
        return self.witness.worst_s(self._began_ns, time.monotonic_ns()) > deadline_s

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Store a failure that is about to be repeated."""
        if str(report.outcome) == "rerun":
            crash = getattr(report.longrepr, "reprcrash", None)
            why = crash.message.splitlines()[0] if crash else report.longreprtext
            self._reported.append(f"REPEATED, the machine stood still: {report.nodeid}: {why}")

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """End the witnesses; fail a run with more repeats than permitted."""
        self._exits.close()
        if len(self._reported) > MOST_REPEATS:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED
            self._reported.append(
                f"{len(self._reported)} repeats, {MOST_REPEATS} are allowed: failed"
            )

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """Print the repetitions."""
        for line in self._reported:
            terminalreporter.write_line(line)


def may_be_repeated(item: pytest.Item) -> bool:
    """Return whether a stall of the machine may be the cause when a test fails.

    The browser's tests share a cell, which a repeat would end.
    """
    once = item.get_closest_marker("judged_once") or item.get_closest_marker("browser")
    return once is None and real_time(item) is not None


def real_time(item: pytest.Item) -> pytest.Mark | None:
    """Return the marker of a test in real time."""
    return item.get_closest_marker("realtime") or item.get_closest_marker("processes")


def deadline_of(item: pytest.Item) -> float:
    """Return the shortest deadline that a test's processes can miss [s]."""
    mark = item.get_closest_marker("realtime")
    return float(mark.kwargs.get("deadline_s", DEADLINE_S)) if mark else DEADLINE_S
