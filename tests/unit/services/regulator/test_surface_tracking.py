"""The motion of a surface, estimated from its measured positions."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.regulator.surface_tracking import SurfaceMotion

DT_S, TIME_S = 0.004, 0.03


def run(places_m, ahead_s=0.05, share=1.0):
    """Update the estimate with each of these positions; return it, last travel and speed."""
    surface, ahead = SurfaceMotion(), (0.0, 0.0)
    for place_m in places_m:
        ahead = surface.update(place_m, DT_S, time_s=TIME_S, ahead_s=ahead_s, share=share)
    return surface, *ahead


@given(st.floats(-1.0, 1.0))
def test_a_surface_at_rest_has_no_speed(place_m) -> None:
    """This holds at any position, from the first sample on."""
    for number in (1, 20):
        surface, travel_m, _ = run([place_m] * number)
        assert (surface.speed_m_s, surface.accel_m_s2) == (0.0, 0.0)
        assert travel_m == 0.0


@given(st.floats(-0.05, 0.05))
def test_a_constant_speed_is_estimated(speed_m_s) -> None:
    """It is exact after forty time constants; the prediction is speed times time."""
    surface, travel_m, _ = run([speed_m_s * DT_S * n for n in range(300)], share=0.0)
    assert surface.speed_m_s == pytest.approx(speed_m_s, abs=1e-9)
    assert travel_m == pytest.approx(0.05 * speed_m_s, abs=1e-9)


@given(st.floats(-0.1, 0.1))
def test_a_constant_acceleration_corrects_the_late_speed(accel_m_s2) -> None:
    """The speed alone is late; with the acceleration it is the present one."""
    count = 300
    places_m = [0.5 * accel_m_s2 * (DT_S * n) ** 2 for n in range(count)]
    surface, _, speed_m_s = run(places_m, ahead_s=0.0)
    now_m_s = accel_m_s2 * DT_S * (count - 1)
    assert speed_m_s == pytest.approx(now_m_s, abs=abs(accel_m_s2) * 0.005)
    assert surface.accel_m_s2 == pytest.approx(accel_m_s2, abs=1e-6)


@given(st.floats(-0.01, 0.01), st.floats(0.0, 1.0))
def test_a_jump_decays(jump_m, share) -> None:
    """A surface that jumped once by 10 mm is at rest again: 1.04 nm/s are left."""
    _, _, speed_m_s = run([0.0] * 5 + [jump_m] * 200, share=share)
    assert speed_m_s == pytest.approx(0.0, abs=1.1e-9)
