"""No calibration is made from a sensor that is installed wrong, unless a person insists."""

import numpy as np
import pytest
from typer.testing import CliRunner

from cli.__main__ import app
from cli.calibration.finish import Job
from cli.calibration.installed import refuse_wrong_axes
from cli.calibration.output_files import OutputFiles
from identification.dwells import Dwell
from identification.errors import CalibrationError
from identification.installation.axis_fit import SIGNED
from identification.verification import VerificationBounds
from tests.fakes.bench import CELL
from tests.fakes.installations import PAYLOAD, TRUTH, readings, recorded


def dwells(wiring, payload=PAYLOAD) -> list[Dwell]:
    """Return what the arm has read at eight poses, ten readings each."""
    seen = readings(payload, force=wiring, torque=wiring, poses=8)
    return [
        Dwell(
            "fit",
            np.linspace(k, k + 0.5, 10),
            np.zeros((10, 3)),
            np.repeat(seen.R_base_sensor[k : k + 1], 10, axis=0),
            np.repeat(seen.force_N[k : k + 1], 10, axis=0),
            np.repeat(seen.torque_Nm[k : k + 1], 10, axis=0),
        )
        for k in range(8)
    ]


def job(tmp_path, *, force=False, cell=CELL) -> Job:
    """Return a calibration of the demo's cell."""
    return Job(cell, OutputFiles(tmp_path / "cal.yaml"), VerificationBounds(0.5, 0.05), force)


def test_all_47_wrong_wirings_end_a_calibration_before_its_fit(tmp_path) -> None:
    """The one right wiring goes on; each other one is refused with what to write."""
    refuse_wrong_axes(job(tmp_path), dwells(SIGNED[0], TRUTH))
    for wiring in SIGNED[1:]:
        with pytest.raises(CalibrationError, match="no calibration is made"):
            refuse_wrong_axes(job(tmp_path), dwells(wiring, TRUTH))


def test_who_insists_is_warned(tmp_path, capsys) -> None:
    """With --force the sentence is said, and it goes on."""
    refuse_wrong_axes(job(tmp_path, force=True), dwells(SIGNED[3], TRUTH))
    assert "warning: the sensor is turned by 180 degrees about x" in capsys.readouterr().err


def test_a_tool_of_unknown_mass_is_asked_for(tmp_path, capsys) -> None:
    """Only a person can tell then whether the readings are newtons."""
    unknown = CELL.payload.model_copy(update={"mass_kg": 0.0, "com_m": (0.0, 0.0, 0.0)})
    cell = CELL.model_copy(update={"payload": unknown})
    refuse_wrong_axes(job(tmp_path, cell=cell), dwells(SIGNED[0]))
    assert "the measured tool mass is 1 kg, the cell file has none" in capsys.readouterr().err
    refuse_wrong_axes(job(tmp_path), dwells(SIGNED[0], TRUTH))
    assert not capsys.readouterr().err


@pytest.mark.parametrize("number", [1, 7, 18])
def test_a_recording_of_a_wrong_sensor_is_not_calibrated_from(tmp_path, number) -> None:
    """By the command: exit code 1, the sentence, nothing written."""
    path, out = recorded(tmp_path / "a.csv", SIGNED[number]), tmp_path / "cal.yaml"
    words = ["calibrate", "--from", str(path), "--out", str(out), "--cell", "cells/demo.yaml"]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 1
    assert "no calibration is made" in result.stderr
    assert not out.exists()
