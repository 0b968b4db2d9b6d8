"""Force above the ceiling in a whole cell on a virtual clock: refusals, and backing off."""

from contextlib import nullcontext

import numpy as np
import pytest

from cli import verbs_arm
from common.bus.configured_cell import ConfiguredCell
from common.config.load import load_cell
from forcemesh.errors import ArmStoppedError, RefusedError
from tests.contract.rig import DEMO_CELL
from tests.fakes.lab import BRAKE_S, Lab

WIDE = load_cell(DEMO_CELL, {"limits.move_rise_N": 1000.0})


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


def test_an_arm_above_its_ceiling_is_freed_by_backing_off() -> None:
    """Without that limit the jog ends above the ceiling: arming is refused, backing off works."""
    lab = Lab(WIDE)
    client = client_of(lab)
    with pytest.raises(ArmStoppedError):
        client.jog((0.0, 0.0, -0.08))
    lab.cell.advance(1.5)
    ceiling_N = lab.cell.cell.limits.force_N
    begun_N, begun_m = lab.force_N, lab.p_m()
    assert begun_N > ceiling_N
    for purpose in ("all", "jog"):
        with pytest.raises(RefusedError, match="forcemesh back-off"):
            client.arm(purpose, within_s=0.0)
    end = client.back_off()
    assert end.code == "back_off", end
    lab.cell.advance(BRAKE_S)
    assert lab.status.state == "HOLDING"
    assert lab.force_N < 0.5 * ceiling_N
    assert np.linalg.norm(lab.p_m() - begun_m) < 0.02
    lab.cell.advance(1.2)
    assert client.arm("jog").accepted
    client.move.retract()
    assert abs(lab.force_N) < 2.0


def test_the_verb_names_a_next_step_that_is_accepted(monkeypatch, capsys) -> None:
    """Freed and still in contact: arming for all is refused, arming for jog is accepted."""
    lab = Lab(WIDE)
    client = client_of(lab)
    with pytest.raises(ArmStoppedError):
        client.jog((0.0, 0.0, -0.08))
    lab.cell.advance(1.5)
    monkeypatch.setattr(verbs_arm, "cell_of", lambda _cell: nullcontext(client))
    verbs_arm.back_off(yes=True)
    assert "arm for jog, then `forcemesh retract`" in capsys.readouterr().out
    lab.cell.advance(1.2)
    with pytest.raises(RefusedError, match="forcemesh retract`; else") as refused:
        client.arm(within_s=0.0)
    assert refused.value.code == "payload"
    assert lab.status.clears.startswith("if in contact, arm for jog")
