"""Filter of the sensor's six channels: median against spikes, then a first-order low-pass. Pure."""

from dataclasses import dataclass
from math import exp

import numpy as np

from common.motion.frames import Array


@dataclass(frozen=True, slots=True)
class Filter:
    """State of the filter; empty until the first sample."""

    median: int
    lowpass_s: float
    recent: tuple[Array, ...] = ()
    output: Array | None = None


def feed(state: Filter, sample: Array, dt_s: float) -> Filter:
    """Return the filter after one more sample.

    y <- y + (1 - exp(-dt / T)) (median - y); the first sample passes unfiltered.

    Args:
        state: State of the filter.
        sample: Six numbers in one unit each. Shape (6,).
        dt_s: Time since the last sample.
    """
    recent = (*state.recent, sample)[-state.median :]
    middle = np.sort(recent, axis=0)[len(recent) // 2]
    if state.output is None:
        return Filter(state.median, state.lowpass_s, recent, middle)
    share = 1.0 if state.lowpass_s == 0.0 else 1.0 - exp(-dt_s / state.lowpass_s)
    output = state.output + share * (middle - state.output)
    return Filter(state.median, state.lowpass_s, recent, output)
