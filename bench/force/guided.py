"""Scenes with a hand that guides the tool through a soft grip: freely, and to a wall."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from bench.force.laws import Make
from bench.force.measures import means
from bench.force.rig import ForceRig, SceneSettings
from bench.results import Row
from common.motion.frames import Array
from sim.robot.settings import TICK_S

GRIP_N_M, GRIP_NS_M, HAND_M_S = 500.0, 20.0, 0.03
FIRM_N_M = 1000.0  # grip of a hand that presses against the wall
WALL_M, LEAN_S, BACK_S, END_S = 0.005, 0.4, 1.2, 2.2

HandMotion = Callable[[float], tuple[Array, Array]]  # of the hand since the grip [m], [m/s]


def guide(world: SceneSettings, make: Make) -> Row:
    """A hand pulls the free tool at 30 mm/s."""
    velocity_m_s = np.array([0.0, HAND_M_S, 0.0])
    rig = ForceRig(replace(world, gap_m=0.05).cell())
    pilot = make(rig)
    rig.every_tick = grip_force(rig, lambda t: (velocity_m_s * t, velocity_m_s), GRIP_N_M)
    trace = rig.run(pilot, 2.0)
    force = np.array(trace.force_N)[:, 1][np.array(trace.t_s) > 1.0]
    return {"hand_N": float(np.abs(force).mean()), "hand_peak_N": float(np.abs(force).max())}


def guide_to_a_wall(world: SceneSettings, make: Make) -> Row:
    """A hand guides the tool down against the plate, presses, and guides it up again."""
    down = np.array([0.0, 0.0, -HAND_M_S])
    rig = ForceRig(replace(world, gap_m=WALL_M).cell())
    pilot = make(rig)

    def lean(t: float) -> tuple[Array, Array]:
        if t < LEAN_S:
            return down * t, down
        return down * (LEAN_S - max(0.0, t - BACK_S)), (-down if t > BACK_S else 0.0 * down)

    rig.every_tick = grip_force(rig, lean, FIRM_N_M)
    trace = rig.run(pilot, END_S)
    t, push = np.array(trace.t_s), np.array(trace.push_N)
    z = np.array([T.translation[2] for T in trace.T_base_tcp])
    leaning = push[(t > 0.5 * (LEAN_S + BACK_S)) & (t < BACK_S)]
    return {
        "peak_N": float(means(t, push).max()),
        "leaning_N": float(leaning.mean()),
        "ripple_N": float(leaning.std()),
        "came_back_mm": 1e3 * float(z[-1] - z.min()),
    }


def grip_force(
    rig: ForceRig, hand_motion: HandMotion, grip_N_m: float
) -> Callable[[ForceRig], None]:
    """Return the function that applies the force of the hand at every tick."""
    tool, start = rig.arm.model.body("tool").id, rig.arm.ticks
    home: Array = np.array(rig.arm.T_base_tcp.translation)
    last = [home.copy()]

    def pull(rig: ForceRig) -> None:
        at = np.array(rig.arm.T_base_tcp.translation)
        speed, last[0] = (at - last[0]) / TICK_S, at
        place, hand_speed = hand_motion((rig.arm.ticks - start) * TICK_S)
        force_N = grip_N_m * (home + place - at) + GRIP_NS_M * (hand_speed - speed)
        rig.arm.data.xfrc_applied[tool][:3] = force_N

    return pull
