"""Armed for jog alone, in a whole cell: one can always move away, and nothing else."""

from pathlib import Path

import numpy as np
import pytest

from common import topics
from common.cell import Cell
from common.config import load_cell
from common.convert import pose_of, record_of
from common.endpoints import Bus
from common.requests import ArmRequest, Empty, ForceStartRequest, HoldRequest, MoveRequest
from common.service import Runner, reporter_of
from services.wrench.service import WrenchService
from tests.fakes.bench import CELL
from tests.fakes.lab import BRAKE_S, Lab

TCP = load_cell(Path(__file__).resolve().parents[2] / "cells" / "demo-tcp.yaml")
FORCE = ForceStartRequest(mode="position", setpoint_N=10.0)


def restart_wrench(lab: Lab) -> None:
    """Put a new process in the place of the wrench service."""
    bus = Bus("wrench", CELL.cell, lab.cell.transport, CELL, lab.cell.clock)
    service = WrenchService(bus, CELL)
    lab.cell.runners["wrench"] = Runner(service, [reporter_of(bus, CELL)], lab.cell.clock)


def test_after_a_tare_was_lost_in_contact_one_jogs_away_and_goes_on() -> None:
    """The wrench service restarts while the tool presses: nobody knows its bias any more."""
    lab = Lab()
    lab.press()
    assert lab.ask(topics.HOLD, HoldRequest(reason="look at that")).accepted
    lab.cell.advance(BRAKE_S)
    restart_wrench(lab)
    lab.cell.advance(2.3)
    assert any("arm for jog" in line for line in lab.status.not_ready)
    assert lab.ask(topics.ARM, ArmRequest()).code == "payload"

    assert lab.ask(topics.ARM, ArmRequest(purpose="jog")).accepted
    lab.cell.advance(0.1)
    assert (lab.status.state, lab.status.armed_for) == ("ARMED", "jog")
    reply = lab.ask(topics.FORCE_START, FORCE)
    assert (reply.accepted, reply.code) == (False, "not_armed")
    assert "jog" in reply.text
    up = MoveRequest(kind="pose", pose=lab.target(z_m=0.02))
    assert lab.ask(topics.MOVE, up).accepted
    lab.seconds_until(lambda: lab.state.goal.state == "done", 3.0)
    assert abs(lab.force_N) < 2.0

    assert lab.ask(topics.HOLD, HoldRequest(reason="now force")).accepted
    lab.cell.advance(1.2)
    assert lab.ask(topics.TARE, Empty()).accepted
    assert lab.ask(topics.ARM, ArmRequest()).accepted
    lab.cell.advance(0.1)
    assert lab.ask(topics.FORCE_START, FORCE).accepted


def test_an_arm_that_still_brakes_is_not_armed_until_it_rests() -> None:
    """Refused with how long it has rested and how long is needed; a moment later it is armed."""
    lab = Lab()
    lab.lift()
    assert lab.ask(topics.HOLD, HoldRequest(reason="wait")).accepted
    reply = lab.ask(topics.ARM, ArmRequest())
    assert (reply.code, reply.limit) == ("moving", pytest.approx(0.2))
    lab.cell.advance(BRAKE_S + 0.2)
    assert lab.ask(topics.ARM, ArmRequest()).accepted


def straight(lab: Lab, **shift_m: float) -> MoveRequest:
    """Return a move beside where the arm is, without a turn."""
    T = pose_of(lab.state)
    T.translation = T.translation + np.array([shift_m.get(axis, 0.0) for axis in "xyz"])
    return MoveRequest(kind="pose", pose=record_of(T))


@pytest.mark.parametrize("cell", [CELL, TCP], ids=["sim", "gateway"])
def test_above_the_ceiling_of_force_one_gets_away_and_nowhere_else(cell: Cell) -> None:
    """Driven into the plate: armed for jog alone, out alone, and then everything is as before."""
    lab = Lab(cell)
    ceiling_N = cell.limits.force_N
    assert lab.ask(topics.MOVE, straight(lab, z=-0.02)).accepted
    lab.seconds_until(lambda: lab.status.state == "HOLDING", 5.0)
    lab.cell.advance(1.5)
    stuck_N = lab.force_N
    assert stuck_N > ceiling_N
    refused = lab.ask(topics.ARM, ArmRequest())
    assert (refused.accepted, refused.code) == (False, "force")

    assert lab.ask(topics.ARM, ArmRequest(purpose="jog")).accepted
    lab.cell.advance(0.2)
    assert lab.status.state == "ARMED"
    by = MoveRequest(kind="by", joint_rad=(0.0, 0.0, 0.0, 0.0, 0.0, 0.01))
    for wrong in (straight(lab, z=-0.002), straight(lab, x=0.01), by):
        reply = lab.ask(topics.MOVE, wrong)
        assert (reply.accepted, reply.code) == (False, "force"), wrong
    assert lab.force_N == pytest.approx(stuck_N, abs=2.0)

    assert lab.ask(topics.MOVE, straight(lab, z=0.02)).accepted
    highest_N = 0.0
    for _ in range(3000):
        lab.cell.advance(0.001)
        highest_N = max(highest_N, lab.force_N)
    assert highest_N < 1.06 * stuck_N
    assert abs(lab.force_N) < 2.0
    assert lab.status.state == "ARMED"
    assert lab.ask(topics.MOVE, straight(lab, x=0.01)).accepted


def test_who_got_away_is_under_the_cells_ceilings_again() -> None:
    """Once it got away, the cell's own ceilings count again, under the same lease."""
    lab = Lab()
    assert lab.ask(topics.MOVE, straight(lab, z=-0.02)).accepted
    lab.seconds_until(lambda: lab.status.state == "HOLDING", 5.0)
    lab.cell.advance(1.5)
    assert lab.ask(topics.ARM, ArmRequest(purpose="jog")).accepted
    assert lab.ask(topics.MOVE, straight(lab, z=0.02)).accepted
    lab.seconds_until(lambda: abs(lab.force_N) < 2.0, 5.0)
    lab.cell.advance(3.0)
    assert lab.ask(topics.MOVE, straight(lab, z=-0.03)).accepted
    lab.seconds_until(lambda: lab.status.state == "HOLDING", 10.0)
    assert lab.status.trips[-1].code == "force"
    assert lab.status.trips[-1].limit == pytest.approx(CELL.limits.force_N)
