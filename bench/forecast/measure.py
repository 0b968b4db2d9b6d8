"""Forecasts of drawn jobs, compared with what happens."""

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from statistics import median

from bench.forecast.fit import force_job
from bench.forecast.jobs import LAWS, DrawnJob, Happened, drawn, run
from bench.harness import QUICK_STEP, Options
from bench.results import Row, Table, table
from forcemesh.errors import DataError
from tuning.force_map import Interval
from tuning.forecast import ForceForecast, forecast

JOBS_SEED, JOBS = 23, 200
LEAST_CONTAINED_PCT = 90.0
QUANTITIES = {
    "settling_s": "settling after touch",
    "peak_N": "peak of the press",
    "follow_error_N": "largest error on the slope",
}
NUMBER = re.compile(r"\d[\d.]*(?:e[+-]\d+)?")
SHARES = {
    "law": "", "quantity": "", "jobs": "d", "contained_pct": ".1f", "least_pct": "g", "met": "",
    "median_high_to_low": ".2f", "largest_high_to_low": ".2f",
}  # fmt: skip
MISSED = {
    "law": "", "stiffness_N_m": ".3g", "delay_ms": "g", "loop_hz": ".0f", "setpoint_N": ".1f",
    "feed_mm_s": ".0f", "quantity": "", "low": ".3g", "high": ".3g", "happened": ".3g",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Compared:
    """A job with its forecast and what happened."""

    job: DrawnJob
    forecast: ForceForecast
    happened: Happened

    def interval(self, quantity: str) -> Interval:
        """Return the forecast of a quantity."""
        found: Interval = getattr(self.forecast, quantity)
        return found

    def contains(self, quantity: str) -> bool:
        """Return whether the forecast of a quantity contains what happened."""
        return self.interval(quantity).contains(getattr(self.happened, quantity))

    @property
    def contains_all(self) -> bool:
        """Whether each of its forecasts does."""
        return all(map(self.contains, QUANTITIES))


@dataclass(frozen=True, slots=True)
class Drawn:
    """Jobs with a forecast of each quantity, and why others were not forecast."""

    jobs: list[tuple[DrawnJob, ForceForecast]]
    refused: list[str]


def forecast_jobs(count: int, seed: int) -> Drawn:
    """Draw jobs until so many have a forecast of each quantity."""
    found = Drawn([], [])
    for job in drawn(LAWS, seed):
        try:
            forecast_ = forecast(job.cell(), force_job(job))
        except DataError as error:
            found.refused.append(str(error))
            continue
        if forecast_.not_followed:
            found.refused.append(forecast_.not_followed)
            continue
        found.jobs.append((job, forecast_))
        if len(found.jobs) == count:
            break
    return found


def measure(options: Options) -> dict[str, Table]:
    """Run the drawn jobs."""
    draw = forecast_jobs(JOBS // QUICK_STEP if options.quick else JOBS, JOBS_SEED)
    happened = options.pool.map(run, [job for job, _ in draw.jobs], chunksize=4)
    rows = [Compared(*pair, each) for pair, each in zip(draw.jobs, happened, strict=True)]
    kinds = Counter(NUMBER.sub("x", text).split(":")[0] for text in draw.refused)
    refused = [{"reason": reason, "draws": count} for reason, count in kinds.most_common()]
    return {
        "shares": table(SHARES, shares(rows)),
        "refused": table({"reason": "", "draws": "d"}, refused),
        "missed": table(MISSED, missed(rows)),
    }


def shares(rows: Sequence[Compared]) -> Iterator[Row]:
    """Yield the contained shares and the widths of each law and of all."""
    for law in ("all", *dict.fromkeys(row.job.law for row in rows)):
        these = [row for row in rows if law in ("all", row.job.law)]
        for quantity, name in QUANTITIES.items():
            intervals = [row.interval(quantity) for row in these]
            widths = [interval.high / interval.low for interval in intervals]
            yield {
                "law": law,
                "quantity": name,
                "jobs": len(these),
                "contained_pct": 100.0 * contained_share(these, quantity),
                "median_high_to_low": median(widths),
                "largest_high_to_low": max(widths),
            }
        pct = 100.0 * contained_share(these)
        required = {"least_pct": LEAST_CONTAINED_PCT, "met": pct >= LEAST_CONTAINED_PCT}
        each = {"law": law, "quantity": "each of them", "jobs": len(these), "contained_pct": pct}
        yield each | (required if law == "all" else {})


def contained_share(rows: Sequence[Compared], quantity: str = "") -> float:
    """Return the share of jobs whose forecast of a quantity, or of each, contains what happened."""
    return sum(r.contains(quantity) if quantity else r.contains_all for r in rows) / len(rows)


def missed(rows: Sequence[Compared]) -> Iterator[Row]:
    """Yield the forecasts that do not contain what happened."""
    for row in rows:
        for quantity, name in QUANTITIES.items():
            if not row.contains(quantity):
                job, interval = row.job, row.interval(quantity)
                yield {
                    "law": job.law,
                    "stiffness_N_m": job.stiffness_N_m,
                    "delay_ms": job.delay_ms,
                    "loop_hz": 1e3 / job.period_ms,
                    "setpoint_N": job.setpoint_N,
                    "feed_mm_s": 1e3 * job.feed_m_s,
                    "quantity": name,
                    "low": interval.low,
                    "high": interval.high,
                    "happened": getattr(row.happened, quantity),
                }
