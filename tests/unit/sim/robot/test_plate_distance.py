"""The true contact: distance of the disc from the plate at rest, and its readers."""

import math

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from sim.robot.arm import SimArm
from sim.robot.plate import lift_off_m, plate_point_under
from sim.robot.settings import SimSettings

vectors = hnp.arrays(float, 3, elements=st.floats(-1.0, 1.0))
radii = st.floats(0.005, 0.05)


def tilted_normal(tilt_rad: float) -> np.ndarray:
    """Return the normal of a plate tilted about base x."""
    return np.array([0.0, -math.sin(tilt_rad), math.cos(tilt_rad)])


@given(vectors, vectors, vectors, st.floats(0.0, 0.4), radii)
def test_lift_off_is_the_nearest_point_of_the_rim(turn, centre, point, tilt, radius):
    """The closed formula equals the minimum over points sampled densely on the rim."""
    T = pin.SE3(pin.exp3(2.0 * turn), centre)
    normal = tilted_normal(tilt)
    angles = np.linspace(0.0, math.tau, 721)
    rim = np.stack([np.cos(angles), np.sin(angles), 0.0 * angles]) * radius
    sampled = (normal @ (T.rotation @ rim + (centre - point)[:, None])).min()
    exact = lift_off_m(T, plate_point_m=point, plate_normal=normal, disc_radius_m=radius)
    assert exact <= sampled + 1e-9
    assert exact == pytest.approx(sampled, abs=2e-5 * radius)


@given(vectors, st.floats(-0.3, 0.3), st.floats(0.0, 0.35), radii, st.floats(0.0005, 0.1))
def test_the_plate_is_put_the_gap_below_the_rim(centre, lean, tilt, radius, gap):
    """Lowering the disc vertically by exactly the gap makes it touch."""
    down = pin.utils.rotate("x", math.pi + lean)
    T = pin.SE3(down, centre)
    normal = tilted_normal(tilt)
    point = plate_point_under(T, plate_normal=normal, disc_radius_m=radius, gap_m=gap)
    lowered = pin.SE3(down, centre - np.array([0.0, 0.0, gap]))
    touching = lift_off_m(lowered, plate_point_m=point, plate_normal=normal, disc_radius_m=radius)
    assert touching == pytest.approx(0.0, abs=1e-12)
    assert point[:2] == pytest.approx(centre[:2])


def fall(settings: SimSettings, depth_m: float, ticks: int) -> np.ndarray:
    """Lead the tool down to the plate and return its wrench, a row for each tick."""
    arm = SimArm(settings, seed=0)
    start, q, rows = arm.T_base_flange, arm.q, []
    for tick in range(ticks):
        down = pin.SE3(np.eye(3), np.array([0.0, 0.0, depth_m * (tick + 1) / ticks]))
        found = arm.kinematics.solve(start * down, q, jump_rad=1.0)
        assert found.q is not None, found.reason
        q = found.q
        arm.command_joints(q)
        arm.step()
        truth = arm.true_wrench()
        rows.append((*arm.q, *truth.force_N, *truth.torque_Nm))
    return np.array(rows)


def test_a_plate_that_is_far_away_is_left_out_and_nothing_changes(monkeypatch):
    """To the last bit, at twice the highest speed of a cell: from free space into the plate."""
    settings = SimSettings(gap_m=0.1, delay_s=0.0)
    falls = fall(settings, 0.13, 60), fall(settings, 0.12, 200)
    assert all(rows[:, 8].max() > 20.0 for rows in falls)
    monkeypatch.setattr("sim.robot.arm.FAR_M", math.inf)
    for rows, (depth_m, ticks) in zip(falls, ((0.13, 60), (0.12, 200)), strict=True):
        assert np.array_equal(rows, fall(settings, depth_m, ticks))
