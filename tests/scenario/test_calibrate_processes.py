"""The wizard on a cell in real processes: interrupted once, then to the end."""

import signal
import subprocess
from pathlib import Path

import pytest

from common.config.calibration import CalibrationSection
from common.config.load import dump_cell, load_cell

PATIENCE_S = 90.0  # of the test, not of the cell: a loaded machine is slow to start processes
SHORT = ("--poses", 6, "--verify-poses", 1, "--speed", 800, "--dwell", 0.2)

pytestmark = [pytest.mark.realtime, pytest.mark.long, pytest.mark.timeout(150)]


def wait_for(process: subprocess.Popen[str], text: str) -> None:
    """Read the standard error of a process until a text is in it."""
    stream, progress = process.stderr, ""
    assert stream is not None
    while text not in progress:
        line = stream.readline()
        assert line, f"it ended without {text!r}: {progress}"
        progress += line


def test_the_wizard_holds_when_interrupted_and_calibrates_when_not(cell_file, start):
    """Ctrl-C in motion: exit code 130 and a hold. Again: the running cell uses the result."""
    cell_file.write_text(dump_cell(load_cell(cell_file, {"limits.speed_m_s": 1.0})))
    wait_for(start("-m", "cli", "up", "--cell", cell_file), "is up")
    out: Path = cell_file.parent / "made.yaml"
    words = ("-m", "cli", "calibrate", "--yes", "--cell", cell_file, "--out", out, "--use", *SHORT)

    interrupted = start(*words)
    wait_for(interrupted, "armed")
    interrupted.send_signal(signal.SIGINT)
    _, progress = interrupted.communicate(timeout=PATIENCE_S)
    assert interrupted.returncode == 130, progress
    assert "HOLDING: the calibration was interrupted" in progress
    assert not out.exists()

    again = start(*words)
    _, progress = again.communicate(timeout=PATIENCE_S)
    assert again.returncode == 3
    assert "the arbiter is HOLDING: the calibration was interrupted" in progress

    assert start("-m", "cli", "clear", "--cell", cell_file).wait(PATIENCE_S) == 0
    whole = start(*words)
    printed, progress = whole.communicate(timeout=PATIENCE_S)
    assert whole.returncode == 0, progress
    assert "PASS: at 1 fresh pose" in printed
    found = load_cell(cell_file, {"calibration": str(out)}).calibration
    assert isinstance(found, CalibrationSection)
    assert found.payload.mass_kg == pytest.approx(1.0, abs=0.01)
    assert f"calibration {found.revision} is in use" in printed
    assert out.with_suffix(".html").exists()
    assert out.with_suffix(".csv").exists()
