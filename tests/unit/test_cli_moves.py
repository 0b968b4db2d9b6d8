"""A move from the command line ends when its goal does, whoever ended it."""

import click
import pytest
import typer
from typer.testing import CliRunner

from cli.__main__ import app
from cli.context import NOT_WELL
from cli.verbs_motion import _GoalWatcher
from common import topics
from common.requests import MoveRequest
from tests.fakes.lab import Lab


def ask(lab: Lab, commander: str) -> int:
    """Ask for a move up; return its goal's number."""
    pose = lab.target(z_m=0.04)
    wish = MoveRequest.model_validate({"kind": "pose", "pose": pose, "commander": commander})
    reply = lab.ask(topics.MOVE, wish)
    assert reply.accepted
    return int(reply.value)


def test_a_move_that_is_taken_over_ends_with_the_reason(capsys: pytest.CaptureFixture[str]) -> None:
    """The program hears who took the arm; the person's move is waited for to its end."""
    lab = Lab()
    watcher = _GoalWatcher(lab.cell.client)
    of_program = ask(lab, "program")
    lab.cell.advance(0.3)
    of_person = ask(lab, "operator")
    with pytest.raises((typer.Exit, click.exceptions.Exit)) as caught:
        watcher.wait(of_program)
    assert getattr(caught.value, "exit_code", None) == NOT_WELL
    assert "the operator took the arm from the program" in capsys.readouterr().err

    watcher.wait(of_person)
    assert "done in" in capsys.readouterr().out
    assert lab.state.goal.id == of_person


def test_a_move_can_be_asked_for_by_a_program() -> None:
    """Each kind of move takes the option, and nobody else may be named."""
    for kind in ("to", "joints", "by"):
        result = CliRunner().invoke(app, ["move", kind, "0,0,0,0,0,0", "--as", "regulator"])
        assert result.exit_code == 2
        assert "operator" in result.output
