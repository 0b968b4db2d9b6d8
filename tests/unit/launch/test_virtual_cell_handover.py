"""The arm passes from owner to owner in a whole cell: it rests in between, and never jumps."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from common.config.load import load_cell
from forcemesh import topics
from forcemesh.requests import ForceStartRequest, MoveRequest, Reply
from tests.fakes.lab import PRESS_N, Lab

TCP = load_cell(Path(__file__).resolve().parents[3] / "cells" / "demo-tcp.yaml")
MOST_RAD_S2 = 15.0  # of commanded joints: twice what a goal's own start takes, far from any jump
LAST_SET_POINT_S = 0.03  # until what was under way when the arm was taken is through the line


def move(lab: Lab, commander: Any, z_m: float = 0.05) -> Reply:
    """Ask for a move up."""
    wish = MoveRequest(kind="pose", pose=lab.target(z_m=z_m), commander=commander)
    reply: Reply = lab.ask(topics.MOVE, wish)
    return reply


def press(lab: Lab, host: Any) -> None:
    """Press on the plate under force feedback."""
    wish = ForceStartRequest(mode="position", host=host, setpoint_N=PRESS_N)
    assert lab.ask(topics.FORCE_START, wish).accepted
    lab.cell.advance(2.5)
    assert lab.status.commander == "regulator"
    assert lab.force_N == pytest.approx(PRESS_N, abs=2.0)


def accelerations_rad_s2(lab: Lab, duration_s: float) -> np.ndarray:
    """Return how the commanded joints change their speed, per millisecond. Shape (n, 6)."""
    joints = [lab.q_command().copy()]
    for _ in range(round(duration_s * 1e3)):
        lab.cell.advance(0.001)
        joints.append(lab.q_command().copy())
    return np.diff(joints, n=2, axis=0) * 1e6


def take(lab: Lab, commander: str) -> None:
    """Let somebody take the arm for a move; it must rest in between and go without a jump."""
    before = lab.status
    assert move(lab, commander).accepted
    assert (lab.status.state, lab.status.next_commander) == ("SETTLING", commander)
    lab.cell.advance(LAST_SET_POINT_S)
    assert np.abs(accelerations_rad_s2(lab, 0.04)).max() <= MOST_RAD_S2
    lab.seconds_until(lambda: lab.status.state == "ACTIVE", 1.0)
    assert not lab.cell.arm.moving
    assert np.abs(accelerations_rad_s2(lab, 0.6)).max() <= MOST_RAD_S2
    after = lab.status
    assert (after.state, after.commander) == ("ACTIVE", commander)
    assert after.lease == before.lease
    assert after.ownership > before.ownership
    assert [trip.code for trip in after.trips] == ["preempted"]


def finish(lab: Lab) -> None:
    """Wait until the move is done."""
    lab.seconds_until(lambda: lab.status.state == "ARMED", 4.0)
    assert lab.state.goal.state == "done"


@pytest.mark.parametrize(("motion", "commander"), [("press", "operator"), ("approach", "program")])
def test_a_move_takes_the_arm_from_force_feedback(motion: str, commander: str) -> None:
    """Out of contact or on the way to it; afterwards force feedback can be started anew."""
    lab = Lab()
    lab.press() if motion == "press" else lab.approach()
    take(lab, commander)
    finish(lab)
    lab.assert_still(0.3)
    lab.approach()
    assert lab.status.commander == "regulator"


def test_a_person_takes_the_arm_from_a_program_which_then_hears_busy() -> None:
    """Program, operator, program: the third has to wait, and gets the arm when it is free."""
    lab = Lab()
    assert move(lab, "program", z_m=0.1).accepted
    lab.cell.advance(0.5)
    take(lab, "operator")
    refused = move(lab, "program")
    assert (refused.accepted, refused.code) == (False, "busy")
    assert "operator" in refused.text
    finish(lab)
    assert move(lab, "program").accepted
    lab.seconds_until(lambda: lab.status.commander == "program", 0.5)


@pytest.mark.parametrize("host", ["pc", "controller"])
@pytest.mark.long
def test_a_person_takes_the_arm_from_force_feedback_over_tcp(host: str) -> None:
    """Through the gateway and the controller's own program, wherever the regulator runs."""
    lab = Lab(TCP)
    press(lab, host)
    take(lab, "operator")
    finish(lab)
    assert lab.status.state == "ARMED"


def test_a_person_takes_the_arm_from_a_program_over_tcp() -> None:
    """The controller brakes the first move, and the second one begins at rest."""
    lab = Lab(TCP)
    assert move(lab, "program", z_m=0.1).accepted
    lab.cell.advance(0.5)
    take(lab, "operator")
    finish(lab)


def test_a_host_that_changes_is_a_hand_over_too() -> None:
    """From the PC to the controller: idle, rest, a new turn; the arm goes on pressing."""
    lab = Lab(TCP)
    press(lab, "pc")
    turn = lab.status.ownership
    wish = ForceStartRequest(mode="position", host="controller", setpoint_N=PRESS_N)
    assert lab.ask(topics.FORCE_START, wish).accepted
    lab.seconds_until(lambda: lab.now(lab.command).kind == "idle", 0.1)
    lab.seconds_until(lambda: lab.now(lab.command).kind == "feedback", 1.0)
    assert lab.status.ownership > turn
    lab.cell.advance(1.0)
    assert lab.status.commander == "regulator"
    assert lab.force_N == pytest.approx(PRESS_N, abs=2.0)


def test_force_feedback_is_refused_as_busy_while_a_program_moves_the_arm() -> None:
    """As while a person does: else it is accepted, and then nothing comes of it."""
    lab = Lab()
    assert move(lab, "program", z_m=0.1).accepted
    lab.cell.advance(0.5)
    wish = ForceStartRequest(mode="position", setpoint_N=PRESS_N)
    assert lab.ask(topics.FORCE_START, wish).code == "busy"
