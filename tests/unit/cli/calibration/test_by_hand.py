"""`calibrate --manual` in a virtual cell: a scripted person jogs, types, removes poses, ends."""

import os

import numpy as np
import pytest

from cli.calibration.by_hand import HandOptions, PoseRecorder, calibrate, record_poses
from cli.calibration.finish import Job
from cli.calibration.output_files import OutputFiles
from cli.terminal import typed_line
from common.config.calibration import CalibrationSection
from common.config.load import load_cell
from forcemesh import topics
from forcemesh.clock import NS_PER_S
from forcemesh.requests import ArmRequest, MoveRequest
from identification.verification import VerificationBounds
from tests.fakes.bench import DEMO
from tests.fakes.calibration import CalibrationLab

INTERRUPT = "Ctrl-C"
TAKES_S = 1.2  # until a pose is read and reported


class Person:
    """Person who types the lines of a script; between two lines it may jog the arm."""

    def __init__(self, lab: CalibrationLab, verbs: list[object]) -> None:
        """Verbs: a line to type, joint angles [rad] to move to, seconds to wait."""
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
        assert self._verbs, "the script has ended, but the recorder has not"
        verb = self._verbs.pop(0)
        if isinstance(verb, np.ndarray):
            self._jog(verb)
            return None
        if verb == INTERRUPT:
            raise KeyboardInterrupt
        self._wait(verb if isinstance(verb, float) else TAKES_S)
        return None if isinstance(verb, float) else str(verb)

    def _jog(self, q: np.ndarray) -> None:
        goal = MoveRequest(kind="joints", joint_rad=tuple(q.tolist()), speed_m_s=0.9)
        reply = self.lab.bus.ask(topics.MOVE, goal)
        if not reply.accepted:  # the previous move has not quite ended: request again
            assert reply.code == "busy", reply.text
            self._verbs.insert(0, q)
        self._wait(0.1)

    def _wait(self, duration_s: float) -> None:
        self._not_before_ns = self.lab.world.clock.now_ns() + round(duration_s * NS_PER_S)


@pytest.fixture
def lab() -> CalibrationLab:
    """A cell that only the scripted person moves."""
    return CalibrationLab()


def joint_paths(lab: CalibrationLab, count: int) -> list[list[np.ndarray]]:
    """Return the joint goals of the paths to some attitudes, in sequence."""
    plan = lab.plan(poses=max(count, 6), verify_poses=0)
    paths, here = [], plan.route.hub
    for place in plan.fit[:count]:
        paths.append(plan.route.goals(here, plan.q[place]))
        here = plan.q[place]
    paths[0].insert(0, plan.route.hub)
    return paths


def recorder_of(
    lab: CalibrationLab, verbs: list[object], **options: int | float | bool
) -> PoseRecorder:
    """Return a pose recorder with a scripted person."""
    hand_options = HandOptions(**{"poses": 6, "verify_poses": 0, "dwell_s": 0.2, **options})  # type: ignore[arg-type]
    return PoseRecorder(
        lab.client, hand_options, typed_line=Person(lab, verbs).poll, output=lab.notes
    )


def test_poses_taken_by_hand_give_a_calibration(lab, tmp_path, capsys):
    """Enter at each pose, with advice for the next one; the result is written and used."""
    verbs: list[object] = [verb for path in joint_paths(lab, 7) for verb in (*path, "")]
    job = Job(lab.cell, OutputFiles(tmp_path / "demo.yaml"), VerificationBounds(), use=True)
    options = HandOptions(poses=6, verify_poses=1, dwell_s=0.3)

    assert calibrate(job, options, Person(lab, verbs).poll, lab.client) == 0
    (tmp_path / "cell.yaml").write_text(DEMO.read_text())
    cell = load_cell(tmp_path / "cell.yaml", {"calibration": "demo.yaml"})
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


def test_a_pose_can_be_removed_and_a_near_one_is_reported(lab):
    """A repeated attitude is reported, and u removes it; without poses u is refused.

    After q with two poses the reason is printed and the recording continues; without one it ends.
    """
    recorder = recorder_of(lab, ["", "", "q", "u", "u", "u", "q"])
    assert record_poses(recorder, lab.notes) == 1
    assert recorder.dwells == []
    assert lab.notes.lines[-1] == "no pose was recorded"
    text = "\n".join(lab.notes.lines)
    assert "do not determine a fit" in text
    assert "only 0 degrees from an earlier one" in text
    assert "removed: 0 poses remain" in text
    assert "there is no pose to remove" in text


def test_lines_are_read_without_waiting_and_the_end_of_input_is_q(monkeypatch):
    """Without input the poll returns at once; a closed terminal ends the recording."""
    read, write = os.pipe()
    with os.fdopen(read) as stdin, os.fdopen(write, "w") as typed:
        monkeypatch.setattr("sys.stdin", stdin)
        assert typed_line() is None
        typed.write("U\n")
        typed.flush()
        assert typed_line() == "u"
        typed.close()
        assert typed_line() == "q"
