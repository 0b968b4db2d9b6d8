"""What every test shares: how hypothesis draws, and what happens when the machine stalls.

On a developer's machine each run draws new examples; in CI the same ones are drawn every time, so
that a red run is always the change's own doing.

A test in real time that fails is repeated once: a shared machine that stalls for 250 ms makes an
arm hold, and rightly so. Repeats are listed at the end, and more than a few fail the run.
"""

import os

import pytest
from hypothesis import settings

# No deadline per example: how long one takes is the machine's business, not the code's.
settings.register_profile("dev", deadline=None)
settings.register_profile("ci", deadline=None, derandomize=True, database=None, print_blob=True)
settings.load_profile("ci" if os.environ.get("CI") else "dev")

# A panel beside every cell that a test brings up would take its time and its port: tests/browser
# asks for one where it is wanted.
os.environ.setdefault("FORCEMESH_NO_PANEL", "1")
os.environ.setdefault("FORCEMESH_NO_RECORDER", "1")

MOST_REPEATS = 3


class Repeats:
    """Allows a real-time test a second try, tells which needed one, fails a run with too many."""

    def __init__(self) -> None:
        self._told: list[str] = []

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Repeat once what lives in real time."""
        for item in items:
            # Not the browser's: a repeat would end the cell that all of them share.
            if item.get_closest_marker("browser"):
                continue
            if item.get_closest_marker("realtime") or item.get_closest_marker("processes"):
                item.add_marker(pytest.mark.flaky(reruns=1))

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Remember a failure that is about to be repeated."""
        if str(report.outcome) == "rerun":
            crash = getattr(report.longrepr, "reprcrash", None)
            why = crash.message.splitlines()[0] if crash else report.longreprtext
            self._told.append(f"REPEATED, it failed at first: {report.nodeid}: {why}")

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Fail a run that needed more repeats than a stalling machine explains."""
        if len(self._told) > MOST_REPEATS:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED
            self._told.append(f"{len(self._told)} repeats, {MOST_REPEATS} are allowed: failed")

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """Say what was repeated."""
        for line in self._told:
            terminalreporter.write_line(line)


def pytest_configure(config: pytest.Config) -> None:
    """Let every run have its own count."""
    config.pluginmanager.register(Repeats())
