"""Measuring, playing back, and the calibrated press of docs/demo.md, in real processes."""

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
def say(cell_file, start):
    """A command line on a cell that is up, tared and armed: what it prints."""
    cell_file.write_text(dump_cell(load_cell(cell_file, HALF)))

    def run(*words: object) -> str:
        process: subprocess.Popen[str] = start("-m", "cli", *words, "--cell", cell_file)
        printed, said = process.communicate(timeout=PATIENCE_S)
        assert process.returncode == 0, said
        return printed

    wait_for(start("-m", "cli", "up", "--cell", cell_file), "is up")
    run("tare")
    run("arm")
    return run


def test_the_cell_measures_itself_sets_its_gains_and_writes_them_down(say, cell_file):
    """What was written is what the cell file then says; the gains are those recommended."""
    tuned = cell_file.parent / "tuned.yaml"
    found = json.loads(say("tune", "--no-controller", "--apply", "--write", tuned, "--json"))
    assert found["stiffness_N_m"] == pytest.approx(20_000.0, rel=0.05)
    cell_file.write_text(cell_file.read_text() + f"tuning: {tuned.name}\n")
    told = load_cell(cell_file)
    assert 0.0207 <= told.robot.delay_s + told.robot.lag_s < 0.0257
    assert found["delay_and_lag_s"] == pytest.approx(0.0207, abs=0.002)
    assert told.contact.stiffness_N_m == pytest.approx(20_000.0, rel=0.05)
    gains = json.loads(say("force", "gains", "--json"))
    assert gains == found["hosts"]["pc"]["gains"]


def test_a_way_that_was_recorded_is_gone_again(say, cell_file):
    """Recorded while nobody pushes; the way up and aside that is put into the file is then gone."""
    way = cell_file.parent / "way.csv"
    with open_bus(load_cell(cell_file), CLIENT) as bus:
        axes_are_checked(bus)
    say("guide", "--seconds", 1, "--record", way)
    head, first = way.read_text().splitlines()[:2]
    t_s, x_mm, y_mm, z_mm, *turn = (float(word) for word in first.split(","))
    rows = [[t_s, x_mm, y_mm, z_mm + UP_MM], [t_s, x_mm + ASIDE_MM, y_mm, z_mm + UP_MM]]
    lines = [head, first, *(",".join(str(each) for each in [*row, *turn]) for row in rows)]
    way.write_text("\n".join(lines) + "\n")
    assert "3 poses of 3 recorded" in say("guide", "--playback", way, "--speed", 50)
    state = json.loads(say("watch", "robot/state", "--count", 1, "--json"))
    reached_mm = [1e3 * each for each in state["position_m"]]
    assert reached_mm == pytest.approx([x_mm + ASIDE_MM, y_mm, z_mm + UP_MM], abs=0.3)


def test_from_nothing_to_a_calibrated_press_by_the_commands_of_the_page(cell_file, start):
    """Four commands, one after the other, as they stand there; poses are fewer and faster here."""
    cell_file.write_text(dump_cell(load_cell(cell_file, {"limits.speed_m_s": 1.0})))
    page = (ROOT / "docs" / "demo.md").read_text()
    _, after = page.split("From nothing to a calibrated press", 1)
    lines = [line.split("#")[0].split() for line in after.split("```")[1].strip().splitlines()]
    verbs = [words for program, *words in lines if program == ".venv/bin/forcemesh"]
    assert len(verbs) == len(lines) <= 8
    more = {"calibrate": ["--yes", "--use", "--out", cell_file.parent / "made.yaml", *SHORT]}
    (up, *others), said = verbs, []
    wait_for(start("-m", "cli", *up, "--cell", cell_file), "is up")
    for verb, *words in others:
        more_words = [*words, *more.get(verb, []), "--cell", cell_file]
        process = start("-m", "cli", verb, *more_words)
        printed, wrong = process.communicate(timeout=PATIENCE_S)
        assert process.returncode == 0, wrong
        said.append(printed)
    assert "is in use" in said[0]
    held_N = float(said[-1].removeprefix("mean force ").split(" N")[0])
    assert held_N == pytest.approx(15.0, abs=0.5)
