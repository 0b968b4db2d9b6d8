"""Playback, and the calibrated press of docs/demo.md, in real processes."""

import json
import subprocess

import pytest

from common.bus.cell_bus import open_bus
from common.config.load import dump_cell, load_cell
from forcemesh.topics import CLIENT
from tests.fakes.axes_checked import axes_are_checked
from tests.scenario.conftest import HALF, ROOT
from tests.scenario.test_calibrate_processes import SHORT, wait_for

PATIENCE_S = 90.0  # of the test, not of the cell: a loaded machine is slow to start processes
UP_MM, ASIDE_MM = 20.0, 10.0

pytestmark = [pytest.mark.realtime, pytest.mark.long, pytest.mark.timeout(150)]


@pytest.fixture
def run_verb(cell_file, start):
    """Return a function that runs a verb on a cell that is up, tared and armed: its output."""
    cell_file.write_text(dump_cell(load_cell(cell_file, HALF)))

    def run(*words: object) -> str:
        process: subprocess.Popen[str] = start("-m", "cli", *words, "--cell", cell_file)
        printed, progress = process.communicate(timeout=PATIENCE_S)
        assert process.returncode == 0, progress
        return printed

    wait_for(start("-m", "cli", "up", "--cell", cell_file), "is up")
    run("tare")
    run("arm")
    return run


def test_a_recorded_path_is_played_back(run_verb, cell_file):
    """Recorded without a push; the motion up and aside that is put into the file is replayed."""
    recording = cell_file.parent / "path.csv"
    with open_bus(load_cell(cell_file), CLIENT) as bus:
        axes_are_checked(bus)
    run_verb("guide", "--seconds", 1, "--record", recording)
    head, first = recording.read_text().splitlines()[:2]
    t_s, x_mm, y_mm, z_mm, *turn = (float(word) for word in first.split(","))
    rows = [[t_s, x_mm, y_mm, z_mm + UP_MM], [t_s, x_mm + ASIDE_MM, y_mm, z_mm + UP_MM]]
    lines = [head, first, *(",".join(str(each) for each in [*row, *turn]) for row in rows)]
    recording.write_text("\n".join(lines) + "\n")
    assert "3 poses of 3 recorded" in run_verb("guide", "--playback", recording, "--speed", 50)
    state = json.loads(run_verb("watch", "robot/state", "--count", 1, "--json"))
    reached_mm = [1e3 * each for each in state["position_m"]]
    assert reached_mm == pytest.approx([x_mm + ASIDE_MM, y_mm, z_mm + UP_MM], abs=0.3)


def test_from_nothing_to_a_calibrated_press_by_the_commands_of_the_page(cell_file, start):
    """Four commands in sequence, as on the page; fewer poses, at a higher speed."""
    cell_file.write_text(dump_cell(load_cell(cell_file, {"limits.speed_m_s": 1.0})))
    page = (ROOT / "docs" / "demo.md").read_text()
    _, after = page.split("From nothing to a calibrated press", 1)
    lines = [line.split("#")[0].split() for line in after.split("```")[1].strip().splitlines()]
    verbs = [words for program, *words in lines if program == ".venv/bin/forcemesh"]
    assert len(verbs) == len(lines) <= 8
    more = {"calibrate": ["--yes", "--use", "--out", cell_file.parent / "made.yaml", *SHORT]}
    (up, *others), outputs = verbs, []
    wait_for(start("-m", "cli", *up, "--cell", cell_file), "is up")
    for verb, *words in others:
        more_words = [*words, *more.get(verb, []), "--cell", cell_file]
        process = start("-m", "cli", verb, *more_words)
        printed, wrong = process.communicate(timeout=PATIENCE_S)
        assert process.returncode == 0, wrong
        outputs.append(printed)
    assert "is in use" in outputs[0]
    held_N = float(outputs[-1].removeprefix("mean force ").split(" N")[0])
    assert held_N == pytest.approx(15.0, abs=0.5)
