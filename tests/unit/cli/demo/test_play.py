"""How the demo ends when its cell does not go along."""

from contextlib import nullcontext
from pathlib import Path

import pytest

from cli.demo import play as demo_play
from cli.demo.scenario import ScenarioError, ScenarioPlan
from common.config.load import load_cell
from forcemesh.errors import BusError, ForcemeshError

CELL = Path(__file__).parents[4] / "cells" / "demo.yaml"
UNHEARD = "arbiter did not answer demo/arbiter/arm within 2 s"


class Mourners:
    """Processes one of which may have died; they note how long they were to stay up."""

    def __init__(self, *died: str) -> None:
        """Know who died."""
        self.died = died
        self.lingers_s: list[float] = []

    def __enter__(self) -> "Mourners":
        """Start nothing."""
        return self

    def __exit__(self, *_: object) -> None:
        """Stop nothing."""

    def wait_ready(self) -> None:
        """Be ready."""

    def hold_after_death(self, linger_s: float) -> None:
        """Note for how long."""
        self.lingers_s.append(linger_s)


def play(monkeypatch: pytest.MonkeyPatch, mourners: Mourners) -> ForcemeshError:
    """Return how a demo ends whose request is not answered."""

    def unheard(_scenario: object) -> None:
        raise BusError(UNHEARD)

    monkeypatch.setattr("launch.processes.Supervisor", lambda _cell: mourners)
    monkeypatch.setattr("common.bus.cell_bus.open_bus", lambda *_: nullcontext())
    monkeypatch.setattr(demo_play, "Scenario", lambda *_, **__: type("S", (), {"run": unheard})())
    with pytest.raises(ForcemeshError) as caught:
        demo_play.play_real(load_cell(CELL), ScenarioPlan(), lambda *_: None, 7.0)
    return caught.value


def test_a_death_in_the_middle_of_a_request_is_told_like_any_other(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Nobody answers because the hub was killed: the rest stays up, and who died is named."""
    mourners = Mourners("hub (pid 7) was ended by SIGKILL")
    error = play(monkeypatch, mourners)
    assert isinstance(error, ScenarioError)
    assert str(error) == f"hub (pid 7) was ended by SIGKILL: {UNHEARD}"
    assert mourners.lingers_s == [7.0]


def test_a_request_that_nobody_answers_is_told_as_that(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody died: the exit code is that of no answer, and the arbiter was asked to hold."""
    mourners = Mourners()
    error = play(monkeypatch, mourners)
    assert isinstance(error, BusError)
    assert str(error) == UNHEARD
    assert mourners.lingers_s == [7.0]
