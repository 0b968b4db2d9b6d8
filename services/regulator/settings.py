"""Settings and gains of the law, from the cell file and from requests. Pure."""

import numpy as np

from common.config.cell import CellConfig
from forcemesh.messages import Gains
from forcemesh.requests import GainsRequest
from services.regulator.law import LawSettings, PiGains
from tuning.gain_rule import tune

PROBE_N = 5.0  # overshoot of the first touch, which verifies the signs and must stay gentle
APPROACH_INERTIA_SHARE = 0.1  # largest inertial force of the approach, relative to the touch force


def law_settings(cell: CellConfig) -> LawSettings:
    """Return the law's settings; the approach speed follows from its force budget.

    The first touch adds about k v tau before the loop reacts.
    """
    force = cell.force
    probe_m_s = PROBE_N / (cell.contact.stiffness_N_m * cell.loop_delay_s)
    return LawSettings(
        deadband_N=force.deadband_N,
        deadband_Nm=force.deadband_Nm,
        speed_max_m_s=min(force.speed_max_m_s, cell.limits.speed_m_s),
        speed_max_rad_s=force.speed_max_rad_s,
        approach_m_s=min(force.approach_m_s, cell.approach_limit_m_s, probe_m_s),
        approach_accel_m_s2=APPROACH_INERTIA_SHARE * force.touch_N / cell.contact.inertia_kg,
        touch_N=force.touch_N,
    )


def pi_gains(gains: Gains) -> PiGains:
    """Convert gains to arrays."""
    return PiGains(
        np.array(gains.force_p_m_per_N),
        np.array(gains.force_i_m_per_Ns),
        np.array(gains.torque_p_rad_per_Nm),
        np.array(gains.torque_i_rad_per_Nms),
    )


def merged_gains(gains: Gains, change: GainsRequest, cell: CellConfig) -> Gains:
    """Return the gains after a request: its preset first, then its single gains."""
    if change.preset is not None:
        gains = tune(cell, change.preset).gains
    new = {name: value for name, value in change.as_dict().items() if value is not None}
    new.pop("preset", None)
    return gains.replaced(**new)
