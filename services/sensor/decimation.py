"""Decimation: selection of the samples to publish when the sensor is faster than needed."""

from dataclasses import dataclass, replace

RATE_WINDOW_NS = 250_000_000  # window in which the sensor's rate is measured
DECIMATION_MARGIN = 2.05  # times the cell's rate: twice, plus tolerance of clocks and measurement


@dataclass(frozen=True, slots=True)
class Decimation:
    """State of the decimation: the sensor's measured rate, and the ratio."""

    output_hz: float
    rate_hz: float = 0.0  # 0 until measured
    keep_every: int = 1
    kept: int = 0  # number of the last sample kept
    since: tuple[int, int] | None = None  # number and time [ns] at the start of the measurement


def decimate(state: Decimation, number: int, now_ns: int) -> tuple[Decimation, bool]:
    """Return the state after a sample, and whether to keep it.

    Up to twice the wanted rate every sample is kept, above it every n-th, counted by the sensor's
    sequence numbers: bursts on the network do not change the selection, and the next sample
    replaces a lost one.
    """
    state = _measure(state, number, now_ns)
    if number - state.kept < state.keep_every:
        return state, False
    return replace(state, kept=number), True


def pause(state: Decimation) -> Decimation:
    """Restart the measurement after a gap; keep the ratio until it is done."""
    return replace(state, since=None)


def _measure(state: Decimation, number: int, now_ns: int) -> Decimation:
    if state.since is None:
        return replace(state, since=(number, now_ns))
    elapsed_ns = now_ns - state.since[1]
    if elapsed_ns < RATE_WINDOW_NS:
        return state
    rate_hz = 1e9 * (number - state.since[0]) / elapsed_ns
    ratio = rate_hz / state.output_hz
    keep_every = 1 if ratio <= DECIMATION_MARGIN else round(ratio)
    return replace(state, rate_hz=rate_hz, keep_every=keep_every, since=(number, now_ns))
