"""Configuration of all tests: example generation of hypothesis, and the verdict of skipped tests.

On a developer's machine each run draws new examples; in CI the same ones are drawn every time, so
that a failed run is always caused by the change. Permitted repeats: `tests/repeats.py`.
"""

import gc
import os
import tempfile
from collections.abc import Generator
from functools import cache
from pathlib import Path

import pytest
import typer.testing
from hypothesis import Phase, settings

from tests.repeats import Repeats

# No deadline per example: its duration depends on the machine, not on the code.
settings.register_profile("dev", deadline=None)
settings.register_profile("ci", deadline=None, derandomize=True, database=None, print_blob=True)
# `tests.mutate` needs only the verdict on a mutant: no example is made smaller.
settings.register_profile(
    "mutants", settings.get_profile("ci"), phases=(Phase.explicit, Phase.generate)
)
settings.load_profile("ci" if os.environ.get("CI") else "dev")

# The tree of verbs does not change, and takes longer to make than most refusals.
typer.testing._get_command = cache(typer.testing._get_command)  # type: ignore[attr-defined]

# A panel for every cell that a test starts would take its time and its port: tests/browser
# starts one where it is needed.
os.environ.setdefault("FORCEMESH_NO_PANEL", "1")
os.environ.setdefault("FORCEMESH_NO_RECORDER", "1")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Count a skipped test as failed in CI."""
    report = yield
    if os.environ.get("CI") and report.skipped:
        report.outcome = "failed"
    return report


def pytest_collection_finish() -> None:
    """Freeze the objects that exist before the first test: later garbage collections skip them."""
    gc.collect()
    gc.freeze()


def pytest_configure(config: pytest.Config) -> None:
    """Give every run its own witnesses and its own count of repeats."""
    folder = tempfile.TemporaryDirectory(prefix="witness-")
    config.add_cleanup(folder.cleanup)
    config.pluginmanager.register(Repeats(Path(folder.name)))
