"""The verbs `signals list`, `set`, `wait`, and a skill that starts once a signal is on."""

import json
from collections.abc import Iterator

import pytest

from cli import verbs_signals
from cli.context import NOT_WELL, OK, REFUSED, USAGE
from cli.skills import force_session
from common.bus.configured_cell import ConfiguredCell
from tests.fakes.signals import ALL_OFF, armed_with_signals
from tests.fakes.verb_calls import run


@pytest.fixture(autouse=True)
def cell(monkeypatch: pytest.MonkeyPatch) -> Iterator[ConfiguredCell]:
    """An armed cell with signals in virtual time."""
    monkeypatch.setenv("COLUMNS", "200")
    with armed_with_signals(monkeypatch, verbs_signals) as client:
        monkeypatch.setattr(force_session, "cell_of", vars(verbs_signals)["cell_of"])
        yield client


def test_an_output_is_set_and_awaited(cell: ConfiguredCell) -> None:
    """By name or number; the input that follows it is awaited; JSON is the state by name."""
    assert run("signals", "set", "lamp", "on").output == "lamp (output 10) is switched on\n"
    assert run("signals", "wait", "part").output == "part is on\n"
    assert run("signals", "set", "10", "off").output == "lamp (output 10) is switched off\n"
    assert run("signals", "wait", "part", "off").output == "part is off\n"
    assert cell.signals.read() == ALL_OFF
    assert json.loads(run("signals", "list", "--json").output) == ALL_OFF
    (line,) = [line for line in run("signals", "list").output.splitlines() if "lamp" in line]
    assert all(word in line for word in ("output 10", "operator", "yes"))


@pytest.mark.parametrize(
    ("words", "code", "text"),
    [
        (("set", "lamp", "on", "--as", "program"), REFUSED, "refused (signal_not_permitted)"),
        (("set", "part", "on"), REFUSED, "refused (signal_not_permitted)"),
        (("set", "pump", "on"), REFUSED, "refused (signal_unknown)"),
        (("wait", "part", "--timeout", "0.2"), NOT_WELL, "part is off after 0.2 s, expected on"),
        (("wait", "pump"), USAGE, "no signal 'pump': the cell file names gripper_close, lamp"),
    ],
)
def test_a_refusal_is_one_line_with_its_code(words: tuple[str, ...], code: int, text: str) -> None:
    """Another commander; an input; a name that is not in the cell file; a wait in vain."""
    done = run("signals", *words)
    assert (done.exit_code, done.output.count("\n")) == (code, 1)
    assert text in done.output


def test_a_skill_starts_once_its_signal_is_on(
    cell: ConfiguredCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a signal that stays off, nothing moves; the input follows an output that is on."""
    before = cell.state().position_m
    monkeypatch.setattr("forcemesh.client.signals.DigitalSignals.wait.__defaults__", (True, 0.2))
    done = run("press", "5", "--when", "part")
    assert done.exit_code != OK
    assert "part is off after 0.2 s, expected on" in done.output
    assert cell.state().position_m == pytest.approx(before, abs=1e-5)
    assert (cell.status().state, cell.status().commander) == ("ARMED", "none")
    cell.signals.set("lamp")
    done = run("touch", "--when", "part")
    assert done.exit_code == OK, done.output
    assert "contact with the TCP" in done.output
