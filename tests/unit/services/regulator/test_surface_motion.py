"""How a surface moves: found from where it is seen."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.regulator.surface_motion import SurfaceMotion, update

DT_S, TIME_S = 0.004, 0.03


def run(places_m):
    """Look at a surface in each of these places."""
    drift = SurfaceMotion()
    for place_m in places_m:
        drift = update(drift, place_m, DT_S, TIME_S)
    return drift


@given(st.floats(-1.0, 1.0))
def test_a_surface_that_stands_still_has_no_speed(place_m) -> None:
    """Wherever it is, from the first look on."""
    drift = run([place_m] * 20)
    assert (drift.speed_m_s, drift.accel_m_s2) == (0.0, 0.0)
    assert drift.ahead_m(0.05, 1.0) == 0.0


@given(st.floats(-0.05, 0.05))
def test_an_even_speed_is_found(speed_m_s) -> None:
    """After forty time constants; it is then ahead by speed times time."""
    drift = run([speed_m_s * DT_S * n for n in range(300)])
    assert drift.speed_m_s == pytest.approx(speed_m_s, abs=1e-9)
    assert drift.ahead_m(0.05, 0.0) == pytest.approx(0.05 * speed_m_s, abs=1e-9)


@given(st.floats(-0.1, 0.1))
def test_an_even_acceleration_makes_up_for_the_late_speed(accel_m_s2) -> None:
    """The speed alone is late; with the acceleration it is the one of this moment."""
    count = 300
    drift = run([0.5 * accel_m_s2 * (DT_S * n) ** 2 for n in range(count)])
    now_m_s = accel_m_s2 * DT_S * (count - 1)
    assert drift.speed_in_m_s(0.0, 1.0) == pytest.approx(now_m_s, abs=abs(accel_m_s2) * 0.005)
    assert drift.accel_m_s2 == pytest.approx(accel_m_s2, abs=1e-6)


@given(st.floats(-0.01, 0.01), st.floats(0.0, 1.0))
def test_a_jump_dies_out(jump_m, share) -> None:
    """A surface that jumped once stands still again: of 10 mm, 1.04 nm/s are left here."""
    drift = run([0.0] * 5 + [jump_m] * 200)
    assert drift.speed_in_m_s(0.05, share) == pytest.approx(0.0, abs=1.1e-9)
