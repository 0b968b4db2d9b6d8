"""`make compose-test` without containers: its message without an engine, and its repeats."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from common.bus.memory_bus import MemoryTransport
from common.config.load import load_cell
from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.clock import ManualClock
from tests.compose import __main__ as compose_test
from tests.compose.rig import MOST_REPEATS, Operator, RequirementError

ROOT = Path(__file__).resolve().parents[4]


@pytest.mark.parametrize(("words", "code"), [((), 77), (("--optional",), 0)])
def test_without_an_engine_it_reports_that_loudly(
    tmp_path: Path, words: tuple[str, ...], code: int
) -> None:
    """No test runs and none passes silently: a line for people, a code for programs."""
    environment = {**os.environ, "PATH": str(tmp_path), "DOCKER_HOST": f"unix://{tmp_path}/none"}
    done = subprocess.run(
        [sys.executable, "-m", "tests.compose", *words],
        cwd=ROOT, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == code, done.stderr
    assert "NOT TESTED: containers. No engine can be had here" in done.stdout


@pytest.mark.parametrize(("ended_with", "code"), [(0, 0), (1, 1), (-9, 1), (77, 1)])
def test_checks_that_a_signal_ended_have_not_passed(
    monkeypatch: pytest.MonkeyPatch, ended_with: int, code: int
) -> None:
    """Such a process has a negative exit code."""
    monkeypatch.setattr(compose_test, "Compose", lambda *_: lambda *_: "")
    ended = subprocess.CompletedProcess[str]([], ended_with)
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: ended)
    assert compose_test.check("sim", "") == code


class Machine:
    """Report of a witness about a machine that stood still for so long."""

    def __init__(self, stalled_s: float) -> None:
        self.stalled_s = stalled_s

    def worst_s(self, since_ns: int, until_ns: int) -> float:
        """Return it for any window."""
        assert since_ns < until_ns
        return self.stalled_s


class Broken:
    """A promise that is broken the first times, and how often it was asked for."""

    def __init__(self, times: int) -> None:
        self.times, self.asked = times, 0

    def __call__(self) -> str:
        """Break it, or keep it."""
        self.asked += 1
        if self.asked <= self.times:
            raise RequirementError("not within 40 s")
        return "kept"


@pytest.fixture
def at_home(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the arm be at home at once."""
    monkeypatch.setattr(Operator, "retreat", lambda _: None)


def operator(stalled_s: float) -> Operator:
    """Return the operator of a cell on such a machine."""
    cell, transport = load_cell(ROOT / "cells" / "demo.yaml"), MemoryTransport()
    bus = Bus(topics.CLIENT, cell.cell, transport, cell, ManualClock())
    return Operator(cell, bus, Machine(stalled_s))  # type: ignore[arg-type]


@pytest.mark.usefixtures("at_home")
@pytest.mark.parametrize(("stalled_s", "times"), [(0.0, 1), (0.09, 1), (0.2, 2)])
def test_a_broken_promise_stays_broken(stalled_s: float, times: int) -> None:
    """On a machine that went on, or was late by less than the deadline; and the second time."""
    broken = Broken(times)
    with pytest.raises(RequirementError):
        operator(stalled_s).again_after_a_stall(broken)
    assert broken.asked == times


@pytest.mark.usefixtures("at_home")
def test_after_a_stall_it_is_tried_once_more_some_times_in_all() -> None:
    """Each of them is counted."""
    someone = operator(0.2)
    for count in range(1, MOST_REPEATS + 1):
        assert someone.again_after_a_stall(Broken(1)) == "kept"
        assert someone.repeats == count
    with pytest.raises(RequirementError):
        someone.again_after_a_stall(Broken(1))
