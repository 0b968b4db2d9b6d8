"""Gains of force feedback: ramped, changed by request, and sent to a controller. Pure."""

from dataclasses import astuple, dataclass

import numpy as np

from common.config.cell import CellConfig
from common.motion.convert import vec3
from forcemesh.messages import Gains, Vec3
from forcemesh.requests import GainsRequest
from tuning.gain_rule import tune

GAIN_RAMP_S = 0.1  # time constant
SAME_GAIN = 0.15  # relative change of the controller's gains below which no command is sent


@dataclass(frozen=True, slots=True)
class PiGains:
    """Gains about the base axes x, y, z."""

    force_p_m_per_N: Vec3
    force_i_m_per_Ns: Vec3
    torque_p_rad_per_Nm: Vec3
    torque_i_rad_per_Nms: Vec3

    @classmethod
    def of(cls, gains: Gains) -> "PiGains":
        """Return the gains of a message."""
        return cls(**gains.as_dict())

    def ramped(self, goal: "PiGains", dt_s: float) -> "PiGains":
        """Return gains one period further towards a goal (first-order low-pass)."""
        share = min(1.0, dt_s / GAIN_RAMP_S)
        now, then = np.array(astuple(self)), np.array(astuple(goal))
        is_near = np.abs(then - now) <= 1e-3 * np.abs(then)
        if is_near.all():
            return goal
        return PiGains(*map(vec3, np.where(is_near, then, now + share * (then - now))))


def merged_gains(gains: Gains, change: GainsRequest, cell: CellConfig) -> Gains:
    """Return the gains after a request: its preset first, then its single gains."""
    if change.preset is not None:
        gains = tune(cell, change.preset).gains
    named = change.replaced(preset=None).as_dict()
    return gains.replaced(**{name: value for name, value in named.items() if value is not None})


def gains_to_send(sent: Gains | None, requested: Gains, Ki: Vec3) -> Gains:
    """Return the controller's gains with an integral gain `Ki`; small changes are not sent."""
    if sent is not None:
        pairs = zip(Ki, sent.force_i_m_per_Ns, strict=True)
        if all(abs(then - now) <= SAME_GAIN * now for then, now in pairs):
            return sent
    return requested.replaced(force_i_m_per_Ns=Ki)
