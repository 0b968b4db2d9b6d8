"""Scenes with rotation of the tool: alignment, lateral pull, sliding."""

from dataclasses import replace

import numpy as np

from bench.force.laws import HOLD_N, Make, holding
from bench.force.measures import means
from bench.force.rig import ForceRig, SceneSettings
from bench.results import Row

SLIDE_M_S, SLIDE_S, SLIDE_TILT_DEG = 0.02, 1.5, 3.0


def align(world: SceneSettings, make: Make) -> Row:
    """Alignment of a face from 10 degrees in mode both, at 10 N."""
    rig = ForceRig(replace(world, tilt_deg=10.0).cell())
    rig.press(3.0)
    pilot = make(rig)
    pilot.mode, pilot.setpoint_N = "both", HOLD_N
    trace = rig.run(pilot, 8.0)
    normal = rig.arm.plate.normal
    cosine = [-float(normal @ T.rotation[:, 2]) for T in trace.T_base_tcp]
    left_deg = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    force_N = np.linalg.norm(trace.force_N, axis=1)
    t = np.array(trace.t_s)
    return {
        "misalignment_deg": float(left_deg[-1]),
        "time_to_1_deg_s": float(t[np.argmax(left_deg < 1.0)]),
        "force_off_N": float(np.abs(force_N - HOLD_N)[t > 1.0].max()),
    }


def lateral(world: SceneSettings, make: Make) -> Row:
    """Mode both at 10 N while a lateral force of 3 N acts on the tool."""
    rig, pilot, _ = holding(world, make)
    pilot.mode = "both"
    tool = rig.arm.model.body("tool").id
    rig.arm.data.xfrc_applied[tool][:3] = (2.0, 0.0, 0.0)
    trace = rig.run(pilot, 2.0)
    t = np.array(trace.t_s)
    push = np.array(trace.push_N)
    off = float(np.abs(push[t > 0.5] - HOLD_N).mean())
    sideways = np.array(trace.force_N)[:, 0]
    return {"normal_error_N": off, "sideways_left_N": float(np.abs(sideways[t > 1.5]).mean())}


def slide(world: SceneSettings, make: Make) -> Row:
    """Mode both at 10 N, moved 30 mm at 20 mm/s over a plate with friction, tilted 3 degrees.

    The disc lies flat before it is moved, uphill; the first 0.3 s, in which friction builds up, are
    evaluated separately.
    """
    rig = ForceRig(replace(world, tilt_deg=SLIDE_TILT_DEG).cell())
    rig.press(3.0)
    pilot = make(rig)
    pilot.mode, pilot.setpoint_N = "both", HOLD_N
    rig.run(pilot, 6.0)
    pilot.across_m_s = np.array([0.0, SLIDE_M_S, 0.0])
    trace = rig.run(pilot, SLIDE_S)
    t, push = np.array(trace.t_s), np.array(trace.push_N)
    normal = rig.arm.plate.normal
    cosine = [-float(normal @ T.rotation[:, 2]) for T in trace.T_base_tcp]
    return {
        "mean_error_N": float(np.abs(push[t >= 0.3] - HOLD_N).mean()),
        "peak_error_N": float(np.abs(means(t, push) - HOLD_N).max()),
        "friction_N": float(np.abs(np.array(trace.force_N)[t >= 0.3, 1]).mean()),
        "misalignment_deg": float(np.degrees(np.arccos(np.clip(min(cosine), -1.0, 1.0)))),
        "contact_lost": float((means(t, push) < 0.5).any()),
    }
