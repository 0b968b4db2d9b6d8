"""Payload parameters of a fit, each with its standard deviation."""

from dataclasses import dataclass
from math import hypot
from typing import Any

import numpy as np

from common.config.payload import BiasDrift, Payload
from common.motion.convert import vec3
from common.motion.frames import Array, vector_from_rotation
from forcemesh.messages import Vec3
from identification.least_squares import Solution
from identification.payload_model import DRIFT_AT_END, PRIOR_STD, bias_at_end

IDENTIFIED_SHARE = 0.7  # share of the prior deviation: above it the variance is not even halved
GROUPS = {  # of unknowns, by the name of the parameter
    "mass_kg": "mass",
    "com_m": "moment",
    "bias_force_N": "bias_F",
    "bias_torque_Nm": "bias_M",
    "gravity_tilt_rad": "tilt",
    "mounting_rotation_rad": "mounting",
    "force_gain": "gain_F",
    "torque_gain": "gain_M",
    "drift_force_N": "drift1_F",
    "drift_torque_Nm": "drift1_M",
}


@dataclass(frozen=True, slots=True)
class Deviations:
    """Standard deviation of each parameter, named as in Payload; None: not fitted."""

    mass_kg: float
    com_m: Vec3
    bias_force_N: Vec3
    bias_torque_Nm: Vec3
    gravity_tilt_rad: float | None = None
    mounting_rotation_rad: Vec3 | None = None
    force_gain: Vec3 | None = None
    torque_gain: Vec3 | None = None
    drift_force_N: Vec3 | None = None
    drift_torque_Nm: Vec3 | None = None


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of a fit. `amplified`: factor on its deviation from fitting the others too.

    `usual` is the prior standard deviation, infinite without a prior.
    """

    name: str
    value: float
    std: float
    amplified: float
    usual: float

    @property
    def determined(self) -> bool:
        """Return whether the recording improves on the prior."""
        return self.std <= IDENTIFIED_SHARE * self.usual


def payload_of(solution: Solution, time_s: Array | None) -> Payload:
    """Return the payload, with the bias at the end of the recording; its bounds are not checked."""
    state = solution.state
    m, h = float(state.linear[0]), state.linear[1:4]
    d_F, d_M = np.tensordot(DRIFT_AT_END, state.drift, axes=1)
    drift = None
    if solution.model.drift and time_s is not None:
        (line_F, line_M), (bend_F, bend_M) = state.drift
        drift = BiasDrift.model_construct(
            start_s=float(time_s.min()),
            end_s=float(time_s.max()),
            force_N=vec3(line_F),
            torque_Nm=vec3(line_M),
            force_bend_N=vec3(bend_F),
            torque_bend_Nm=vec3(bend_M),
        )
    return Payload.model_construct(
        mass_kg=m,
        com_m=vec3(h / max(m, 1e-12)),
        bias_force_N=vec3(state.linear[4:7] + d_F),
        bias_torque_Nm=vec3(state.linear[7:10] + d_M),
        gravity_direction_in_base=vec3(state.down_in_base),
        mounting_rotation_rad=vec3(vector_from_rotation(state.R_mount)),
        force_gain=vec3(state.gain[0]),
        torque_gain=vec3(state.gain[1]),
        drift=drift,
    )


def deviations(solution: Solution) -> Deviations:
    """Return the standard deviations, propagated to centre of mass and final bias."""
    model, covariance = solution.model, solution.covariance
    std = np.sqrt(np.diag(covariance))
    m, h = solution.state.linear[0], solution.state.linear[1:4]
    to_com = np.hstack([-h[:, None] / m**2, np.eye(3) / m])  # c = h / m
    to_end = bias_at_end(model)
    end = np.sqrt(np.diag(to_end @ covariance @ to_end.T))
    com = np.sqrt(np.diag(to_com @ covariance[:4, :4] @ to_com.T))
    of_group = {group: std[place] for group, place in model.places.items()}
    of_group |= {"moment": com, "bias_F": end[:3], "bias_M": end[3:]}
    found: dict[str, Any] = {}
    for name, group in GROUPS.items():
        parts = of_group.get(group)
        if parts is not None:
            found[name] = vec3(parts) if len(parts) == 3 else hypot(*parts)
    return Deviations(**found)


def parameters(payload: Payload, std: Deviations, solution: Solution) -> tuple[Parameter, ...]:
    """Return every fitted parameter with its uncertainty, vectors as x, y and z."""
    places, drift = solution.model.places, payload.drift
    special: dict[str, Any] = {
        "gravity_tilt_rad": float(np.arccos(min(1.0, abs(payload.gravity_direction_in_base[2])))),
        "drift_force_N": drift.force_N if drift else None,
        "drift_torque_Nm": drift.torque_Nm if drift else None,
    }
    found = []
    for name, group in GROUPS.items():
        deviation = getattr(std, name)
        if deviation is None:
            continue
        value = special[name] if name in special else getattr(payload, name)
        amplified, usual = solution.amplified[places[group]], PRIOR_STD.get(group, np.inf)
        if isinstance(value, float):
            found.append(Parameter(name, value, deviation, float(amplified.max()), usual))
        else:
            rows = zip("xyz", value, deviation, amplified, strict=True)
            found += [Parameter(f"{name}.{a}", v, s, float(k), usual) for a, v, s, k in rows]
    return tuple(found)
