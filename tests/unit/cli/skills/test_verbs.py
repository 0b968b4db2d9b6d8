"""The skills on a whole cell in virtual time: they do what they say, and stop as they should."""

import json

import numpy as np
import pytest

from cli.skills import following, guiding, pressing
from cli.skills import force_session as at_work
from cli.skills.contact_monitor import no_progress
from cli.skills.path_file import read_poses
from cli.skills.pressing import ForceSettings
from common.bus.configured_cell import ConfiguredCell
from common.config.load import load_cell
from common.motion.convert import pose_of
from forcemesh.errors import ArmStoppedError, DataError, NotReachedError
from launch.virtual_cell import VirtualCell
from tests.fakes.axes_checked import axes_are_checked
from tests.fakes.bench import CELL, DEMO, HALF_RATES
from tests.fakes.verbs import said

assert CELL.sim is not None
GAP_MM = 1e3 * CELL.sim.gap_m


class Skilled:
    """A cell in virtual time, armed, and the client that the skills are given."""

    def __init__(self, **overrides) -> None:
        config = load_cell(DEMO, {"rates": HALF_RATES, **overrides})
        self.world = VirtualCell(config)
        self.client = ConfiguredCell(config, bus=self.world.client, commander="operator")
        self.client.wait_ready()
        self.client.tare()
        self.client.arm()
        self.world.advance(0.05)

    def p_tcp(self) -> np.ndarray:
        """True place of the TCP."""
        return np.array(self.world.arm.T_base_tcp.translation)


@pytest.fixture
def cell() -> Skilled:
    """The demo's cell."""
    return Skilled()


def test_touch_finds_the_surface_and_goes_back(cell: Skilled) -> None:
    """Where it says it touched is where the plate is; no harder than the approach may."""
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


def test_touch_tells_the_most_that_it_pressed_with(cell: Skilled) -> None:
    """Also what came after the touch, while the arm stopped; a second one goes no way at all."""
    found = pressing.touch(cell.client, force_N=5.0, search_m=None, retract_m=0.0)
    for _ in range(100):
        cell.world.advance(0.002)
        assert cell.client.force.pressed_N() < found.peak_N + 0.3  # noise of the sensor
    again = pressing.touch(cell.client, force_N=5.0, search_m=None, retract_m=0.0)
    assert 0.0 <= again.travel_mm < 0.05


def test_touch_gives_up_after_the_way_that_was_allowed(cell: Skilled) -> None:
    """The arm stays where it gave up, and force feedback is over; nothing was held."""
    start = cell.p_tcp()
    with pytest.raises(NotReachedError, match="no contact within 2 mm"):
        pressing.touch(cell.client, force_N=5.0, search_m=0.002, retract_m=0.0)
    cell.world.advance(0.2)
    assert 1e3 * (start - cell.p_tcp())[2] == pytest.approx(2.0, abs=0.5)
    assert cell.client.status().state == "ARMED"


def test_press_holds_a_force_and_align_then_lays_the_face_flat() -> None:
    """On a tilted plate: 10 N held within the deadband, then turned by the tilt."""
    tilted = Skilled(**{"sim.tilt_deg": 4.0})
    held = pressing.press(
        tilted.client,
        force_N=10.0,
        hold_s=0.5,
        within_s=20.0,
        settings=ForceSettings("adaptive", "gentle"),
    )
    assert held.mean_N == pytest.approx(10.0, abs=0.5)
    assert held.ripple_N < 0.5
    flat = pressing.align(tilted.client, force_N=10.0, within_s=20.0, settings=ForceSettings())
    assert flat.turned_deg == pytest.approx(4.0, abs=1.0)
    assert flat.torque_Nm <= pressing.BAND_NM
    tilted.world.advance(0.5)
    assert tilted.client.status().state == "ARMED"


def test_a_small_force_is_not_held_where_there_is_nothing(cell: Skilled) -> None:
    """Within a newton of nothing is no press: neither for the skill nor for the client."""
    with pytest.raises(NotReachedError):
        pressing.press(cell.client, force_N=0.9, hold_s=0.1, within_s=0.3, settings=ForceSettings())
    with pytest.raises(NotReachedError, match=r"0\.9 N were not reached"):
        cell.client.force.press(0.9, within_s=0.3)


