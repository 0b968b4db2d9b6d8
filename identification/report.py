"""Report of a fit or a check as plain numbers, for `--json` and the tables."""

from dataclasses import asdict
from typing import Any

import numpy as np

from common.config.payload import Payload
from identification.identify import Identification
from identification.model_selection import cost
from identification.payload_fit import Solution
from identification.recording import WrenchAxes, WrenchRecording
from identification.verification import Residual, residual_of


def fit_report(recording: WrenchRecording, axes: WrenchAxes, fit: Identification) -> dict[str, Any]:
    """Return all results of a fit, in SI units and sensor axes, ready for JSON."""
    rows = zip(fit.first_row, fit.residual.force_N, fit.residual.torque_Nm, strict=True)
    return {
        "recording": recording.source,
        "rows": len(recording.line),
        "poses": len(fit.first_row),
        "wrench_axes": axes,
        "model": fit.chosen.name,
        **fit.payload.model_dump(exclude={"accept_uncalibrated"}),
        **fit.std,
        "conditioning": fit.conditioning,
        "noise_force_N": float(fit.chosen.noise[0]),
        "noise_torque_Nm": float(fit.chosen.noise[1]),
        **_residual_report(fit.residual),
        **_candidate_report(fit.chosen),
        "residuals": [
            {"line": recording.line[row], "force_N": float(f), "torque_Nm": float(t)}
            for row, f, t in rows
        ],
        "models": [
            {
                "name": candidate.name,
                **_candidate_report(candidate),
                "used": candidate is fit.chosen,
            }
            for candidate in sorted(fit.candidates, key=cost)
        ],
        "rejected": [
            {"reason": r.reason, "lines": [recording.line[row] for row in r.rows]}
            for r in fit.rejected
        ],
        "unsure": list(fit.uncertain),
        "not_identified": list(fit.undetermined),
        "next_pose": asdict(fit.next_pose),
        "warnings": list(fit.warnings),
    }


def check_report(recording: WrenchRecording, axes: WrenchAxes, payload: Payload) -> dict[str, Any]:
    """Return the residual of a payload over a recording: mean and maximum of the norms."""
    found = residual_of(payload, recording.samples(axes))
    return {
        "recording": recording.source,
        "rows": len(recording.line),
        "wrench_axes": axes,
        **_residual_report(found),
        "worst_force_line": recording.line[int(found.force_N.argmax())],
        "worst_torque_line": recording.line[int(found.torque_Nm.argmax())],
    }


def _residual_report(residual: Residual) -> dict[str, float]:
    return {
        "residual_force_N_mean": float(residual.force_N.mean()),
        "residual_force_N_max": float(residual.force_N.max()),
        "residual_torque_Nm_mean": float(residual.torque_Nm.mean()),
        "residual_torque_Nm_max": float(residual.torque_Nm.max()),
    }


def _candidate_report(candidate: Solution) -> dict[str, float | None]:
    (rms_N, rms_Nm), (left_out_N, left_out_Nm) = candidate.rms, candidate.left_out_rms
    return {
        "rms_force_N": float(rms_N),
        "rms_torque_Nm": float(rms_Nm),
        "leave_one_out_force_N": _finite_or_none(float(left_out_N)),
        "leave_one_out_torque_Nm": _finite_or_none(float(left_out_Nm)),
    }


def _finite_or_none(value: float) -> float | None:
    """Return None for infinity, which JSON cannot represent."""
    return value if np.isfinite(value) else None
