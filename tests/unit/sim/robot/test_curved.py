"""Convex surfaces under the disc: where they touch, how they push back, and friction."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.robot.curved import Shape, SprungSurface
from sim.robot.plate import HALF_SIDE_M, Disc

K_N_M, R_M, DISC_M, STILL = 2e4, 0.08, 0.025, (0.0, 0.0, 0.0)
DT_S = 1e-3
angles = st.floats(-0.6, 0.6)


def surface(shape: Shape) -> SprungSurface:
    """Return an undeflected surface without dampers."""
    return SprungSurface(shape, R_M, stiffness_N_m=K_N_M, relaxation_s=1e-9, friction=0.3)


def disc(normal, depth_m: float, velocity=STILL, shape: Shape = "hemisphere", y_m=0.0) -> Disc:
    """Return a disc that lies flat on a surface at a point with a normal, pressed in."""
    n = np.array(normal) / np.linalg.norm(normal)
    centre = (R_M - depth_m) * n - [0.0, 0.0, R_M] + [0.0, y_m, 0.0]
    return Disc(tuple(centre), tuple(n), velocity, STILL, DISC_M)


@given(angles, angles, st.floats(1e-5, 1.5e-3))
def test_a_hemisphere_pushes_back_along_its_normal_by_stiffness_times_depth(a, b, depth_m) -> None:
    """Wherever the disc lies flat: the contact is its centre."""
    n = np.array([np.sin(a), np.sin(b), 1.0])
    n /= np.linalg.norm(n)
    sprung = surface("hemisphere")
    sprung.step(disc(n, depth_m), DT_S)
    push = sprung.step(disc(n, depth_m), DT_S)
    assert push.normal_N == pytest.approx(K_N_M * depth_m, rel=1e-3)
    assert push.force_N == pytest.approx(push.normal_N * n, abs=1e-6)
    assert push.torque_Nm == pytest.approx(STILL, abs=1e-9)


@given(angles, st.floats(1e-5, 1.5e-3), st.floats(-0.9, 0.9))
def test_a_cylinder_pushes_back_alike_all_along_its_axis(a, depth_m, y) -> None:
    """Its normal has no part along the axis; beyond its ends there is nothing."""
    n = (np.sin(a), 0.0, np.cos(a))
    for share, normal_N in ((y, K_N_M * depth_m), (1.01, 0.0)):
        sprung = surface("cylinder")
        sprung.step(disc(n, depth_m, y_m=share * HALF_SIDE_M), DT_S)
        push = sprung.step(disc(n, depth_m, y_m=share * HALF_SIDE_M), DT_S)
        assert push.normal_N == pytest.approx(normal_N, rel=1e-3)
        assert push.force_N[1] == pytest.approx(0.0, abs=1e-9)


@given(st.floats(-0.5, 0.5))
def test_a_tilted_disc_touches_where_it_is_tangent_or_with_its_rim(tilt) -> None:
    """On a sphere at R sin(tilt) from the centre of the disc, at most its radius."""
    back = (float(np.sin(tilt)), 0.0, float(np.cos(tilt)))
    _, normal, arm = surface("hemisphere").nearest(Disc(STILL, back, STILL, STILL, DISC_M))
    assert np.linalg.norm(arm) == pytest.approx(min(R_M * abs(np.sin(tilt)), DISC_M), abs=1e-9)
    if R_M * abs(np.sin(tilt)) < DISC_M:
        assert normal == pytest.approx(back, abs=1e-9)
    _, _, arm = surface("cylinder").nearest(Disc(STILL, back, STILL, STILL, DISC_M))
    assert abs(arm[0]) <= DISC_M
    assert arm[1] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("shape", ["cylinder", "hemisphere"])
def test_friction_holds_up_to_its_limit_and_opposes_sliding_beyond_it(shape: Shape) -> None:
    """A short travel is a spring's; a long one slides at the limit."""
    for travels_m, speed_m_s in ((1e-5, 1e-3), (0.01, 0.1)):
        sprung = surface(shape)
        push = sprung.step(disc((0, 0, 1), 1e-3), DT_S)
        for _ in range(round(travels_m / speed_m_s / DT_S)):
            push = sprung.step(disc((0, 0, 1), 1e-3, (speed_m_s, 0.0, 0.0)), DT_S)
        limit_N = 0.3 * push.normal_N
        expected_N = min(limit_N, K_N_M * travels_m)
        assert push.force_N[0] == pytest.approx(-expected_N, rel=0.1)
        assert np.hypot(*push.force_N[:2]) <= limit_N * (1 + 1e-9)
