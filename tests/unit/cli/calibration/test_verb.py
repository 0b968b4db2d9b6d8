"""Verb `calibrate` on a virtual cell: files, sending, output and usage errors."""

import importlib
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from cli.calibration.verb import puts_into_use
from common.bus.configured_cell import ConfiguredCell
from common.config.calibration import CalibrationSection
from common.config.load import load_cell
from forcemesh.requests import Reply
from identification.installation.axis_fit import SIGNED
from identification.recording import read_recording
from tests.fakes import verb_calls
from tests.fakes.bench import DEMO, HALF_RATES
from tests.fakes.calibration import HOME_RAD, CalibrationLab
from tests.fakes.installations import recorded
from tests.fakes.weights import TRUTH, drawn, write_recording

FAST = ("--poses", "6", "--verify-poses", "1", "--speed", "900", "--dwell", "0.3")


CALIBRATION = "made/demo.yaml"


def cell_file(folder: Path, calibration: str | None = CALIBRATION) -> Path:
    """Write the demo's cell file, which names a calibration, into a folder."""
    tree = yaml.safe_load(DEMO.read_text())
    tree["limits"]["speed_m_s"] = 1.0
    tree["rates"] = HALF_RATES
    tree["calibration"] = calibration
    tree["tool"]["name"] = "disc"
    tree["contact"]["inertia_kg"] = 1.6  # above the mass of the tools of these tests
    path = folder / "cell.yaml"
    path.write_text(yaml.safe_dump(tree))
    return path


@pytest.fixture
def lab(request, tmp_path, monkeypatch) -> CalibrationLab:
    """A cell on a virtual clock that replaces the running one; its parameter: the calibration."""
    found = CalibrationLab(load_cell(cell_file(tmp_path, getattr(request, "param", CALIBRATION))))

    @contextmanager
    def connected(_cell: Any, *, patience_s: float) -> Iterator[ConfiguredCell]:
        yield found.client

    importlib.import_module("cli.calibration.finish")  # annotates with the class
    monkeypatch.setattr("common.bus.configured_cell.ConfiguredCell", connected)
    return found


run = partial(verb_calls.run, "calibrate")


def test_the_running_cell_and_its_next_start_use_the_calibration(lab, tmp_path, monkeypatch):
    """File, readings and report are in one folder; the previous file is kept; the cell uses it.

    The cell checks it at the last pose, without contact; only then the arm returns.
    """
    sent_at = []

    def send(calibration_json: str) -> Reply:
        sent_at.append(np.abs(lab.world.arm.q - HOME_RAD).max())
        return ConfiguredCell.calibrate(lab.client, calibration_json)

    monkeypatch.setattr(lab.client, "calibrate", send)
    made = tmp_path / "made"
    made.mkdir()
    (made / "demo.yaml").write_text("the previous file")
    result = run("--yes", "--cell", tmp_path / "cell.yaml", *FAST)

    assert result.exit_code == 0, result.stderr
    found = load_cell(tmp_path / "cell.yaml").calibration
    assert isinstance(found, CalibrationSection)
    assert found.method == "arm"
    assert found.tool == "disc"
    assert found.payload.mass_kg == pytest.approx(1.0, abs=0.005)
    assert found.verified is not None
    assert found.verified.force_max_N < 0.1
    assert (made / "demo.before.yaml").read_text() == "the previous file"
    assert len(read_recording(made / "demo.csv").line) > 450
    assert f"calibration {found.revision} written to {made / 'demo.yaml'}" in result.stdout
    assert f"calibration {found.revision} is in use" in result.stdout.splitlines()[-1]
    assert sent_at[0] > np.radians(5.0)
    assert lab.world.arm.q == pytest.approx(HOME_RAD, abs=1e-3)
    assert "PASS: at 1 fresh pose" in result.stdout
    assert "x -400 .. 400, y 200 .. 800, z -200 .. 600 mm" in result.stderr
    page = (made / "demo.html").read_text()
    assert found.revision in page

    again = run("--yes", "--verify-only", "--cell", tmp_path / "cell.yaml", *FAST)
    assert again.exit_code == 0, again.stderr
    assert f"calibration in use: {found.revision}" in again.stdout


def test_the_wizard_uses_its_result_and_other_methods_need_the_option() -> None:
    """--out, a recording, manual poses or --force alone do not put the result into use."""
    for out, use, force, moves_arm, uses in (
        (None, False, False, False, False),
        (None, True, False, False, True),
        (None, False, False, True, True),
        (Path("a.yaml"), False, False, True, False),
        (Path("a.yaml"), True, False, True, True),
        (None, False, True, True, False),
    ):
        assert puts_into_use(out=out, use=use, force=force, moves_arm=moves_arm) is uses


