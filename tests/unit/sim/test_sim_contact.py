"""The truth about contact: signed distance of a disc's rim to the plate at rest."""

import math

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from sim.robot.contact import lift_off_m, plate_point_under

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
