"""Report of a fit or a check as plain numbers, for `--json` and the tables."""

from dataclasses import asdict
from typing import Any

import numpy as np

from common.config.payload import Payload
from common.motion.frames import Array
from common.motion.weight import drift_covers, residual
from identification.identify import Identification
from identification.model_selection import Candidate
from identification.recording import WrenchAxes, WrenchRecording


def fit_report(recording: WrenchRecording, axes: WrenchAxes, fit: Identification) -> dict[str, Any]:
    """Return all results of a fit, in SI units and sensor axes, ready for JSON."""
    payload, chosen = fit.payload, fit.chosen
    force = np.linalg.norm(fit.residual_force_N, axis=1)
    torque = np.linalg.norm(fit.residual_torque_Nm, axis=1)
    return {
        "recording": recording.source,
        "rows": len(recording.line),
        "poses": len(force),
        "wrench_axes": axes,
        "model": chosen.model.name,
        **_payload_report(fit),
        "drift": None if payload.drift is None else payload.drift.model_dump(),
        "parameters": [
            {**asdict(p), "usual": _finite_or_none(p.usual), "identified": p.determined}
            for p in fit.parameters
        ],
        "conditioning": chosen.solution.conditioning,
        "noise_force_N": chosen.solution.noise.force_N,
        "noise_torque_Nm": chosen.solution.noise.torque_Nm,
        **_residual_summary(force, torque),
        "rms_force_N": chosen.rms_force_N,
        "rms_torque_Nm": chosen.rms_torque_Nm,
        "leave_one_out_force_N": _finite_or_none(chosen.loo_force_N),
        "leave_one_out_torque_Nm": _finite_or_none(chosen.loo_torque_Nm),
        "residuals": [
            {"line": recording.line[row], "force_N": float(f), "torque_Nm": float(t)}
            for row, f, t in zip(fit.first_row, force, torque, strict=True)
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
        "com_m": list(payload.com_m),
        "com_std_m": list(std.com_m),
        "bias_force_N": list(payload.bias_force_N),
        "bias_force_std_N": list(std.bias_force_N),
        "bias_torque_Nm": list(payload.bias_torque_Nm),
        "bias_torque_std_Nm": list(std.bias_torque_Nm),
        "gravity_direction_in_base": list(payload.gravity_direction_in_base),
        "gravity_tilt_std_rad": std.gravity_tilt_rad,
        "mounting_rotation_rad": list(payload.mounting_rotation_rad),
        "mounting_rotation_std_rad": _as_list(std.mounting_rotation_rad),
        "force_gain": list(payload.force_gain),
        "force_gain_std": _as_list(std.force_gain),
        "torque_gain": list(payload.torque_gain),
        "torque_gain_std": _as_list(std.torque_gain),
    }


def check_report(recording: WrenchRecording, axes: WrenchAxes, payload: Payload) -> dict[str, Any]:
    """Return the residual of a payload over a recording: mean and maximum of the norms.

    The drift of the fit applies only near the times of its recording; `drift` reports whether.
    """
    drift, time_s = payload.drift, recording.time_s
    used = drift is not None and drift_covers(drift, time_s)
    samples = recording.samples(axes)
    sizes = []
    for times in (time_s if used else None, None):
        errors = residual(
            payload,
            samples.R_base_sensor,
            force_N=samples.force_N,
            torque_Nm=samples.torque_Nm,
            time_s=times,
        )
        sizes.append([np.linalg.norm(v, axis=1) for v in errors])
    (force_norm, torque_norm), without_drift = sizes
    return {
        "recording": recording.source,
        "rows": len(recording.line),
        "wrench_axes": axes,
        **_residual_summary(force_norm, torque_norm),
        "worst_force_line": recording.line[int(force_norm.argmax())],
        "worst_torque_line": recording.line[int(torque_norm.argmax())],
        "drift": "none" if drift is None else "used" if used else "of another time, not used",
        "residual_force_N_mean_without_drift": float(without_drift[0].mean()),
        "residual_torque_Nm_mean_without_drift": float(without_drift[1].mean()),
    }


def _residual_summary(force: Array, torque: Array) -> dict[str, float]:
    return {
        "residual_force_N_mean": float(force.mean()),
        "residual_force_N_max": float(force.max()),
        "residual_torque_Nm_mean": float(torque.mean()),
        "residual_torque_Nm_max": float(torque.max()),
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


def _as_list(values: tuple[float, ...] | None) -> list[float] | None:
    return None if values is None else list(values)
