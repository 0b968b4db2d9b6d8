"""`calibrate --manual` in a virtual cell: a scripted person jogs, types, takes back, gives up."""

import os

import numpy as np
import pytest

from cli.calibration.by_hand import HandOptions, PoseRecorder, calibrate, record_poses
from cli.calibration.finish import Job
from cli.calibration.output_files import OutputFiles
from cli.calibration.screen import Keyboard
from cli.context import INTERRUPTED
from common.config.calibration import CalibrationSection
from common.config.load import load_cell
from common.motion.convert import joints
from forcemesh import topics
from forcemesh.clock import NS_PER_S
from forcemesh.requests import ArmRequest, MoveRequest
from identification.dwells import dwells_of_purpose
from identification.verification import VerificationBounds
from tests.fakes.bench import DEMO
from tests.fakes.calibration import CalibrationLab

INTERRUPT = "Ctrl-C"
TAKES_S = 1.2  # until a pose has been read, and told


class Person:
    """Types what a script says; between two lines it may jog the arm, as anybody can."""

    def __init__(self, lab: CalibrationLab, verbs: list[object]) -> None:
        """Verbs: a line to type, joint angles [rad] to go to, seconds to wait."""
        self.lab, self._verbs = lab, list(verbs)
        self._not_before_ns = 0
        lab.world.advance(0.5)
        assert lab.bus.ask(topics.ARM, ArmRequest(purpose="jog")).accepted
        self._robot = lab.bus.reader(topics.ROBOT_STATE)

    def poll(self) -> str | None:
        """Type the next line, once the arm has arrived."""
        now_ns = self.lab.world.clock.now_ns()
        state = self._robot.read(now_ns).message
        if state is None or state.status.moving or now_ns < self._not_before_ns:
            return None
        assert self._verbs, "the script has ended, and the watcher has not"
        verb = self._verbs.pop(0)
        if isinstance(verb, np.ndarray):
            self._jog(verb)
            return None
        if verb == INTERRUPT:
            raise KeyboardInterrupt
        self._wait(verb if isinstance(verb, float) else TAKES_S)
        return None if isinstance(verb, float) else str(verb)

    def _jog(self, q: np.ndarray) -> None:
        goal = MoveRequest(kind="joints", joint_rad=joints(q), speed_m_s=0.9)
        reply = self.lab.bus.ask(topics.MOVE, goal)
        if not reply.accepted:  # the move before has not quite ended: ask again
            assert reply.code == "busy", reply.text
            self._verbs.insert(0, q)
        self._wait(0.1)

    def _wait(self, duration_s: float) -> None:
        self._not_before_ns = self.lab.world.clock.now_ns() + round(duration_s * NS_PER_S)


@pytest.fixture
def lab() -> CalibrationLab:
    """A cell that nobody drives but the person."""
    return CalibrationLab()


def ways_of(lab: CalibrationLab, count: int) -> list[list[np.ndarray]]:
    """Return the joint goals that lead to each of some attitudes, one after the other."""
    plan = lab.plan(poses=max(count, 6), verify_poses=0)
    ways, here = [], plan.route.hub
    for place in plan.fit[:count]:
        ways.append(plan.route.goals(here, plan.q[place]))
        here = plan.q[place]
    ways[0].insert(0, plan.route.hub)
    return ways


def watched(lab: CalibrationLab, verbs: list[object], **wish: int | float | bool) -> PoseRecorder:
    """Return a watcher after the script has ended."""
    wanted = HandOptions(**{"poses": 6, "verify_poses": 0, "dwell_s": 0.2, **wish})  # type: ignore[arg-type]
    return PoseRecorder(lab.bus, lab.cell, wanted, keys=Person(lab, verbs), output=lab.notes)


