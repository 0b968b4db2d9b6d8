"""Processor time of one millisecond of the simulated arm: MuJoCo's step and the plate."""

from time import thread_time_ns

import numpy as np
from rich.table import Table

from bench.tables import on_screen
from sim.robot.arm import SimArm
from sim.robot.engine import mujoco
from sim.robot.settings import SimSettings

MOST_US = 80.0
ROUNDS, TICKS = 20, 500
PRESS_N = 20.0


def arm_at(tilt_deg: float, push_N: float) -> SimArm:
    """Return an arm at rest that presses with about this force on a tilted plate; 0: free."""
    arm = SimArm(SimSettings(tilt_deg=tilt_deg, delay_s=0.0), seed=0)
    settings, T = arm.settings, arm.T_base_flange
    if push_N > 0.0:
        T.translation[2] -= settings.gap_m + push_N / settings.stiffness_N_m
    found = arm.kinematics.solve(T, arm.q, jump_rad=1.0)
    if found.q is None:
        raise ValueError(found.reason)
    arm.command_joints(found.q)
    for _ in range(TICKS):
        arm.step()
    return arm


def costs_us(arm: SimArm) -> list[float]:
    """Return the mean of each round of ticks [us]: physics and contact, without set points."""
    found = []
    for _ in range(ROUNDS):
        start_ns = thread_time_ns()
        for _ in range(TICKS):
            mujoco.mj_step1(arm.model, arm.data)
            arm.plate.act()
            mujoco.mj_step2(arm.model, arm.data)
        found.append((thread_time_ns() - start_ns) / TICKS / 1e3)
    return found


def engine_us() -> float:
    """Return the time of MuJoCo's own steps in a tick [us], in the round least disturbed."""
    arm = arm_at(0.0, PRESS_N)
    found = []
    for _ in range(ROUNDS):
        start_ns = thread_time_ns()
        for _ in range(TICKS):
            mujoco.mj_step1(arm.model, arm.data)
            mujoco.mj_step2(arm.model, arm.data)
        found.append((thread_time_ns() - start_ns) / TICKS / 1e3)
    return min(found)


def table() -> Table:
    """Return median and worst round for a free tool, one flat on the plate and one on its edge."""
    rows = []
    for name, tilt_deg, push_N in (
        ("free", 0.0, 0.0),
        ("flat on the plate", 0.0, PRESS_N),
        ("on its edge", 10.0, PRESS_N),
    ):
        found = costs_us(arm_at(tilt_deg, push_N))
        rows.append([name, f"{np.median(found):.1f}", f"{max(found):.1f}"])
    title = f"CPU time of a tick of physics and contact, us: at most {MOST_US:g}"
    return on_screen(title, ("tool", "median", "worst round"), rows)
