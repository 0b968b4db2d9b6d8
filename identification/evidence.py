"""Readings, fit and findings of a calibration: input of its file and of its report page."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from pydantic import ValidationError

from common.config.calibration import CalibrationSection
from common.config.cell import CellConfig
from common.config.payload import DOWN, Payload
from forcemesh.errors import first_mistake
from forcemesh.messages import Vec3
from identification.dwells import Dwell, dwells_of_purpose, means_of, recording_of
from identification.errors import CalibrationError
from identification.identify import Identification, identify_payload
from identification.installation.terms import Installation
from identification.recording import Samples, WrenchAxes, WrenchRecording
from identification.report import fit_report
from identification.verification import (
    Residual,
    Verification,
    VerificationBounds,
    judge_residual,
    residual_of,
)

Method = Literal["arm", "manual", "recording"]


@dataclass(frozen=True, slots=True)
class Evidence:
    """Readings and their fit; `verify` has the mean readings of held-out poses."""

    method: Method
    recording: WrenchRecording
    axes: WrenchAxes
    fit: Identification
    verify: Samples | None = None
    serial: str = ""
    notes: tuple[str, ...] = ()
    installation: Installation | None = None  # as these readings of the cell's sensor show it


@dataclass(frozen=True, slots=True)
class Findings:
    """Calibration with its report, residuals and verdict."""

    section: CalibrationSection
    evidence: Evidence
    report: dict[str, Any]  # identification.report.fit_report
    verify_residual: Residual | None
    bounds: VerificationBounds
    verdict: Verification


def evidence_of(
    method: Method,
    dwells: Sequence[Dwell],
    *,
    source: Path,
    down_in_base: Vec3 = DOWN,
    serial: str = "",
    notes: tuple[str, ...] = (),
    installation: Installation | None = None,
) -> Evidence:
    """Fit the recorded dwells. Raises DataError when they do not determine a fit."""
    recording = recording_of(dwells_of_purpose(dwells, "fit"), source)
    fit = identify_payload(recording.samples("sensor"), down_in_base)
    verify_dwells = dwells_of_purpose(dwells, "verify")
    verify = means_of(verify_dwells) if verify_dwells else None
    return Evidence(method, recording, "sensor", fit, verify, serial, notes, installation)


def findings_of(cell: CellConfig, evidence: Evidence, bounds: VerificationBounds) -> Findings:
    """Verify a fit by its held-out poses and assemble the calibration of a cell.

    Raises CalibrationError when a fitted value is outside the limits of a calibration.
    """
    fit, verify = evidence.fit, evidence.verify
    try:
        payload = Payload.model_validate(fit.payload.model_dump())
    except ValidationError as error:
        raise CalibrationError(f"no calibration is made: {first_mistake(error).text}") from None
    verify_residual = None if verify is None else residual_of(payload, verify)
    made_at = datetime.now(UTC).replace(microsecond=0)
    section = CalibrationSection(
        cell=cell.cell,
        made_at=made_at,
        method=evidence.method,
        tool=cell.tool.name,
        T_flange_tcp=cell.tool.T_flange_tcp,
        T_flange_sensor=cell.sensor.T_flange_sensor,
        sensor=evidence.serial,
        fit=fit.residual.summary,
        verified=None if verify_residual is None else verify_residual.summary,
        payload=payload,
    )
    shown = evidence.installation
    if shown is not None and shown.rejection_reason is None:
        section = section.with_axes(
            cell.robot.model, "calibrate", made_at, torques=shown.shows_torques
        )
    return Findings(
        section=section,
        evidence=evidence,
        report=fit_report(evidence.recording, evidence.axes, fit),
        verify_residual=verify_residual,
        bounds=bounds,
        verdict=judge_residual(verify_residual, bounds),
    )
