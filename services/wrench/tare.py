"""Tare: take the present reading as zero, and refuse when it cannot be zero. Pure."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from common.frames import Array
from common.messages import Reply
from common.payload import Payload
from services.wrench.compensation import weight_at_sensor_in_sensor


@dataclass(frozen=True, slots=True)
class TareLimits:
    """A larger change of bias is taken for contact."""

    force_N: float
    torque_Nm: float


def tare(
    payload: Payload, samples: Sequence[Array], R_base_sensor: Array, limits: TareLimits
) -> tuple[Payload, Reply]:
    """Return the payload with the new bias, or the old one with the reason of the refusal.

    Only the bias changes: mean reading minus the weight of the tool in this orientation.

    Args:
        payload: The payload so far.
        samples: Readings at rest, force then torque, sensor axes. Each of shape (6,).
        R_base_sensor: Orientation of the sensor in base. Shape (3, 3).
        limits: Largest change of bias that is not taken for contact.
    """
    mean = np.mean(samples, axis=0)
    weight = weight_at_sensor_in_sensor(payload, R_base_sensor)
    bias_N, bias_Nm = mean[:3] - weight.force_N, mean[3:] - weight.torque_Nm
    change_N = float(np.linalg.norm(bias_N - payload.bias_force_N))
    change_Nm = float(np.linalg.norm(bias_Nm - payload.bias_torque_Nm))
    if change_N > limits.force_N:
        return payload, _contact("N", change_N, limits.force_N)
    if change_Nm > limits.torque_Nm:
        return payload, _contact("N m", change_Nm, limits.torque_Nm)
    tared = replace(
        payload, bias_force_N=tuple(bias_N.tolist()), bias_torque_Nm=tuple(bias_Nm.tolist())
    )
    text = f"bias changed by {change_N:.2f} N and {change_Nm:.3f} N m"
    return tared, Reply(accepted=True, text=text, value=change_N)


def _contact(unit: str, change: float, limit: float) -> Reply:
    text = f"the bias would change by {change:.1f} {unit}: is the tool in contact?"
    return Reply(accepted=False, code="contact", text=text, value=change, limit=limit)
