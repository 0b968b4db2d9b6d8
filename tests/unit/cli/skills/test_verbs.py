"""Skills on a whole cell in virtual time: results, refusals and stops."""

import json
from typing import Any

import numpy as np
import pytest

from cli.context import INTERRUPTED
from cli.skills import following, force_session, pressing
from cli.skills.contact_monitor import no_progress
from common.bus.configured_cell import ConfiguredCell
from common.config.load import load_cell
from forcemesh.errors import ArmStoppedError, NotReachedError
from forcemesh.requests import ForceStartRequest
from launch.virtual_cell import VirtualCell
from tests.fakes.bench import CELL, DEMO, HALF_RATES
from tests.fakes.verb_calls import call_verb

assert CELL.sim is not None
GAP_MM = 1e3 * CELL.sim.gap_m


class SkillCell:
    """A cell in virtual time, armed, with the client for the skills."""

    def __init__(self, **overrides) -> None:
        config = load_cell(DEMO, {"rates": HALF_RATES, **overrides})
        self.world = VirtualCell(config)
        self.client = ConfiguredCell(config, bus=self.world.client, commander="operator")
        self.client.wait_ready()
        self.client.tare()
        self.client.arm()
        self.world.advance(0.05)

    def p_tcp(self) -> np.ndarray:
        """Return the true position of the TCP."""
        return np.array(self.world.arm.T_base_tcp.translation)


def start_request(setpoint_N: float, **options: Any) -> ForceStartRequest:
    """Return a start request with a press force [N], by default of mode position."""
    return ForceStartRequest(**{"mode": "position", "setpoint_N": setpoint_N, **options})


@pytest.fixture
def cell() -> SkillCell:
    """The demo's cell."""
    return SkillCell()


def test_touch_finds_the_surface_and_retracts(cell: SkillCell) -> None:
    """The reported position is that of the plate, and the force stays within the approach's."""
    start = cell.p_tcp()
    found = pressing.touch(cell.client, force_N=5.0, search_m=None, retract_m=0.002)
    assert found.travel_mm == pytest.approx(GAP_MM, abs=0.3)
    assert found.tcp_mm == pytest.approx(1e3 * (start - [0, 0, found.travel_mm / 1e3]), abs=0.05)
    assert found.peak_N < CELL.force.touch_N + CELL.force.approach_budget_N
    assert 1e3 * (start - cell.p_tcp())[2] == pytest.approx(found.travel_mm - 2.0, abs=0.3)
    cell.world.advance(0.2)
    target = cell.client.target.reading().message
    assert target is not None
    assert target.mode is None
    pressing.touch(cell.client, force_N=5.0, search_m=None, retract_m=0.0)
    again = pressing.touch(cell.client, force_N=5.0, search_m=None, retract_m=0.0)
    assert 0.0 <= again.travel_mm < 0.05  # in contact already


def test_touch_ends_after_the_permitted_travel(cell: SkillCell) -> None:
    """The arm stays at the end of the search, force feedback ends, and no hold is needed."""
    start = cell.p_tcp()
    with pytest.raises(NotReachedError, match="no contact within 2 mm"):
        pressing.touch(cell.client, force_N=5.0, search_m=0.002, retract_m=0.0)
    cell.world.advance(0.2)
    assert 1e3 * (start - cell.p_tcp())[2] == pytest.approx(2.0, abs=0.5)
    assert cell.client.status().state == "ARMED"


def test_press_holds_a_force_and_align_then_aligns_the_face() -> None:
    """On a tilted plate 10 N are held within the deadband, then the tool rotates by the tilt."""
    tilted = SkillCell(**{"sim.tilt_deg": 4.0})
    held = pressing.press(
        tilted.client,
        start_request(10.0, law="adaptive", preset="gentle"),
        hold_s=0.5,
        within_s=20.0,
    )
    assert held.mean_N == pytest.approx(10.0, abs=0.5)
    assert held.ripple_N < 0.5
    flat = pressing.align(tilted.client, start_request(10.0, mode="both"), within_s=20.0)
    assert flat.turned_deg == pytest.approx(4.0, abs=1.0)
    assert flat.torque_Nm <= pressing.BAND_NM
    tilted.world.advance(0.5)
    assert tilted.client.status().state == "ARMED"


