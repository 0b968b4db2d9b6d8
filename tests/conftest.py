"""What every test shares: how hypothesis draws, and what counts as a verdict.

On a developer's machine each run draws new examples; in CI the same ones are drawn every time, so
that a red run is always the change's own doing. What may be repeated: `tests/repeats.py`.
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

# No deadline per example: how long one takes is the machine's business, not the code's.
settings.register_profile("dev", deadline=None)
settings.register_profile("ci", deadline=None, derandomize=True, database=None, print_blob=True)
# Whether a mutant dies is all that `make mutate` asks: no example is made smaller.
settings.register_profile(
    "mutants", settings.get_profile("ci"), phases=(Phase.explicit, Phase.generate)
)
settings.load_profile("ci" if os.environ.get("CI") else "dev")

# The tree of verbs does not change, and takes longer to make than most of them to refuse.
typer.testing._get_command = cache(typer.testing._get_command)  # type: ignore[attr-defined]

# A panel beside every cell that a test brings up would take its time and its port: tests/browser
# asks for one where it is wanted.
os.environ.setdefault("FORCEMESH_NO_PANEL", "1")
os.environ.setdefault("FORCEMESH_NO_RECORDER", "1")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """In CI nothing passes by being left out: what this machine cannot try is a failure there."""
    report = yield
    if os.environ.get("CI") and report.skipped:
        report.outcome = "failed"
    return report


def pytest_collection_finish() -> None:
    """Leave what is there before the first test out of each later collection: it only gets read."""
    gc.collect()
    gc.freeze()


def pytest_configure(config: pytest.Config) -> None:
    """Let every run have its own witnesses and its own count."""
    folder = tempfile.TemporaryDirectory(prefix="witness-")
    config.add_cleanup(folder.cleanup)
    config.pluginmanager.register(Repeats(Path(folder.name)))
