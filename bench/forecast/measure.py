"""Forecasts of drawn jobs, compared with what happens."""

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import product
from statistics import median

from bench.forecast.fit import force_job
from bench.forecast.jobs import LAWS, DrawnJob, Happened, drawn, run
from bench.harness import QUICK_STEP, Options, Tables
from bench.results import Row
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

    def contains(self, *quantities: str) -> bool:
        """Return whether the forecasts of quantities contain what happened."""
        return all(
            self.interval(name).contains(getattr(self.happened, name)) for name in quantities
        )


def forecast_jobs(count: int, seed: int) -> tuple[list[tuple[DrawnJob, ForceForecast]], list[str]]:
    """Draw jobs until so many have a forecast of each quantity; return why others have none."""
    jobs, refused = list[tuple[DrawnJob, ForceForecast]](), list[str]()
    for job in drawn(LAWS, seed):
        try:
            found = forecast(job.cell(), force_job(job))
        except DataError as error:
            refused.append(str(error))
            continue
        if found.not_followed:
            refused.append(found.not_followed)
            continue
        jobs.append((job, found))
        if len(jobs) == count:
            break
    return jobs, refused


def measure(options: Options) -> Tables:
    """Run the drawn jobs."""
    jobs, refused = forecast_jobs(JOBS // QUICK_STEP if options.quick else JOBS, JOBS_SEED)
    happened = options.pool.map(run, [job for job, _ in jobs], chunksize=4)
    rows = [Compared(*pair, each) for pair, each in zip(jobs, happened, strict=True)]
    kinds = Counter(NUMBER.sub("x", text).split(":")[0] for text in refused)
    reasons = [{"reason": reason, "draws": count} for reason, count in kinds.most_common()]
    return {
        "shares": shares(rows),
        "refused": reasons,
        "missed": missed(rows),
    }


def shares(rows: Sequence[Compared]) -> Iterator[Row]:
    """Yield the contained shares and the widths of each law and of all."""
    for law in ("all", *dict.fromkeys(row.job.law for row in rows)):
        these = [row for row in rows if law in ("all", row.job.law)]
        for quantity, name in QUANTITIES.items():
            intervals = [row.interval(quantity) for row in these]
            widths = [interval.high / interval.low for interval in intervals]
            yield {
                **contained(law, name, these, (quantity,)),
                "median_high_to_low": median(widths),
                "largest_high_to_low": max(widths),
            }
        every = contained(law, "each of them", these, QUANTITIES)
        is_met = every["contained_pct"] >= LEAST_CONTAINED_PCT
        yield every | ({"least_pct": LEAST_CONTAINED_PCT, "met": is_met} if law == "all" else {})


def contained(law: str, name: str, rows: Sequence[Compared], quantities: Iterable[str]) -> Row:
    """Return the share of jobs whose forecasts of these quantities contain what happened."""
    pct = 100.0 * sum(row.contains(*quantities) for row in rows) / len(rows)
    return {"law": law, "quantity": name, "jobs": len(rows), "contained_pct": pct}


def missed(rows: Sequence[Compared]) -> Iterator[Row]:
    """Yield the forecasts that do not contain what happened."""
    for row, quantity in product(rows, QUANTITIES):
        if not row.contains(quantity):
            yield {
                **asdict(row.job),
                "loop_hz": 1e3 / row.job.period_ms,
                "feed_mm_s": 1e3 * row.job.feed_m_s,
                "quantity": QUANTITIES[quantity],
                **asdict(row.interval(quantity)),
                "happened": getattr(row.happened, quantity),
            }
