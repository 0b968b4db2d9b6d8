"""Measures of a force trace. Pure.

Means over 8 ms, because of the sensor's noise, without the first 15 ms, in which the tool's inertia
appears as force.
"""

import numpy as np

from bench.force.rig import Trace
from common.motion.frames import Array

MEAN_S = 0.008
IGNORED_S = 0.015


def means(t_s: Array, values: Array) -> Array:
    """Return each value averaged over the last few milliseconds. Shape (n,)."""
    first = np.searchsorted(t_s, t_s - MEAN_S)
    total = np.concatenate([[0.0], np.cumsum(values)])
    last = np.arange(1, len(t_s) + 1)
    return np.asarray((total[last] - total[first]) / (last - first))


def settling_s(t_s: Array, error: Array, band: float) -> float | None:
    """Return the time from which the error stays within a band; None if it does not."""
    outside = np.flatnonzero(np.abs(means(t_s, error)) > band)
    if len(outside) == 0:
        return 0.0
    return None if outside[-1] + 1 >= len(t_s) else float(t_s[outside[-1] + 1])


def energy_mJ(trace: Trace) -> float:
    """Return the energy exchanged between tool and environment, both directions added."""
    force_N = np.array(trace.force_N)
    place_m = np.array([T.translation for T in trace.T_base_tcp])
    work_J = np.einsum("ij,ij->i", 0.5 * (force_N[1:] + force_N[:-1]), np.diff(place_m, axis=0))
    return 1e3 * float(np.abs(work_J).sum())
