"""The adaptive law uses the period of each sample instead of the cell's nominal one."""

from dataclasses import replace
from math import inf

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from common.config.cell import CellConfig
from services.regulator.adaptive import UNPREDICTED_AT, AdaptiveSettings, gain_for
from tests.fakes.bench import CELL
from tuning.gain_rule import LOOP_GAIN


def at_rate(control_hz: float) -> CellConfig:
    """Return the demo's cell with another nominal rate and the same delay otherwise."""
    rates = CELL.rates.model_copy(update={"control_hz": control_hz})
    return CELL.model_copy(update={"rates": rates})


RULE = [inf] * 3  # requested gains that reduce nothing


def settings_for_any_contact(cell: CellConfig) -> AdaptiveSettings:
    """Return the law's settings that include the softest contact."""
    return replace(AdaptiveSettings.of(cell), softest_N_m=0.0)


@given(st.floats(15.0, 250.0), st.floats(200.0, 2e5))
def test_a_late_sample_has_the_gain_of_a_loop_with_that_period(rate_hz, k_N_m) -> None:
    """Samples at another rate than 250 Hz have gain and prediction of a cell of that rate.

    This concerns the adaptive gain. The nominal rate decides which contacts have the plain gain.
    """
    k, dt_s = [k_N_m] * 3, 1.0 / rate_hz
    of_sample = gain_for(k, RULE, settings_for_any_contact(at_rate(250.0)), dt_s)
    of_cell = gain_for(k, RULE, settings_for_any_contact(at_rate(rate_hz)), dt_s)
    for one, other in zip(of_sample, of_cell, strict=True):
        assert one == pytest.approx(other, rel=1e-9)


@given(st.floats(0.001, 0.06), st.floats(0.001, 0.06), st.floats(200.0, 2e5))
def test_a_longer_period_has_a_lower_gain(one_s, other_s, k_N_m) -> None:
    """The gain decreases over all periods."""
    settings = AdaptiveSettings.of(CELL)
    sooner_s, later_s = sorted((one_s, other_s))
    soon, late = (gain_for([k_N_m] * 3, RULE, settings, t)[0] for t in (sooner_s, later_s))
    assert (np.array(late) <= np.array(soon) + 1e-15).all()


@given(st.floats(0.05, 1.0), st.floats(0.05, 1.0), st.floats(200.0, 2e5))
@example(0.85, 1.0, 6400.0)  # prediction rose by a quarter before it fell
def test_a_smaller_gain_share_has_a_lower_gain_and_no_more_prediction(one, other, k_N_m) -> None:
    """Of requests at the rule or above it; from some fall on nothing is predicted."""
    settings, dt_s = AdaptiveSettings.of(CELL), 1.0 / CELL.rates.control_hz
    less, more = sorted((one, other))
    whole = gain_for([k_N_m] * 3, RULE, settings, dt_s)
    at_more = gain_for([k_N_m] * 3, RULE, settings, dt_s, share=more)
    at_less = gain_for([k_N_m] * 3, RULE, settings, dt_s, share=less)
    for value, other_value, first in zip(at_less, at_more, whole, strict=True):
        assert (np.array(value) <= np.array(other_value) + 1e-15).all()
        assert (np.array(other_value) <= np.array(first) + 1e-15).all()
    tau_s = settings.tau_s
    if less <= 1.0 - UNPREDICTED_AT:
        assert at_less[1] == pytest.approx([0.0] * 3, abs=1e-9)
        assert (np.array(at_less[0]) <= less * LOOP_GAIN / (k_N_m * tau_s) + 1e-15).all()
    rule = settings.plain_gain_m_per_Ns
    requested = gain_for([k_N_m] * 3, [0.5 * rule * more] * 3, settings, dt_s, share=more)
    assert np.array(requested[0]) == pytest.approx(0.5 * np.array(at_more[0]))
