"""The forecast map: `python -m bench.forecast.fit` measures and prints it.

Fits to measured jobs, with their width from cross-validation. The map that arming warns by is the
packaged tuning/force_map.json; this one is compared with it and put in its place by a person.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import dataclass
from itertools import islice
from math import isfinite, log
from typing import Any

import numpy as np

from bench.forecast.jobs import LAWS, SLOPE_DEG, DrawnJob, Happened, drawn, run
from bench.results import measured_now
from common.config.cell import CellConfig
from common.motion.frames import Array
from control.measured_range import range_violation, softest_N_m
from tuning.force_map import check_value, terms
from tuning.forecast import (
    LEAST_FOLLOWING,
    RANGED,
    SURFACE,
    ForceJob,
    coordinates,
    features,
    inertia_share,
    models,
)

PRESS = (
    *("stiffness_N_m", "stiffest_ratio", "loop_delay_s", "period_s", "setpoint_N"),
    *("accel_m_s2", "speed_max_m_s", "inertia_kg_s", "approach_N", "loop_gain", "slowness"),
)
FEATURES = {
    "settling_s": PRESS,
    "peak_N": PRESS,
    "follow_error_N": (
        *("stiffness_N_m", "stiffest_ratio", "loop_delay_s", "period_s", "setpoint_N"),
        *("accel_m_s2", "inertia_kg_s", "surface_N", "loop_gain", "slowness"),
    ),
}
COMMAND = "python -m bench.forecast.fit"
MAP_SEED, MAP_JOBS = 101, 1500  # of each law
FOLDS = 10
SHARE = 0.99  # of the jobs that a fit has not seen, within its width
EDGE = 1.03  # ranges are rounded outwards by this: draws do not reach the edges
WIDEST = 0.5 * log(2.0)  # high / low is at most 2
NARROWEST = 0.05  # the noise of another sensor, or a stiffness a little off, is not in the map
RIDGE, ROUNDS, KNEE = 1.0, 8, 2.2
DIGITS = 6


@dataclass(frozen=True, slots=True)
class Measured:
    """A job with its coordinates in the map, and its result."""

    job: DrawnJob
    values: Mapping[str, float]
    happened: Happened

    @property
    def is_followed(self) -> bool:
        """Whether the map is to cover the slope as well."""
        return self.job.law == "plain" or inertia_share(self.values) >= LEAST_FOLLOWING


def force_job(job: DrawnJob) -> ForceJob:
    """Return the job as it is forecast."""
    return ForceJob(
        job.setpoint_N, job.stiffness_N_m, job.law, feed_m_s=job.feed_m_s, slope_deg=SLOPE_DEG
    )


def map_jobs(law: str, count: int) -> list[DrawnJob]:
    """Return the jobs of a law's map: those of the draw whose contact the law claims."""
    draw = islice(drawn((law,), MAP_SEED), count)
    return [job for job in draw if in_measured_range(job.cell(), job)]


def in_measured_range(cell: CellConfig, job: DrawnJob) -> bool:
    """Return whether the laws claim this cell and contact: measured_range.py."""
    if job.law == "plain":
        return not range_violation(cell.plant.loop_hz, cell.plant.tau_s, job.stiffness_N_m)
    softest = softest_N_m(cell)
    return softest is not None and job.stiffness_N_m >= softest


def law_map(measured: Sequence[Measured]) -> dict[str, Any]:
    """Return the map of one law as a tree for JSON."""
    ranges = {}
    for name in (*RANGED, *SURFACE):
        values = [each.values[name] for each in measured]
        ranges[name] = rounded([min(values) / EDGE, max(values) * EDGE])
    fits = {name: fit(measured, name) for name in FEATURES}
    return {"jobs": len(measured), "ranges": ranges, "fits": fits}


def fit(measured: Sequence[Measured], quantity: str) -> dict[str, Any]:
    """Return the fit of one quantity, with the share of unseen jobs within its width."""
    used = [m for m in measured if m.is_followed or quantity != "follow_error_N"]
    used = [m for m in used if isfinite(getattr(m.happened, quantity))]
    law, names = used[0].job.law, FEATURES[quantity]
    rows = np.array([[features(law, m.values)[name] for name in names] for m in used])
    centre, scale = rows.mean(axis=0), np.maximum(rows.std(axis=0), 1e-9)
    model = np.array([models(law, m.values)[quantity] for m in used])
    ratio = np.log(np.array([getattr(m.happened, quantity) for m in used]) / model)
    design = terms((rows - centre) / scale)
    misses = np.abs(cross_validated(design, ratio))
    width = min(max(float(np.quantile(misses, SHARE)), NARROWEST), WIDEST)
    width_, contained = rounded([width, (misses <= width).mean()])
    return {
        "features": list(names),
        "centre": rounded(centre),
        "scale": rounded(scale),
        "coefficients": rounded(solved(design, ratio)),
        "width": width_,
        "contained": contained,
    }


def cross_validated(design: Array, ratio: Array) -> Array:
    """Return the residual of each job in a fit to the other folds. Shape (jobs,)."""
    residual = np.zeros(len(ratio))
    for fold in range(FOLDS):
        held = np.arange(len(ratio)) % FOLDS == fold
        residual[held] = ratio[held] - design[held] @ solved(design[~held], ratio[~held])
    return residual


def solved(design: Array, ratio: Array) -> Array:
    """Return the coefficients of a fit that few outliers do not bend. Shape (terms,).

    Ridge regression, weighted again by the residuals (Huber): the loop gain nearly follows from
    other features.
    """
    weight: Array = np.ones(len(ratio))
    found: Array = np.zeros(design.shape[1])
    for _ in range(ROUNDS):
        weighted = design * weight[:, None]
        square = weighted.T @ design + RIDGE * np.eye(design.shape[1])
        found = np.asarray(np.linalg.solve(square, weighted.T @ ratio), dtype=float)
        size = np.abs(ratio - design @ found)
        knee = KNEE * max(float(np.median(size)), 1e-6)
        weight = np.minimum(1.0, knee / np.maximum(size, 1e-12))
    return np.asarray(found)


def rounded(values: Iterable[float]) -> list[float]:
    """Return numbers with the digits of the file."""
    return [float(f"{value:.{DIGITS}g}") for value in values]


def force_map(pool: Executor) -> dict[str, Any]:
    """Return the tree of the map's file with its stamp and check value."""
    laws = {}
    for law in LAWS:
        jobs = map_jobs(law, MAP_JOBS)
        happened = pool.map(run, jobs, chunksize=8)
        rows = [
            Measured(job, coordinates(job.cell(), force_job(job)), each)
            for job, each in zip(jobs, happened, strict=True)
        ]
        laws[law] = law_map(rows)
    stamp = measured_now("force-map", COMMAND, {})
    made = {"command": COMMAND, "commit": stamp.commit, "day": stamp.date, "seed": MAP_SEED}
    tree = {**made, "laws": laws}
    return tree | {"check": check_value(tree)}


if __name__ == "__main__":
    with ProcessPoolExecutor() as processes:
        print(json.dumps(force_map(processes), indent=1))
