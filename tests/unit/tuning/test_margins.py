"""Margins of a loop against the textbook, and the settling that the gain rule gives."""

from math import pi

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tuning.margins import Loop, forecast, margins


@given(st.floats(0.005, 0.1), st.floats(3.0, 5.3))
def test_a_pure_delay_has_the_margins_of_the_textbook(delay_s: float, log_k: float) -> None:
    """Integrator with dead time: the limit is pi/2, the phase margin 90 degrees minus c."""
    k = 10.0**log_k
    found = margins(Loop(k, 0.45 / (k * delay_s), delay_s, 0.0, 0.0, 0.0))
    assert found.gain_margin == pytest.approx(0.5 * pi / 0.45, rel=2e-3)
    assert found.phase_deg == pytest.approx(90.0 - np.degrees(0.45), abs=0.2)
    assert found.delay_s == pytest.approx(delay_s * (0.5 * pi / 0.45 - 1.0), rel=5e-3)
    assert not margins(Loop(k, 1.6 / (k * delay_s), delay_s, 0.0, 0.0, 0.0)).stable


def test_the_rule_settles_in_four_to_five_tau() -> None:
    """The documented numbers of the plain law; an unstable loop never settles."""
    loop = Loop(2e4, 0.0, 0.016, 0.0107, 0.005, 1.2)
    ruled = forecast(loop.with_gain(0.45 / (loop.stiffness * loop.tau_s)))
    assert ruled.settling_s is not None
    assert 4.0 * loop.tau_s < ruled.settling_s < 5.0 * loop.tau_s
    assert ruled.overshoot_pct < 4.0
    assert forecast(loop.with_gain(2.5 / (loop.stiffness * loop.tau_s))).settling_s is None
