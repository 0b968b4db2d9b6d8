"""Samples for the regulator's monitors, and one step of them from a state that stays as it is.

The press axis is base -z: the tool points down unless a test turns it.
"""

from copy import deepcopy
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin

from control.monitors import MonitorSample, MonitorSettings, MonitorState, monitor
from forcemesh.messages import ZERO3, Trip

DOWN = np.diag([1.0, -1.0, -1.0])


def monitor_sample(
    contact: Any, force_N: Any = (0.0, 0.0, 0.0), p_m: Any = (0.0, 0.0, 0.0), **changes: Any
) -> MonitorSample:
    """Return one sample."""
    T = pin.SE3(changes.pop("R", DOWN), np.array(p_m))
    fields: dict[str, Any] = {"torque_Nm": ZERO3, "error": (0.0,) * 6}
    fields |= {"press_axis": T.rotation[:, 2].tolist(), "along_tool": True, "side_trips": True}
    fields |= {"presses": True, "rotates": False, "follows": False, "dt_s": 0.004} | changes
    return MonitorSample(force_N=force_N, T_base_tcp=T, contact=contact, **fields)


def watched(
    before: MonitorState, sample: MonitorSample, settings: MonitorSettings
) -> tuple[MonitorState, Trip | None]:
    """Return the state after one sample, and the trip."""
    now = replace(before, waves=deepcopy(before.waves))
    return now, monitor(now, sample, settings)
