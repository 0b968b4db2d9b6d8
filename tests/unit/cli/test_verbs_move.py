"""A move from the command line ends when its goal does, whoever ended it."""

import pytest
from typer.testing import CliRunner

from cli.__main__ import app
from common.bus.configured_cell import ConfiguredCell
from forcemesh.client import ArmStoppedError, Move
from forcemesh.requests import MoveRequest
from tests.fakes.lab import Lab


def ask(cell: ConfiguredCell, lab: Lab, commander: str) -> Move:
    """Ask for a move up."""
    pose = lab.target(z_m=0.04)
    wish = MoveRequest.model_validate({"kind": "pose", "pose": pose, "commander": commander})
    return cell.move.begin(wish)


def test_a_move_that_is_taken_over_ends_with_the_reason() -> None:
    """The program hears who took the arm; the person's move is waited for to its end."""
    lab = Lab()
    cell = ConfiguredCell(lab.cell.cell, bus=lab.cell.client)
    of_program = ask(cell, lab, "program")
    lab.cell.advance(0.3)
    of_person = ask(cell, lab, "operator")
    with pytest.raises(ArmStoppedError, match="the operator took the arm from the program") as why:
        of_program.wait()
    assert why.value.code == "preempted"
    assert of_person.wait().goal.id == of_person.id == lab.state.goal.id


def test_a_move_can_be_asked_for_by_a_program() -> None:
    """Each kind of move takes the option, and nobody else may be named."""
    for kind in ("to", "joints", "by"):
        result = CliRunner().invoke(app, ["move", kind, "0,0,0,0,0,0", "--as", "regulator"])
        assert result.exit_code == 2
        assert "operator" in result.output
