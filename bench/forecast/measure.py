"""The forecast map measured, and forecasts compared with what happens."""

from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from itertools import islice

from bench.forecast.fit import Measured, force_job, in_measured_range
from bench.forecast.jobs import DrawnJob, Happened, drawn, run
from forcemesh.errors import DataError
from tuning.force_map import Interval
from tuning.forecast import ForceForecast, coordinates, forecast

LAWS = ("adaptive", "plain")
MAP_SEED, MAP_JOBS = 101, 1500  # of each law
JOBS_SEED, JOBS = 23, 200
QUANTITIES = ("settling_s", "peak_N", "follow_error_N")


@dataclass(frozen=True, slots=True)
class Compared:
    """A job with its forecast and what happened."""

    job: DrawnJob
    forecast: ForceForecast
    happened: Happened

    def contains(self, quantity: str) -> bool:
        """Return whether the forecast of a quantity contains what happened."""
        return interval_of(self.forecast, quantity).contains(getattr(self.happened, quantity))

    @property
    def contains_all(self) -> bool:
        """Whether each of its forecasts does."""
        return all(map(self.contains, QUANTITIES))


@dataclass(frozen=True, slots=True)
class Drawn:
    """Jobs with a forecast of each quantity, and why others were not forecast."""

    jobs: tuple[tuple[DrawnJob, ForceForecast], ...]
    refused: tuple[str, ...]


def interval_of(found: ForceForecast, quantity: str) -> Interval:
    """Return the interval of one quantity, which the forecast covers."""
    interval: Interval = getattr(found, quantity)
    return interval


def map_jobs(law: str, count: int) -> list[DrawnJob]:
    """Return the jobs of a law's map: those of the draw whose contact the law claims."""
    draw = islice(drawn((law,), MAP_SEED), count)
    return [job for job in draw if in_measured_range(job.cell(), job)]


def measured(jobs: Sequence[DrawnJob], pool: Executor) -> Iterator[Measured]:
    """Run jobs and yield them with their coordinates."""
    for job, happened in zip(jobs, pool.map(run, jobs, chunksize=8), strict=True):
        yield Measured(job, coordinates(job.cell(), force_job(job)), happened)


def forecast_jobs(count: int, seed: int) -> Drawn:
    """Draw jobs until so many have a forecast of each quantity."""
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
    return Drawn(tuple(jobs), tuple(refused))


def compared(draw: Drawn, pool: Executor) -> list[Compared]:
    """Run the jobs of a draw."""
    jobs = [job for job, _ in draw.jobs]
    happened = pool.map(run, jobs, chunksize=4)
    return [Compared(*pair, each) for pair, each in zip(draw.jobs, happened, strict=True)]


def contained_share(rows: Sequence[Compared], quantity: str = "") -> float:
    """Return the share of jobs whose forecast of a quantity, or of each, contains what happened."""
    inside = [row.contains(quantity) if quantity else row.contains_all for row in rows]
    return sum(inside) / len(rows)
