"""The motion of a surface, estimated from its measured positions."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.regulator.surface_tracking import SurfaceMotion

DT_S, TIME_S = 0.004, 0.03


def run(places_m):
    """Update the estimate with each of these positions."""
    surface = SurfaceMotion()
    for place_m in places_m:
        surface.update(place_m, DT_S, TIME_S)
    return surface


@given(st.floats(-1.0, 1.0))
def test_a_surface_at_rest_has_no_speed(place_m) -> None:
    """This holds at any position, from the first sample on."""
    surface = run([place_m] * 20)
    assert (surface.speed_m_s, surface.accel_m_s2) == (0.0, 0.0)
    assert surface.ahead(0.05, 1.0)[0] == 0.0


@given(st.floats(-0.05, 0.05))
def test_a_constant_speed_is_estimated(speed_m_s) -> None:
    """It is exact after forty time constants; the prediction is speed times time."""
    surface = run([speed_m_s * DT_S * n for n in range(300)])
    assert surface.speed_m_s == pytest.approx(speed_m_s, abs=1e-9)
    assert surface.ahead(0.05, 0.0)[0] == pytest.approx(0.05 * speed_m_s, abs=1e-9)


@given(st.floats(-0.1, 0.1))
def test_a_constant_acceleration_corrects_the_late_speed(accel_m_s2) -> None:
    """The speed alone is late; with the acceleration it is the present one."""
    count = 300
    surface = run([0.5 * accel_m_s2 * (DT_S * n) ** 2 for n in range(count)])
    now_m_s = accel_m_s2 * DT_S * (count - 1)
    assert surface.ahead(0.0, 1.0)[1] == pytest.approx(now_m_s, abs=abs(accel_m_s2) * 0.005)
    assert surface.accel_m_s2 == pytest.approx(accel_m_s2, abs=1e-6)


@given(st.floats(-0.01, 0.01), st.floats(0.0, 1.0))
def test_a_jump_decays(jump_m, share) -> None:
    """A surface that jumped once by 10 mm is at rest again: 1.04 nm/s are left."""
    surface = run([0.0] * 5 + [jump_m] * 200)
    assert surface.ahead(0.05, share)[1] == pytest.approx(0.0, abs=1.1e-9)
