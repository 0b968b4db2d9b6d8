"""A move from the command line ends with its goal, for every cause."""

import pytest

from common.bus.configured_cell import ConfiguredCell
from forcemesh.client import ArmStoppedError, Move
from forcemesh.requests import MoveRequest
from tests.fakes.lab import Lab


def ask(cell: ConfiguredCell, lab: Lab, commander: str) -> Move:
    """Request a move up."""
    pose = lab.target(z_m=0.04)
    request = MoveRequest.from_dict({"kind": "pose", "pose": pose, "commander": commander})
    return cell.move.begin(request)


def test_a_preempted_move_ends_with_the_reason() -> None:
    """The program's error names the new commander; the operator's move is waited for."""
    lab = Lab()
    cell = ConfiguredCell(lab.cell.cell, bus=lab.cell.client)
    program_move = ask(cell, lab, "program")
    lab.cell.advance(0.3)
    operator_move = ask(cell, lab, "operator")
    with pytest.raises(ArmStoppedError, match="the operator took the arm from the program") as why:
        program_move.wait()
    assert why.value.code == "preempted"
    assert operator_move.wait().goal.id == operator_move.id == lab.state.goal.id
