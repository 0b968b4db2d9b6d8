"""Which samples go on the bus when the sensor is much faster than the cell asks for."""

from dataclasses import dataclass, replace

WINDOW_NS = 250_000_000  # over which the sensor's rate is measured
MARGIN = 2.05  # times the cell's rate: twice, and what clocks and measuring are off


@dataclass(frozen=True, slots=True)
class Thinning:
    """The sensor's measured rate, and every which sample is kept."""

    wanted_hz: float
    rate_hz: float = 0.0  # 0 until it was measured
    keep_every: int = 1
    kept: int = 0  # number of the last sample kept
    since: tuple[int, int] | None = None  # number and time [ns] at which measuring began


def thin(state: Thinning, number: int, now_ns: int) -> tuple[Thinning, bool]:
    """Take a sample in; tell whether to keep it.

    Up to twice the wanted rate every sample is kept, above it every n-th, counted by the sensor's
    own numbers: bursts on the network do not change the choice, a lost sample is made up for by
    the next one.
    """
    state = _measure(state, number, now_ns)
    if number - state.kept < state.keep_every:
        return state, False
    return replace(state, kept=number), True


def pause(state: Thinning) -> Thinning:
    """Measure anew after a gap; until then keep the old choice."""
    return replace(state, since=None)


def _measure(state: Thinning, number: int, now_ns: int) -> Thinning:
    if state.since is None:
        return replace(state, since=(number, now_ns))
    elapsed_ns = now_ns - state.since[1]
    if elapsed_ns < WINDOW_NS:
        return state
    rate_hz = 1e9 * (number - state.since[0]) / elapsed_ns
    ratio = rate_hz / state.wanted_hz
    keep_every = 1 if ratio <= MARGIN else round(ratio)
    return replace(state, rate_hz=rate_hz, keep_every=keep_every, since=(number, now_ns))
