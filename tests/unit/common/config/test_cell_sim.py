"""Curved surface of the simulation: the points that MuJoCo and the panel draw."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.config.cell_sim import DRAWN_DEPTH_M, DRAWN_HALF_M, SimSection

radii = st.floats(0.02, 1.0)


def drawn(surface: str, radius_m: float) -> np.ndarray:
    """Return the points of a surface. Shape (n, 3)."""
    return np.array(SimSection(surface=surface, radius_m=radius_m).curved_points_m())


@given(radii)
def test_a_hemisphere_is_drawn_on_its_sphere_from_the_top_on(radius_m: float) -> None:
    """Its centre is below the top by the radius; it ends at its base, or where drawing ends."""
    points = drawn("hemisphere", radius_m)
    distances = np.linalg.norm(points + np.array([0.0, 0.0, radius_m]), axis=1)
    assert distances == pytest.approx(radius_m)
    assert points[:, 2].max() == pytest.approx(0.0, abs=1e-12)
    assert -points[:, 2].min() == pytest.approx(min(radius_m, DRAWN_DEPTH_M))


@given(radii)
def test_a_cylinder_is_drawn_on_its_mantle_along_y(radius_m: float) -> None:
    """Every point has the radius from an axis along y; both ends are drawn."""
    points = drawn("cylinder", radius_m)
    distances = np.hypot(points[:, 0], points[:, 2] + radius_m)
    assert distances == pytest.approx(radius_m)
    assert set(points[:, 1]) == {-DRAWN_HALF_M, DRAWN_HALF_M}
    assert points[:, 2].max() == pytest.approx(0.0, abs=1e-12)
