"""The adaptive law goes by the period of each sample, whatever the cell's nominal one is."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.config.cell import CellConfig
from services.regulator.adaptive import AdaptiveSettings, gain_for
from tests.fakes.bench import CELL


def at_rate(control_hz: float) -> CellConfig:
    """Return the demo's cell with another nominal rate; its delay beside that is the same."""
    rates = CELL.rates.model_copy(update={"control_hz": control_hz})
    return CELL.model_copy(update={"rates": rates})


def everywhere(cell: CellConfig) -> AdaptiveSettings:
    """Return the law's settings with no contact too soft for it."""
    return replace(AdaptiveSettings.of(cell), softest_N_m=0.0)


@given(st.floats(15.0, 250.0), st.floats(200.0, 2e5))
def test_a_sample_that_comes_late_has_the_gain_of_a_loop_that_slow(rate_hz, k_N_m) -> None:
    """Nominal 250 Hz, and samples at another rate: gain and prediction of a cell of that rate.

    That is the law's own gain. Which contacts have the plain one goes by the nominal rate.
    """
    k, dt_s = np.full(3, k_N_m), 1.0 / rate_hz
    of_sample = gain_for(k, everywhere(at_rate(250.0)), dt_s)
    of_cell = gain_for(k, everywhere(at_rate(rate_hz)), dt_s)
    for one, other in zip(of_sample, of_cell, strict=True):
        assert one == pytest.approx(other, rel=1e-9)


@given(st.floats(0.001, 0.06), st.floats(0.001, 0.06), st.floats(200.0, 2e5))
def test_the_later_a_sample_comes_the_lower_is_the_gain(one_s, other_s, k_N_m) -> None:
    """Never the other way round, over all periods."""
    settings = AdaptiveSettings.of(CELL)
    sooner_s, later_s = sorted((one_s, other_s))
    soon, late = (gain_for(np.full(3, k_N_m), settings, t)[0] for t in (sooner_s, later_s))
    assert (late <= soon + 1e-15).all()
