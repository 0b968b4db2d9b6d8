"""Tare: bias that makes the present reading zero, refused when it cannot be zero. Pure."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from common.config.payload import Payload
from common.motion.convert import vec3
from common.motion.frames import GRAVITY_M_S2, Array
from common.motion.weight import residual
from forcemesh.faults import refusal
from forcemesh.requests import Reply

WEIGHT_SHARE = 0.6  # a wrong unit or sign removes 0.78 (pounds), 0.9 (kgf), 1.4 or 2 weights
LEAST_WEIGHT_N = 2.0  # drift can be as large as a smaller weight


@dataclass(frozen=True, slots=True)
class TareLimits:
    """Largest change of bias; a larger one is taken for contact."""

    force_N: float
    torque_Nm: float


def tare(
    payload: Payload, samples: Sequence[Array], R_base_sensor: Array, limits: TareLimits
) -> tuple[Payload, Reply]:
    """Return the payload with the new bias, or the old one with the reason of the refusal.

    Only the bias changes, by the mean residual of the readings after bias and weight. It must not
    absorb the weight of the tool: that would hide a wrong sign, axis or unit.

    Args:
        payload: The present payload.
        samples: Readings at rest, force then torque, sensor axes. Each of shape (6,).
        R_base_sensor: Orientation of the sensor in base. Shape (3, 3).
        limits: Largest change of bias.
    """
    mean = np.mean(samples, axis=0)
    shift_N, shift_Nm = residual(payload, R_base_sensor, force_N=mean[:3], torque_Nm=mean[3:])
    change_N, change_Nm = float(np.linalg.norm(shift_N)), float(np.linalg.norm(shift_Nm))
    if change_N > limits.force_N:
        return payload, _contact("N", change_N, limits.force_N)
    if change_Nm > limits.torque_Nm:
        return payload, _contact("N m", change_Nm, limits.torque_Nm)
    weight_N = payload.mass_kg * GRAVITY_M_S2
    if weight_N >= LEAST_WEIGHT_N and change_N > WEIGHT_SHARE * weight_N:
        text = (
            f"the bias would change by {change_N:.1f} N and the tool weighs {weight_N:.1f} N: "
            "a sign, an axis or a unit of the sensor, or the payload, is wrong"
        )
        return payload, refusal("payload", text, value=change_N, limit=WEIGHT_SHARE * weight_N)
    bias = {
        "bias_force_N": vec3(np.array(payload.bias_force_N) + shift_N * payload.force_gain),
        "bias_torque_Nm": vec3(np.array(payload.bias_torque_Nm) + shift_Nm * payload.torque_gain),
    }
    tared = payload.model_copy(update=bias)
    text = (
        f"tared: force and torque are zero now; the bias changed by {change_N:.2f} N "
        f"and {change_Nm:.3f} N m"
    )
    return tared, Reply(accepted=True, text=text, value=change_N)


def _contact(unit: str, change: float, limit: float) -> Reply:
    text = f"the bias would change by {change:.1f} {unit}: is the tool in contact?"
    return refusal("contact", text, value=change, limit=limit)