def test_a_force_that_somebody_else_changed_was_not_held(cell: Skilled) -> None:
    """Another terminal asks for 5 N while this one holds 10: it says what it found at the end."""

    def tell(_felt_s, _total, text) -> None:
        if text.startswith("holding"):
            cell.client.force.set(5.0)

    with pytest.raises(
        NotReachedError, match=r"10 N were reached, but [45]\.\d N are measured after 3 s"
    ):
        pressing.press(
            cell.client,
            force_N=10.0,
            hold_s=3.0,
            within_s=20.0,
            settings=ForceSettings("adaptive"),
            progress=tell,
        )


def test_follow_keeps_the_force_along_a_path(cell: Skilled) -> None:
    """Twenty millimetres in 70 points, more than one request's: there, and pressed all the way."""
    path = [np.array([0.0, y, 0.1]) for y in np.linspace(0.0, 0.02, 70)]
    start = cell.p_tcp()
    way = following.PathParameters(8.0, 0.02, from_here=True)
    done = following.follow(cell.client, path, way, settings=ForceSettings(), within_s=20.0)
    moved = cell.p_tcp() - start
    assert 1e3 * moved[:2] == pytest.approx([0.0, 20.0], abs=0.3)
    assert done.length_mm == pytest.approx(20.0)
    assert done.took_s == pytest.approx(1.0, abs=0.6)
    assert done.contacts_lost == 0
    assert done.mean_error_N < 0.5
    for wrong, says in (
        ([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0]], "point 2 of the path: TCP x = .* outside"),
        ([[0.0, 0.0, 0.0], [0.0, 0.0, 0.5]], "has no length across"),
    ):
        points = [np.array(point) for point in wrong]
        with pytest.raises(DataError, match=says):
            following.follow(cell.client, points, way, settings=ForceSettings(), within_s=5.0)
    far = [cell.p_tcp() + np.array([1.0, 0.0, 0.0])]
    with pytest.raises(DataError, match="starts 1000 mm away from the tool"):
        following.follow(
            cell.client,
            far,
            following.PathParameters(8.0, 0.02),
            settings=ForceSettings(),
            within_s=5.0,
        )


def test_a_hand_leads_the_arm_and_its_way_is_gone_again(cell: Skilled, tmp_path) -> None:
    """Pulled through a soft grip, written down, moved back, played: the end is where it was."""
    client, arm = cell.client, cell.world.arm
    axes_are_checked(cell.world.client)
    client.jog(shift_m=(0.0, 0.0, -0.02), axes="tool")
    start, tool = cell.p_tcp(), arm.model.body("tool").id
    began_s = arm.data.time

    def pull(felt_s, _total, _text) -> None:
        goal = start + np.array([0.0, 0.03 * min(arm.data.time - began_s, 1.0), 0.0])
        arm.data.xfrc_applied[tool][:3] = 500.0 * (goal - cell.p_tcp())

    seen = guiding.GuidedPath()
    guiding.guide(
        client, seen, mode="position", seconds=1.6, is_finished=lambda: False, progress=pull
    )
    arm.data.xfrc_applied[tool][:3] = 0.0
    led = cell.p_tcp() - start
    assert 1e3 * led == pytest.approx([0.0, 30.0, 0.0], abs=8.0)
    assert seen.peak_N < 8.0
    cell.world.advance(0.5)
    assert np.linalg.norm(cell.p_tcp() - start - led) < 2e-3  # nobody pushes: it stays
    end = pose_of(client.state()).translation
    seen.save(tmp_path / "way.csv")
    client.jog(shift_m=(0.0, 0.01, 0.0))
    poses = read_poses(tmp_path / "way.csv")
    gone = guiding.play_back(client, poses, tolerance_m=0.001, speed_m_s=0.1)
    assert len(poses) == len(seen.poses)
    assert gone < 10
    assert pose_of(client.state()).translation == pytest.approx(end, abs=3e-3)


def test_a_hold_by_somebody_else_ends_a_skill_with_its_reason(cell: Skilled) -> None:
    """The skill says why, in the arbiter's words, and asks for nothing more."""

    def tell(done, _total, _text) -> None:
        if done > 0.2 and cell.client.status().goes_on:
            cell.client.hold("somebody wanted it")

    with pytest.raises(ArmStoppedError, match="somebody wanted it"):
        pressing.press(
            cell.client,
            force_N=10.0,
            hold_s=1.0,
            within_s=20.0,
            settings=ForceSettings(),
            progress=tell,
        )


