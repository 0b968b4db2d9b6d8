"""Report of a fit or a check as plain numbers, for `--json` and the tables."""

from dataclasses import asdict
from typing import Any

import numpy as np

from common.config.payload import Payload
from common.motion.weight import drift_covers
from identification.identify import Identification
from identification.model_selection import Candidate
from identification.recording import WrenchAxes, WrenchRecording
from identification.verification import Residual, residual_of


def fit_report(recording: WrenchRecording, axes: WrenchAxes, fit: Identification) -> dict[str, Any]:
    """Return all results of a fit, in SI units and sensor axes, ready for JSON."""
    chosen, noise = fit.chosen, fit.chosen.solution.noise
    rows = zip(fit.first_row, fit.residual.force_N, fit.residual.torque_Nm, strict=True)
    return {
        "recording": recording.source,
        "rows": len(recording.line),
        "poses": len(fit.first_row),
        "wrench_axes": axes,
        "model": chosen.model.name,
        **_payload_report(fit),
        "parameters": [
            {**asdict(p), "usual": _finite_or_none(p.usual), "identified": p.determined}
            for p in fit.parameters
        ],
        "conditioning": chosen.solution.conditioning,
        "noise_force_N": noise.force_N,
        "noise_torque_Nm": noise.torque_Nm,
        **_residual_report(fit.residual),
        "rms_force_N": chosen.rms_force_N,
        "rms_torque_Nm": chosen.rms_torque_Nm,
        "leave_one_out_force_N": _finite_or_none(chosen.loo_force_N),
        "leave_one_out_torque_Nm": _finite_or_none(chosen.loo_torque_Nm),
        "residuals": [
            {"line": recording.line[row], "force_N": float(f), "torque_Nm": float(t)}
            for row, f, t in rows
        ],
        "models": [_model_report(candidate) for candidate in fit.candidates],
        "rejected": [
            {"reason": r.reason, "lines": [recording.line[row] for row in r.rows]}
            for r in fit.rejected
        ],
        "unsure": list(fit.uncertain),
        "not_identified": list(fit.undetermined),
        "next_pose": asdict(fit.next_pose),
        "warnings": list(fit.warnings),
    }


def _payload_report(fit: Identification) -> dict[str, Any]:
    payload, std = fit.payload, fit.std
    return {
        "mass_kg": payload.mass_kg,
        "mass_std_kg": std.mass_kg,
        "com_m": payload.com_m,
        "com_std_m": std.com_m,
        "bias_force_N": payload.bias_force_N,
        "bias_force_std_N": std.bias_force_N,
        "bias_torque_Nm": payload.bias_torque_Nm,
        "bias_torque_std_Nm": std.bias_torque_Nm,
        "gravity_direction_in_base": payload.gravity_direction_in_base,
        "gravity_tilt_std_rad": std.gravity_tilt_rad,
        "mounting_rotation_rad": payload.mounting_rotation_rad,
        "mounting_rotation_std_rad": std.mounting_rotation_rad,
        "force_gain": payload.force_gain,
        "force_gain_std": std.force_gain,
        "torque_gain": payload.torque_gain,
        "torque_gain_std": std.torque_gain,
        "drift": None if payload.drift is None else payload.drift.model_dump(),
    }


def check_report(recording: WrenchRecording, axes: WrenchAxes, payload: Payload) -> dict[str, Any]:
    """Return the residual of a payload over a recording: mean and maximum of the norms.

    The drift of the fit applies only near the times of its recording; `drift` reports whether.
    """
    drift, samples = payload.drift, recording.samples(axes)
    used = drift is not None and drift_covers(drift, recording.time_s)
    found = residual_of(payload, samples, drift=used)
    without_drift = residual_of(payload, samples)
    return {
        "recording": recording.source,
        "rows": len(recording.line),
        "wrench_axes": axes,
        **_residual_report(found),
        "worst_force_line": recording.line[int(found.force_N.argmax())],
        "worst_torque_line": recording.line[int(found.torque_Nm.argmax())],
        "drift": "none" if drift is None else "used" if used else "of another time, not used",
        "residual_force_N_mean_without_drift": float(without_drift.force_N.mean()),
        "residual_torque_Nm_mean_without_drift": float(without_drift.torque_Nm.mean()),
    }


def _residual_report(residual: Residual) -> dict[str, float]:
    return {
        "residual_force_N_mean": float(residual.force_N.mean()),
        "residual_force_N_max": float(residual.force_N.max()),
        "residual_torque_Nm_mean": float(residual.torque_Nm.mean()),
        "residual_torque_Nm_max": float(residual.torque_Nm.max()),
    }


def _model_report(candidate: Candidate) -> dict[str, Any]:
    return {
        "name": candidate.model.name,
        "rms_force_N": candidate.rms_force_N,
        "rms_torque_Nm": candidate.rms_torque_Nm,
        "leave_one_out_force_N": _finite_or_none(candidate.loo_force_N),
        "leave_one_out_torque_Nm": _finite_or_none(candidate.loo_torque_Nm),
        "conditioning": _finite_or_none(candidate.solution.conditioning),
        "evidence": candidate.evidence,
        "verdict": candidate.verdict,
    }


def _finite_or_none(value: float) -> float | None:
    """Return None for infinity, which JSON cannot represent."""
    return value if np.isfinite(value) else None
