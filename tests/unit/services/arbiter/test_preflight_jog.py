"""Arming for jog in a whole cell: moves are possible, force feedback is not."""

from common.runtime.service import HealthReporter, Runner
from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.requests import ArmRequest, Empty, ForceStartRequest, HoldRequest, MoveRequest
from services.wrench.service import WrenchService
from tests.fakes.bench import HALF_CELL
from tests.fakes.lab import BRAKE_S, Lab

FORCE = ForceStartRequest(mode="position", setpoint_N=10.0)


def restart_wrench(lab: Lab) -> None:
    """Replace the wrench service by a new process."""
    bus = Bus("wrench", HALF_CELL.cell, lab.cell.transport, HALF_CELL, lab.cell.clock)
    service = WrenchService(bus, HALF_CELL)
    lab.cell.runners["wrench"] = Runner(service, [HealthReporter(bus, HALF_CELL)], lab.cell.clock)


def test_after_a_lost_tare_in_contact_one_jogs_away_and_continues() -> None:
    """The wrench service restarts while the tool presses: its bias is unknown."""
    lab = Lab()
    lab.press()
    assert lab.ask(topics.HOLD, HoldRequest(reason="inspection")).accepted
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
