"""Handover between commanders in a whole cell, and a jog into the plate: rest, and no jump."""

from functools import partial
from typing import Any

import numpy as np
import pytest

from common.bus.configured_cell import ConfiguredCell
from common.config.load import load_cell
from forcemesh import topics
from forcemesh.errors import ArmStoppedError
from forcemesh.messages import Host
from forcemesh.requests import ForceStartRequest, MoveRequest, Reply
from tests.fakes.bench import DEMO
from tests.fakes.lab import BRAKE_S, PRESS_N, Lab

MOST_RAD_S2 = 15.0  # of commanded joints: twice that of a goal's start, far below a jump
LAST_SET_POINT_S = 0.03  # until set points in flight at the handover have arrived


def move(lab: Lab, commander: Any, z_m: float = 0.05) -> Reply:
    """Request a move up."""
    request = MoveRequest(kind="pose", pose=lab.target(z_m=z_m), commander=commander)
    reply: Reply = lab.ask(topics.MOVE, request)
    return reply


def accelerations_rad_s2(lab: Lab, duration_s: float) -> np.ndarray:
    """Return the acceleration of the commanded joints, per millisecond. Shape (n, 6)."""
    joints = [lab.q_command().copy()]
    for _ in range(round(duration_s * 1e3)):
        lab.cell.advance(0.001)
        joints.append(lab.q_command().copy())
    return np.diff(joints, n=2, axis=0) * 1e6


def hand_over(lab: Lab, commander: str) -> None:
    """Hand the arm over for a move; it must rest in between and start without a jump."""
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


@pytest.mark.parametrize(("motion", "commander"), [("press", "operator"), ("approach", "program")])
def test_a_move_takes_the_arm_from_force_feedback(motion: str, commander: str) -> None:
    """In contact or during the approach; afterwards force feedback can be started again."""
    lab = Lab()
    lab.press() if motion == "press" else lab.approach()
    hand_over(lab, commander)
    lab.finish_move(4.0)
    lab.assert_still(0.3)
    lab.approach()
    assert lab.status.commander == "regulator"


def client_of(lab: Lab) -> ConfiguredCell:
    """Return a client of the lab."""
    return ConfiguredCell(lab.cell.cell, commander="operator", bus=lab.cell.client)


def test_a_jog_into_the_plate_stops_at_its_force_rise_below_the_ceiling() -> None:
    """`jog z -80`: 20 N plus the rise at 50 mm/s until rest; arming and retract still work."""
    lab = Lab()
    client = client_of(lab)
    with pytest.raises(ArmStoppedError, match="force rose") as stopped:
        client.jog((0.0, 0.0, -0.08))
    assert stopped.value.code == "force"
    lab.cell.advance(BRAKE_S)
    assert 20.0 < lab.force_N < lab.cell.cell.limits.force_N
    lab.cell.advance(1.2)
    reply = client.arm("jog")
    assert "loaded with" in reply.text
    client.move.retract()
    assert abs(lab.force_N) < 2.0
    assert client.load_N() is None


def test_a_change_of_the_loop_host_is_a_handover_too() -> None:
    """From the PC to the controller: idle, rest, a new ownership; the arm presses again."""
    lab, ownership = Lab(load_cell(DEMO.with_name("demo-tcp.yaml"))), 0
    hosts: tuple[tuple[Host, str], ...] = (("pc", "setpoint"), ("controller", "feedback"))
    for host, kind in hosts:
        start = ForceStartRequest(mode="position", host=host, setpoint_N=PRESS_N)
        assert lab.ask(topics.FORCE_START, start).accepted
        lab.seconds_until(lambda: lab.now(lab.command).kind == "idle", 0.1)
        lab.seconds_until(partial(lambda kind: lab.now(lab.command).kind == kind, kind), 1.0)
        assert lab.status.ownership > ownership
        ownership = lab.status.ownership
        lab.cell.advance(2.5)
        assert lab.status.commander == "regulator"
        assert lab.force_N == pytest.approx(PRESS_N, abs=2.0)
