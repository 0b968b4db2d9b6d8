"""Large force display of the status bar: the force, its set point, or why there is none. Pure."""

from typing import Any

import numpy as np

from common.config.cell import CellConfig
from forcemesh.bus import Reading
from services.panel.readout import Readout
from services.panel.watch import Snapshot, age_text


def force_display(cell: CellConfig, snapshot: Snapshot) -> dict[str, str]:
    """Return caption and value of the force [N] and its set point [N].

    While force feedback presses, the force is the one along the tool's z axis, else |F|. Without a
    fresh wrench the value is empty, and `lost` gives the reason: no data must not look like 0 N.
    """
    wrench, robot, target = snapshot.wrench.fresh, snapshot.robot.fresh, snapshot.target.fresh
    if snapshot.hub_fault or wrench is None:
        return {"caption": "force", "value": "", "setpoint": "", "lost": lost(snapshot)}
    note = "" if wrench.calibrated else ", not calibrated"
    presses = target is not None and target.mode in {"position", "both"}
    if robot is None or target is None or not presses or target.law == "admittance":
        size_N = float(np.linalg.norm(wrench.force_N))
        return {
            "caption": f"force |F|{note}",
            "value": f"{size_N:.1f}",
            "setpoint": "",
            "lost": "",
        }
    press_N = Readout(cell).tool(robot, wrench).press_N or 0.0
    setpoint = "" if target.setpoint_N is None else f"{target.setpoint_N:.1f}"
    return {
        "caption": f"normal force{note}",
        "value": f"{press_N:z.1f}",
        "setpoint": setpoint,
        "lost": "",
    }


def lost(snapshot: Snapshot) -> str:
    """Return in a few words why there is no force."""
    reading: Reading[Any] = snapshot.wrench
    if snapshot.hub_fault or reading.message is None:
        return "no data"
    return f"no data for {age_text(reading)}" if reading.silent else "not valid"
