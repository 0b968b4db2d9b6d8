"""The calibrated press of docs/demo.md, in real processes."""

import pytest

from common.config.load import dump_cell, load_cell
from tests.scenario.conftest import ROOT, wait_for

PATIENCE_S = 90.0  # of the test, not of the cell: a loaded machine is slow to start processes
SHORT = ("--poses", 6, "--verify-poses", 1, "--speed", 800, "--dwell", 0.2)

pytestmark = [pytest.mark.realtime, pytest.mark.long, pytest.mark.timeout(150)]


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
