"""The verbs `signals list`, `set`, `wait` on a whole cell in virtual time."""

import json
from collections.abc import Iterator

import pytest

from cli import verbs_signals
from cli.context import NOT_WELL, OK, REFUSED, USAGE
from common.bus.configured_cell import ConfiguredCell
from tests.fakes.signals import ALL_OFF, armed_with_signals
from tests.fakes.verb_calls import run


@pytest.fixture(autouse=True)
def cell(monkeypatch: pytest.MonkeyPatch) -> Iterator[ConfiguredCell]:
    """An armed cell with signals."""
    monkeypatch.setenv("COLUMNS", "200")
    with armed_with_signals(monkeypatch, verbs_signals) as client:
        yield client


def test_the_signals_are_listed_with_who_may_set_them() -> None:
    """One row each; JSON is the state by name."""
    done = run("signals", "list")
    assert done.exit_code == OK
    lines = [line for line in done.output.splitlines() if "put " in line]
    rows = {line.strip("│ ").split()[0]: line for line in lines}
    assert set(rows) == set(ALL_OFF)
    assert all(word in rows["gripper_close"] for word in ("output 9", "off", "operator, program"))
    assert all(word in rows["lamp"] for word in ("output 10", "operator", "yes"))
    assert "input 1001" in rows["part"]
    assert json.loads(run("signals", "list", "--json").output) == ALL_OFF


def test_an_output_is_set_and_awaited(cell: ConfiguredCell) -> None:
    """By name or number; the input that follows it is awaited."""
    assert run("signals", "set", "lamp", "on").output == "lamp (output 10) is switched on\n"
    assert run("signals", "wait", "part").output == "part is on\n"
    assert run("signals", "set", "10", "off").output == "lamp (output 10) is switched off\n"
    assert run("signals", "wait", "part", "off").output == "part is off\n"
    assert cell.signals.read() == ALL_OFF


def test_a_refusal_is_one_line_with_its_code() -> None:
    """Another commander; an input; a name that is not in the cell file."""
    for words, code in (
        (("lamp", "on", "--as", "program"), "signal_not_permitted"),
        (("part", "on"), "signal_not_permitted"),
        (("pump", "on"), "signal_unknown"),
    ):
        done = run("signals", "set", *words)
        assert done.exit_code == REFUSED
        assert f"refused ({code})" in done.output
        assert done.output.count("\n") == 1


def test_a_wait_that_ends_in_vain_reports_the_state() -> None:
    """Exit code 1; a wrong name is a wrong usage."""
    done = run("signals", "wait", "part", "--timeout", "0.2")
    assert (done.exit_code, done.output) == (NOT_WELL, "part is off after 0.2 s, expected on\n")
    done = run("signals", "wait", "pump")
    assert done.exit_code == USAGE
    assert "no signal 'pump': the cell file names gripper_close, lamp, motor, part" in done.output