def test_follow_keeps_the_force_on_a_path(cell: SkillCell) -> None:
    """20 mm in 70 points, more than one request holds: in contact on the whole path."""
    path = [np.array([0.0, y, 0.1]) for y in np.linspace(0.0, 0.02, 70)]
    start = cell.p_tcp()
    parameters = following.PathParameters(0.02, from_here=True)
    done = following.follow(cell.client, path, parameters, start_request(8.0), within_s=20.0)
    assert 1e3 * (cell.p_tcp() - start)[:2] == pytest.approx([0.0, 20.0], abs=0.3)
    assert (done.length_mm, done.contacts_lost) == (pytest.approx(20.0), 0)
    assert done.mean_error_N < 0.5


def test_a_hold_by_another_client_ends_a_skill_with_its_reason(cell: SkillCell) -> None:
    """The skill's error is the arbiter's reason, and the skill requests nothing more."""

    def hold_arm(done, _total, _text) -> None:
        if done > 0.2 and cell.client.status().operational:
            cell.client.hold("the test requested it")

    with pytest.raises(ArmStoppedError, match="the test requested it"):
        pressing.press(
            cell.client, start_request(10.0), hold_s=1.0, within_s=20.0, progress=hold_arm
        )


def test_ctrl_c_holds_the_arm(cell: SkillCell, monkeypatch) -> None:
    """During an approach the verb ends with 130, and the arbiter is HOLDING."""

    def interrupted(done, _total, _text) -> None:
        if done > 0.2:
            raise KeyboardInterrupt

    done = call_verb(monkeypatch, cell.client, interrupted, "touch")
    assert (done.exit_code, done.stderr) == (INTERRUPTED, "interrupted: the arm holds\n")
    cell.world.advance(0.1)
    assert cell.client.status().state == "HOLDING"


def test_the_verbs_print_a_line_or_an_object(cell: SkillCell, monkeypatch, tmp_path) -> None:
    """A refusal is one sentence and its exit code."""
    touched = call_verb(monkeypatch, cell.client, no_progress, "touch", "--json", "--back", "1")
    assert touched.exit_code == 0
    assert json.loads(touched.stdout)["travel_mm"] == pytest.approx(GAP_MM, abs=0.3)
    pressed = call_verb(monkeypatch, cell.client, no_progress, "press", "8", "--seconds", "0.2")
    assert pressed.exit_code == 0
    assert "N, ripple" in pressed.stdout
    path = tmp_path / "path.csv"
    path.write_text("x_mm,y_mm,z_mm\n0,0,0\n0,1,0\n")
    for words, code, problem in (
        (("touch", "--within", "80"), 2, "--within 80: force.search_m allows 50 mm"),
        (("follow", "none.csv"), 2, "none.csv: cannot be read: No such file or directory"),
        (("follow", str(path), "--speed", "100"), 2, "force.speed_max_m_s allows 50 mm/s"),
        (("follow", str(path)), 2, "away from the tool: move there first"),
        (("press", "50"), 3, "refused (setpoint): set point above force.setpoint_max_N"),
        (("guide", "--playback", "none.csv"), 2, "none.csv: cannot be read: No such file"),
    ):
        done = call_verb(monkeypatch, cell.client, no_progress, *words)
        # The press left the tool loaded, which is printed first.
        loaded = force_session.LOADED.partition("{")[0]
        messages = [line for line in done.stderr.splitlines() if not line.startswith(loaded)]
        assert (done.exit_code, done.stdout, len(messages)) == (code, "", 1), words
        assert problem in messages[0]