def test_a_frozen_service_is_named_by_whoever_presses(cell: Skilled) -> None:
    """Why the arm was stopped, instead of the doubt whether there is a cell at all."""

    def freeze(*_progress: object) -> None:
        cell.world.runners.pop("wrench", None)

    with pytest.raises(ArmStoppedError, match=r"the arm was stopped.*wrench"):
        pressing.press(
            cell.client,
            force_N=8.0,
            hold_s=2.0,
            within_s=5.0,
            settings=ForceSettings(),
            progress=freeze,
        )


def test_ctrl_c_holds_the_arm(cell: Skilled, monkeypatch) -> None:
    """In the middle of an approach: the verb ends with 130 and the arbiter is HOLDING."""

    def interrupted(done, _total, _text) -> None:
        if done > 0.2:
            raise KeyboardInterrupt

    done = said(monkeypatch, cell.client, interrupted, "touch")
    assert (done.exit_code, done.stderr) == (at_work.INTERRUPTED, "interrupted: the arm holds\n")
    cell.world.advance(0.1)
    assert cell.client.status().state == "HOLDING"


def test_the_verbs_print_a_line_or_an_object(cell: Skilled, monkeypatch, tmp_path) -> None:
    """Both as they are typed; what is refused is one sentence and its exit code."""
    touched = said(monkeypatch, cell.client, no_progress, "touch", "--json", "--back", "1")
    assert touched.exit_code == 0
    assert json.loads(touched.stdout)["travel_mm"] == pytest.approx(GAP_MM, abs=0.3)
    pressed = said(monkeypatch, cell.client, no_progress, "press", "8", "--seconds", "0.2")
    assert pressed.exit_code == 0
    assert "N, ripple" in pressed.stdout
    path = tmp_path / "way.csv"
    path.write_text("x_mm,y_mm,z_mm\n0,0,0\n0,1,0\n")
    for words, code, says in (
        (("touch", "--within", "80"), 2, "--within 80: force.search_m allows 50 mm"),
        (("follow", "none.csv"), 2, "none.csv: cannot be read: No such file or directory"),
        (("follow", str(path), "--speed", "100"), 2, "force.speed_max_m_s allows 50 mm/s"),
        (("follow", str(path)), 2, "away from the tool: move there first"),
        (("press", "50"), 3, "refused (setpoint): set point above force.setpoint_max_N"),
        (("guide", "--record", "a", "--playback", "b"), 2, "cannot be combined"),
        (("guide", "--playback", "none.csv"), 2, "none.csv: cannot be read: No such file"),
        (("guide", "--speed", "5"), 2, "--speed requires --playback"),
    ):
        done = said(monkeypatch, cell.client, no_progress, *words)
        loaded = at_work.LOADED.partition("{")[0]  # the press left it so, and that is said first
        told = [line for line in done.stderr.splitlines() if not line.startswith(loaded)]
        assert (done.exit_code, done.stdout, len(told)) == (code, "", 1), words
        assert says in told[0]


def test_a_verb_says_that_it_takes_over_what_runs(cell: Skilled, monkeypatch) -> None:
    """Whoever started it finds it ended when the verb is done."""
    words = ("press", "6", "--seconds", "0.1")
    alone = said(monkeypatch, cell.client, no_progress, *words)
    assert (alone.exit_code, alone.stderr) == (0, "")
    cell.client.force.start(5.0)
    cell.world.advance(0.2)
    assert (
        said(monkeypatch, cell.client, no_progress, *words).stderr.strip()
        == at_work.ALREADY_RUNNING
    )


def test_ctrl_c_between_two_things_holds_the_arm_too(cell: Skilled, monkeypatch) -> None:
    """Interrupted before anything has been asked for: what the verb says is what is so."""

    def interrupted(_path) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("cli.skills.path_file.read_points", interrupted)
    done = said(monkeypatch, cell.client, no_progress, "follow", "way.csv")
    assert (done.exit_code, done.stderr) == (at_work.INTERRUPTED, "interrupted: the arm holds\n")
    cell.world.advance(0.1)
    assert cell.client.status().state == "HOLDING"