def test_a_person_jogs_takes_poses_and_gets_a_calibration(lab, tmp_path, capsys):
    """Enter at each pose, with advice what to do next; then it is written and used."""
    verbs: list[object] = [verb for way in ways_of(lab, 7) for verb in (*way, "")]
    job = Job(lab.cell, OutputFiles(tmp_path / "demo.yaml"), VerificationBounds(), use=True)
    wish = HandOptions(poses=6, verify_poses=1, dwell_s=0.3)

    assert calibrate(job, wish, lab.bus, Person(lab, verbs)) == 0
    cell = load_cell(lab_file(tmp_path), {"calibration": "demo.yaml"})
    found = cell.calibration
    assert isinstance(found, CalibrationSection)
    assert found.method == "manual"
    assert found.payload.mass_kg == pytest.approx(1.0, abs=0.01)
    assert found.verified is not None
    assert (found.fit.poses, found.verified.poses) == (6, 1)
    assert (tmp_path / "demo.csv").exists()
    assert (tmp_path / "demo.html").exists()
    printed = capsys.readouterr()
    assert f"calibration {found.revision} is in use" in printed.out
    taken = [line for line in printed.err.splitlines() if line.startswith("pose ")]
    assert len(taken) == 7
    assert "tilt the tool by 60 degrees" in taken[0]
    assert "condition number" in taken[5]
    assert "gravity along (" in taken[5]


def lab_file(folder):
    """Write the demo's cell file into a folder."""
    path = folder / "cell.yaml"
    path.write_text(DEMO.read_text())
    return path


def test_a_pose_can_be_taken_back_and_a_near_one_is_told(lab):
    """Twice the same attitude: it says so, and u takes it back; more than there are cannot be."""
    watcher = watched(lab, ["", "", "u", "u", "u", INTERRUPT])
    assert record_poses(watcher, lab.notes) == INTERRUPTED
    assert watcher.dwells == []
    text = "\n".join(lab.notes.lines)
    assert "only 0 degrees from an earlier one" in text
    assert "removed: 0 poses remain" in text
    assert "there is no pose to remove" in text


def test_too_few_poses_do_not_end_it(lab):
    """After q with two poses it says what is missing and goes on watching."""
    way, *_ = ways_of(lab, 1)
    watcher = watched(lab, ["", *way, "", "q", INTERRUPT])
    assert record_poses(watcher, lab.notes) == INTERRUPTED
    assert len(watcher.dwells) == 2
    assert any("do not determine a fit" in line for line in lab.notes.lines)


@pytest.mark.long
def test_poses_are_taken_by_themselves_when_still_and_new(lab):
    """--auto-capture: one pose for each attitude, none on the way, none twice."""
    verbs: list[object] = [verb for way in ways_of(lab, 4) for verb in (*way, 2.5)]
    watcher = watched(lab, verbs, poses=4, auto=True)
    assert record_poses(watcher, lab.notes) is None
    assert len(dwells_of_purpose(watcher.dwells, "fit")) == 4
    assert any("| at rest" in stage for stage in lab.notes.stages)
    assert any("waiting for the arm to rest" in stage for stage in lab.notes.stages)
    for dwell in watcher.dwells:
        assert np.ptp(dwell.position_m, axis=0).max() < 1e-4


def test_nobody_who_takes_a_pose_is_told(lab):
    """After q at once there is nothing to calibrate from."""
    watcher = watched(lab, ["q"])
    assert record_poses(watcher, lab.notes) == 1
    assert lab.notes.lines[-1] == "no pose was recorded"


def test_a_sensor_fault_is_shown_and_outlived(lab):
    """While a person jogs, a silent sensor ends nothing: it is shown until it speaks again."""
    arm = lab.world.arm
    watcher = watched(lab, [0.1, "", 1.0, "q", INTERRUPT])
    arm.ft_sensor.disturb = lambda sample: None if 1.9 < arm.time_s < 2.2 else sample
    assert record_poses(watcher, lab.notes) == INTERRUPTED
    assert any("sensor/wrench stale" in stage for stage in lab.notes.stages)
    assert len(watcher.dwells) == 1


def test_lines_are_read_without_waiting_and_the_end_of_input_is_q(monkeypatch):
    """A person who types nothing keeps nobody waiting; a closed terminal ends it."""
    read, write = os.pipe()
    with os.fdopen(read) as stdin, os.fdopen(write, "w") as typed:
        monkeypatch.setattr("sys.stdin", stdin)
        keyboard = Keyboard()
        assert keyboard.poll() is None
        typed.write("U\n")
        typed.flush()
        assert keyboard.poll() == "u"
        typed.close()
        assert keyboard.poll() == "q"