@pytest.mark.parametrize("lab", ["none"], indirect=True)  # the wrench is calibrated
def test_a_calibration_does_not_start_in_contact(lab, tmp_path):
    """The error gives the force and the remedy, and nothing has moved."""
    arm, q = lab.world.arm, lab.world.arm.q
    arm.data.xfrc_applied[arm.model.body("tool").id][2] = 25.0
    lab.world.advance(0.5)
    result = run("--yes", "--cell", tmp_path / "cell.yaml", *FAST)
    assert result.exit_code == 3
    assert "the tool is loaded: 25." in result.stderr
    assert "forcemesh arm --jog" in result.stderr
    assert result.stdout == ""
    assert lab.world.arm.q == pytest.approx(q, abs=2e-3)


def test_without_confirmation_nothing_moves(lab, tmp_path):
    """The answer no, and no answer, end in one sentence."""
    q = lab.world.arm.q
    for text in ("n\n", ""):
        result = run("--cell", tmp_path / "cell.yaml", *FAST, text=text)
        assert result.exit_code == 1
        assert "may the arm move?" in result.stderr
        assert lab.world.arm.q == pytest.approx(q, abs=1e-4)
    assert not (tmp_path / "made").exists()


# --- from a recording -----------------------------------------------------------------------------


@pytest.fixture
def quiet_cell(tmp_path) -> Path:
    """A cell file whose hub is not running."""
    path = cell_file(tmp_path)
    tree = yaml.safe_load(path.read_text())
    tree["bus"] = {"endpoint": "tcp/127.0.0.1:9"}
    path.write_text(yaml.safe_dump(tree))
    return path


def test_a_recording_alone_gives_an_unverified_calibration(tmp_path, quiet_cell):
    """The cell need not be up; without a second recording there is no verdict and no use."""
    recording = write_recording(tmp_path / "a.csv", drawn(1, poses=12))
    for words, code, sentence in (
        ((), 0, "the cell does not use it"),
        (("--use",), 1, "no fresh pose has verified it"),
    ):
        result = run("--from", recording, *words, "--cell", quiet_cell)
        assert result.exit_code == code, result.stderr
        assert "NOT VERIFIED" in result.stdout
        assert sentence in result.stdout.splitlines()[-1]
        assert load_cell(quiet_cell).calibration is None
    path = tmp_path / "made" / "demo.unused.yaml"
    found = CalibrationSection(**yaml.safe_load(path.read_text()))
    assert (found.method, found.verified) == ("recording", None)
    assert found.payload.mass_kg == pytest.approx(1.5, abs=0.02)


@pytest.mark.parametrize(("mass_kg", "code", "word"), [(1.5, 0, "PASS"), (1.7, 1, "FAIL")])
def test_another_recording_verifies_a_calibration(tmp_path, quiet_cell, mass_kg, code, word):
    """One with the same tool passes; one with 200 g more fails and nothing is written."""
    other = TRUTH.model_copy(update={"mass_kg": mass_kg})
    recording = write_recording(tmp_path / "a.csv", drawn(1, poses=12))
    fresh = write_recording(tmp_path / "b.csv", drawn(2, other, poses=12))
    words = ("--from", recording, "--verify-with", fresh, "--cell", quiet_cell)
    result = run("--use", *words)
    assert result.exit_code == code, result.stderr
    assert f"{word}: at 12 fresh poses" in result.stdout
    assert (load_cell(quiet_cell).calibration is not None) is (code == 0)
    if code:  # --force writes it nevertheless, but not where the cell loads it
        assert run("--force", *words).exit_code == code
        assert load_cell(quiet_cell).calibration is None
        assert (tmp_path / "made" / "demo.unused.yaml").exists()
    else:
        assert "the cell is not up: it takes the file" in result.stdout.splitlines()[-1]


def test_a_wrongly_installed_sensor_is_not_calibrated_unless_forced(tmp_path, quiet_cell):
    """Exit code 1 with the finding, and nothing is written; forced, the finding is a warning."""
    words = ("--from", recorded(tmp_path / "a.csv", SIGNED[3]), "--cell", quiet_cell)
    result = run(*words)
    assert result.exit_code == 1
    assert "no calibration is made" in result.stderr
    assert not (tmp_path / "made").exists()
    forced = run("--force", *words)
    assert "warning: the sensor is turned by 180 degrees about x" in forced.stderr
