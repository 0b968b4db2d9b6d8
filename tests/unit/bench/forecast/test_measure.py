"""Forecasts of drawn jobs: a sample in the rig, and the parts of the measurement."""

from itertools import islice
from math import exp, inf, log

import numpy as np
import pytest

from bench.forecast import measure
from bench.forecast.fit import (
    FEATURES,
    WIDEST,
    Measured,
    cross_validated,
    fit,
    force_job,
    law_map,
    map_jobs,
    solved,
)
from bench.forecast.jobs import Happened, drawn, run
from bench.forecast.measure import QUANTITIES, Compared, contained, forecast_jobs, missed, shares
from tuning.force_map import terms
from tuning.forecast import coordinates, models

SAMPLE, LEAST_CONTAINED = 6, 5


def test_a_sample_of_drawn_jobs_does_what_was_forecast() -> None:
    """At least five of six in each of three quantities; the whole draw is the bench's."""
    jobs, _ = forecast_jobs(SAMPLE, measure.JOBS_SEED)
    rows = [Compared(job, found, run(job)) for job, found in jobs]
    assert len(rows) == SAMPLE
    assert {row.job.law for row in rows} == {"adaptive", "plain"}
    assert sum(row.contains(*QUANTITIES) for row in rows) >= LEAST_CONTAINED


def test_what_did_not_settle_is_not_contained() -> None:
    """Nor is a press that settled a third later than the interval ends."""
    ((job, found),), _ = forecast_jobs(1, 5)
    settling_s, peak_N, error_N = (getattr(found, name) for name in QUANTITIES)
    inside = Happened(settling_s.low * 1.1, peak_N.low * 1.01, error_N.high * 0.99)
    assert Compared(job, found, inside).contains(*QUANTITIES)
    for settling_s in (inf, 1.3 * found.settling_s.high):
        late = Happened(settling_s, inside.peak_N, inside.follow_error_N)
        row = Compared(job, found, late)
        assert (row.contains("settling_s"), row.contains("peak_N")) == (False, True)
        both = [row, Compared(job, found, inside)]
        assert contained("all", "each", both, QUANTITIES)["contained_pct"] == 50.0


def test_the_draw_is_that_of_its_seed_and_covers_the_stated_ranges() -> None:
    """The cell's own contact is drawn often; a job's cell file loads."""
    jobs = [*islice(drawn(("adaptive", "plain"), 3), 400)]
    assert jobs == [*islice(drawn(("adaptive", "plain"), 3), 400)]
    assert 0.1 < np.mean([job.stiffest_ratio == 1.0 for job in jobs]) < 0.5
    assert all(2e3 <= job.stiffness_N_m <= 1e5 and 5.0 <= job.setpoint_N <= 40.0 for job in jobs)
    assert max(job.delay_ms for job in jobs if job.law == "adaptive") <= 60
    stiffest_N_m = jobs[0].stiffness_N_m * jobs[0].stiffest_ratio
    assert jobs[0].cell().contact.stiffness_N_m == pytest.approx(stiffest_N_m)


def test_a_fit_finds_the_correction_and_its_width() -> None:
    """Of results that are the model times a known factor and noise."""
    rng, rows = np.random.default_rng(1), []
    for job in map_jobs("plain", 300):
        values = coordinates(job.cell(), force_job(job))
        model = models("plain", values)
        factor = 1.3 * exp(rng.normal(0.0, 0.03)) * (values["loop_delay_s"] / 0.05) ** 0.2
        rows.append(Measured(job, values, Happened(*(factor * model[name] for name in FEATURES))))
    found = fit(rows, "settling_s")
    assert 0.05 < found["width"] < 0.12
    assert found["contained"] >= 0.98
    tree = law_map(rows)
    assert sorted(tree["fits"]) == sorted(FEATURES)
    assert tree["ranges"]["setpoint_N"][0] < 5.1


def test_outliers_do_not_bend_a_fit_and_no_width_is_beyond_twice() -> None:
    """One result in thirty is ten times too large."""
    x = np.linspace(-1.0, 1.0, 120)[:, None]
    ratio = 0.2 + 0.1 * x[:, 0]
    ratio[::30] += log(10.0)
    found = solved(terms(x), ratio)
    assert found[:2] == pytest.approx([0.2, 0.1], abs=0.03)
    assert np.abs(cross_validated(terms(x), ratio)).max() > WIDEST


def test_shares_and_misses_are_of_each_law_and_of_all() -> None:
    """Too few contained forecasts are not met; what was not contained is listed."""
    rows = [Compared(*pair, Happened(inf, 15.0, 1e3)) for pair in forecast_jobs(4, 7)[0]]
    (total,) = [each for each in shares(rows) if "met" in each]
    assert (total["law"], total["contained_pct"], total["met"]) == ("all", 0.0, False)
    assert {each["law"] for each in shares(rows)} == {"all", "adaptive", "plain"}
    assert [each["happened"] for each in missed(rows) if each["quantity"].startswith("sett")] == [
        inf
    ] * 4
