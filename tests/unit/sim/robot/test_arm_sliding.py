"""The simulated arm on its plate: a sliding tool does not chatter, whatever the length of a tick.

The tool is led on a circle about the plate's middle, so that nothing but contact, friction and the
arm's own motion can change the force.
"""

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
import pinocchio as pin
import pytest

from sim.robot.arm import SimArm
from sim.robot.engine import mujoco
from sim.robot.settings import TICK_S, SimSettings
from tests.fakes.long import long

PRESS_N, CIRCLE_M, SPEED_M_S = 10.0, 0.010, 0.02
LEAD_IN_TICKS, TICKS = 600, 1400


@dataclass(frozen=True, slots=True)
class Slide:
    """Forces of the plate on the tool: a row for each millisecond on the circle."""

    normal_N: np.ndarray
    sideways_N: np.ndarray

    @property
    def ripple_N(self) -> float:
        """Standard deviation of the normal force."""
        return float(self.normal_N.std())


@cache
def slide(stiffness_N_m: float, *, steps: int = 1, bob_m: float = 0.0) -> Slide:
    """Press with 10 N and slide on a circle; `steps` of physics for each tick of set points.

    `bob_m` lets the tool go up and down at 10 Hz, so that stick, slip and lift all take part.
    """
    arm = SimArm(SimSettings(delay_s=0.0, stiffness_N_m=stiffness_N_m), seed=0)
    arm.model.opt.timestep = TICK_S / steps
    start, q, rows = arm.T_base_flange, arm.q, []
    for tick in range(TICKS):
        share = min(tick / 300.0, 1.0)
        angle = max(0, tick - 400) * TICK_S * SPEED_M_S / CIRCLE_M
        down_m = share * (arm.settings.gap_m + PRESS_N / stiffness_N_m)
        down_m += bob_m * math.sin(math.tau * 10.0 * tick * TICK_S)
        travel = np.array([CIRCLE_M * math.sin(angle), CIRCLE_M * math.cos(angle), -down_m])
        travel[1] -= CIRCLE_M * (1.0 - share)  # out to the circle while it comes down
        found = arm.kinematics.solve(
            pin.SE3(start.rotation, start.translation + travel), q, jump_rad=1.0
        )
        assert found.q is not None, found.reason
        q = found.q
        arm.command_joints(q)
        arm.step()
        for _ in range(steps - 1):
            mujoco.mj_step1(arm.model, arm.data)
            arm.plate.act()
            mujoco.mj_step2(arm.model, arm.data)
        rows.append(arm.true_wrench().force_N)
    forces = np.array(rows)[LEAD_IN_TICKS:]
    return Slide(forces[:, 2], np.hypot(forces[:, 0], forces[:, 1]))


stiffnesses = pytest.mark.parametrize("stiffness_N_m", [long(1e3), 2e4, long(2e5)])


@stiffnesses
def test_sliding_with_friction_does_not_chatter(stiffness_N_m):
    """No tick without contact, a ripple below a hundredth of the force, Coulomb's friction."""
    found = slide(stiffness_N_m)
    assert (found.normal_N > 0.0).all()
    assert found.ripple_N < 0.01 * found.normal_N.mean()
    ratio = found.sideways_N / found.normal_N
    assert ratio == pytest.approx(0.3, abs=0.02)


@stiffnesses
@pytest.mark.parametrize("bob_share", [0.0, 0.5, 1.5])
def test_halving_the_tick_changes_the_ripple_by_less_than_five_percent(stiffness_N_m, bob_share):
    """Tick, half and quarter: on the circle, with a force that swings, and with lift-off."""
    bob_m = bob_share * PRESS_N / stiffness_N_m
    whole, half, quarter = (slide(stiffness_N_m, steps=n, bob_m=bob_m) for n in (1, 2, 4))
    assert half.ripple_N == pytest.approx(whole.ripple_N, rel=0.05)
    assert quarter.ripple_N == pytest.approx(half.ripple_N, rel=0.05)
    assert half.normal_N.mean() == pytest.approx(whole.normal_N.mean(), rel=0.01)
    assert (whole.normal_N <= 0.0).any() == (bob_share > 1.0)
