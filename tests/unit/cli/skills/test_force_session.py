"""A skill that starts once a digital signal is on."""

from collections.abc import Iterator

import pytest

from cli.context import OK, USAGE
from cli.skills import force_session
from common.bus.configured_cell import ConfiguredCell
from tests.fakes.signals import armed_with_signals
from tests.fakes.verb_calls import run


@pytest.fixture(autouse=True)
def cell(monkeypatch: pytest.MonkeyPatch) -> Iterator[ConfiguredCell]:
    """An armed cell with signals."""
    with armed_with_signals(monkeypatch, force_session) as client:
        yield client


def test_a_skill_starts_once_its_signal_is_on(cell: ConfiguredCell) -> None:
    """The input follows an output that is on."""
    cell.signals.set("lamp")
    done = run("touch", "--when", "part")
    assert done.exit_code == OK, done.output
    assert "waiting until part is on" in done.output
    assert "contact with the TCP" in done.output


def test_a_skill_whose_signal_stays_off_moves_nothing(
    cell: ConfiguredCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It ends with the state of the signal; a wrong name ends it at once."""
    monkeypatch.setattr("forcemesh.client.signals.DigitalSignals.wait.__defaults__", (True, 0.2))
    before = cell.state().position_m
    done = run("press", "5", "--when", "part")
    assert done.exit_code != OK
    assert "part is off after 0.2 s, expected on" in done.output
    done = run("press", "5", "--when", "pump")
    assert done.exit_code == USAGE
    assert "no signal 'pump'" in done.output
    assert cell.state().position_m == pytest.approx(before, abs=1e-5)
    assert (cell.status().state, cell.status().commander) == ("ARMED", "none")
