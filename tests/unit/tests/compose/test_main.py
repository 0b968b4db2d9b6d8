"""`make compose-test` without containers: its message without an engine, the holds it accepts."""

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
from forcemesh.faults import tripped
from forcemesh.messages import ArbiterState, ArbiterStatus, Trip
from tests.compose import __main__ as compose_test
from tests.compose.rig import MOST_HOLDS, Operator, RequirementError

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


class Pressing:
    """An action that a hold ends the first times."""

    def __init__(self, times: int) -> None:
        self.times, self.asked = times, 0

    def __call__(self) -> str:
        """Be held, or end well."""
        self.asked += 1
        if self.asked <= self.times:
            raise RequirementError("HOLDING while it presses")
        return "steady"


@pytest.fixture
def operator(monkeypatch: pytest.MonkeyPatch) -> Operator:
    """Return the operator of an arm that rests, and is home at once."""
    monkeypatch.setattr(Operator, "rests", lambda *_: None)
    monkeypatch.setattr(Operator, "retreat", lambda _: None)
    cell, transport = load_cell(ROOT / "cells" / "demo.yaml"), MemoryTransport()
    return Operator(cell, Bus(topics.CLIENT, cell.cell, transport, cell, ManualClock()))


def hold(operator: Operator, *trips: Trip, state: ArbiterState = "FAULT") -> None:
    """Publish a status of the arbiter."""
    bus = operator.client
    arbiter = Bus("arbiter", bus.cell, bus.transport, operator.cell, bus.clock)
    status = ArbiterStatus(state=state, trips=trips)
    arbiter.publisher(topics.ARBITER_STATUS).put(status)


def late(age_ms: int) -> Trip:
    """Return the trip of a late robot."""
    return tripped("stale", f"robot/state stale: {age_ms} ms old, limit 100 ms")


def test_a_hold_in_time_for_a_late_process_is_passed_and_the_action_repeated(
    operator: Operator,
) -> None:
    """A few times in all: a machine on which each press ends so is none to test on."""
    hold(operator, late(105), tripped("overrun", "wrench was late 4 times within a second"))
    assert operator.again_after_a_late_hold(Pressing(MOST_HOLDS)) == "steady"
    assert operator.holds == MOST_HOLDS
    with pytest.raises(RequirementError, match="HOLDING"):
        operator.again_after_a_late_hold(Pressing(1))


def test_a_process_that_was_restarted_was_not_late(
    operator: Operator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It crashed, and its silence looks the same from outside."""
    epochs = iter([{"wrench": 7, "arbiter": 8}, {"wrench": 9, "arbiter": 8}])
    monkeypatch.setattr(operator, "processes", lambda: next(epochs))
    hold(operator, late(105))
    with pytest.raises(RequirementError, match=r"'wrench'\} ended"):
        operator.again_after_a_late_hold(Pressing(1))


@pytest.mark.parametrize(
    ("trips", "state", "text"),
    [
        ((late(105), tripped("force", "force 50 N")), "FAULT", "held for {'force'}"),
        ((late(400),), "FAULT", "held only after 400 ms"),
        ((), "FAULT", "HOLDING"),
        ((late(105),), "ACTIVE", "HOLDING"),
    ],
)
def test_any_other_end_fails(
    operator: Operator, trips: tuple[Trip, ...], state: ArbiterState, text: str
) -> None:
    """A wrong reason, a hold that came too late, or none."""
    hold(operator, *trips, state=state)
    pressing = Pressing(1)
    with pytest.raises(RequirementError, match=text):
        operator.again_after_a_late_hold(pressing)
    assert (pressing.asked, operator.holds) == (1, 0)
