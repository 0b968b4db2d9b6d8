"""Refusal of a calibration with a wrongly installed sensor, unless it is forced."""

import numpy as np
import pytest
from typer.testing import CliRunner

from cli.__main__ import app
from cli.calibration.finish import Job, refuse_wrong_axes
from cli.calibration.output_files import OutputFiles
from identification.dwells import Dwell
from identification.errors import CalibrationError
from identification.installation.axis_fit import SIGNED
from identification.verification import VerificationBounds
from tests.fakes.bench import CELL
from tests.fakes.installations import PAYLOAD, TRUTH, readings, recorded


def dwells(wiring, payload=PAYLOAD) -> list[Dwell]:
    """Return ten readings at each of eight poses."""
    measured = readings(payload, force=wiring, torque=wiring, poses=8)
    return [
        Dwell(
            "fit",
            np.linspace(k, k + 0.5, 10),
            np.zeros((10, 3)),
            np.repeat(measured.R_base_sensor[k : k + 1], 10, axis=0),
            np.repeat(measured.force_N[k : k + 1], 10, axis=0),
            np.repeat(measured.torque_Nm[k : k + 1], 10, axis=0),
        )
        for k in range(8)
    ]


def job(tmp_path, *, force=False, cell=CELL) -> Job:
    """Return a calibration of the demo's cell."""
    return Job(cell, OutputFiles(tmp_path / "cal.yaml"), VerificationBounds(0.5, 0.05), force)


def test_all_47_wrong_wirings_end_a_calibration_before_its_fit(tmp_path) -> None:
    """Only the correct wiring is accepted; each other one is refused."""
    refuse_wrong_axes(job(tmp_path), dwells(SIGNED[0], TRUTH))
    for wiring in SIGNED[1:]:
        with pytest.raises(CalibrationError, match="no calibration is made"):
            refuse_wrong_axes(job(tmp_path), dwells(wiring, TRUTH))


def test_a_forced_calibration_gives_a_warning(tmp_path, capsys) -> None:
    """With --force the finding is printed, and the calibration continues."""
    refuse_wrong_axes(job(tmp_path, force=True), dwells(SIGNED[3], TRUTH))
    assert "warning: the sensor is turned by 180 degrees about x" in capsys.readouterr().err


def test_a_tool_of_unknown_mass_gives_a_remark(tmp_path, capsys) -> None:
    """Without the mass only a person can check that the readings are newtons."""
    unknown = CELL.payload.model_copy(update={"mass_kg": 0.0, "com_m": (0.0, 0.0, 0.0)})
    cell = CELL.model_copy(update={"payload": unknown})
    refuse_wrong_axes(job(tmp_path, cell=cell), dwells(SIGNED[0]))
    assert "the measured tool mass is 1 kg, the cell file has none" in capsys.readouterr().err
    refuse_wrong_axes(job(tmp_path), dwells(SIGNED[0], TRUTH))
    assert not capsys.readouterr().err


@pytest.mark.parametrize("number", [1, 7, 18])
def test_a_recording_of_a_wrongly_installed_sensor_gives_no_calibration(tmp_path, number) -> None:
    """The command ends with exit code 1 and the finding, and writes nothing."""
    path, out = recorded(tmp_path / "a.csv", SIGNED[number]), tmp_path / "cal.yaml"
    words = ["calibrate", "--from", str(path), "--out", str(out), "--cell", "cells/demo.yaml"]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 1
    assert "no calibration is made" in result.stderr
    assert not out.exists()
