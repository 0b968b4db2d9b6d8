"""Margins: a loop with more delay or gain than its margins oscillates, with less it does not."""

from dataclasses import replace
from math import pi

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tuning.margins import Loop, forecast, margins, release_response

loops = st.builds(
    lambda k, delay, lag, low, c, m: Loop(k, 0.0, delay, lag, low, m).with_gain(
        c / (k * (delay + lag + low))
    ),
    st.floats(3.0, 5.3).map(lambda x: 10.0**x),
    st.floats(0.004, 0.1),
    st.floats(0.004, 0.05),
    st.floats(0.001, 0.02),
    st.floats(0.1, 1.2),
    st.floats(0.0, 2.0),
)


def is_oscillating(loop: Loop) -> bool:
    """Return whether a release grows instead of decaying, by the model in the time domain."""
    t, force = release_response(loop, 150.0)
    tail = np.abs(force[t > 0.8 * t[-1]]).max()
    middle = np.abs(force[(t > 0.2 * t[-1]) & (t < 0.4 * t[-1])]).max()
    return bool(tail > max(middle, 1e-6) or np.abs(force).max() > 10.0)


@settings(max_examples=12)
@given(loops)
def test_the_delay_margin_is_the_added_delay_that_keeps_a_loop_stable(loop: Loop) -> None:
    """By a model in the time domain: 0.8 of the margin decays, 1.25 of it oscillates."""
    found = margins(loop)
    if not found.stable:
        assert is_oscillating(loop)
        return
    less = replace(loop, delay_s=loop.delay_s + 0.8 * found.delay_s)
    more = replace(loop, delay_s=loop.delay_s + 1.25 * found.delay_s)
    assert margins(less).stable
    assert not margins(more).stable
    assert not is_oscillating(less)
    assert is_oscillating(more)


def test_the_rule_settles_in_four_to_five_tau_unless_the_tool_is_heavy() -> None:
    """The model gives the documented numbers of the plain law; without gain it never settles."""
    loop = Loop(2e4, 0.0, 0.016, 0.0107, 0.005, 1.2)
    ruled = forecast(loop.with_gain(0.45 / (loop.stiffness * loop.tau_s)))
    assert ruled.settling_s is not None
    assert 3.0 * loop.tau_s < ruled.settling_s < 6.0 * loop.tau_s
    assert ruled.overshoot_pct < 4.0
    assert forecast(loop.with_gain(2.5 / (loop.stiffness * loop.tau_s))).settling_s is None
    heavy = Loop(1e3, 0.45 / (1e3 * loop.tau_s), 0.016, 0.0107, 0.005, 3.0)
    assert not margins(heavy).stable
    assert forecast(loop) == type(ruled)(None, 0.0)
    assert margins(loop).stable


@given(st.floats(0.005, 0.1), st.floats(3.0, 5.3))
def test_a_pure_delay_has_the_margins_of_the_textbook(delay_s: float, log_k: float) -> None:
    """Integrator with dead time: the limit is pi/2, the phase margin 90 degrees minus c."""
    k = 10.0**log_k
    found = margins(Loop(k, 0.45 / (k * delay_s), delay_s, 0.0, 0.0, 0.0))
    assert found.gain_margin == pytest.approx(0.5 * pi / 0.45, rel=2e-3)
    assert found.phase_deg == pytest.approx(90.0 - np.degrees(0.45), abs=0.2)
    assert found.delay_s == pytest.approx(delay_s * (0.5 * pi / 0.45 - 1.0), rel=5e-3)
    assert not margins(Loop(k, 1.6 / (k * delay_s), delay_s, 0.0, 0.0, 0.0)).stable
