"""Measured range of the adaptive law: loop rate, delay and softest contact. Data.

Each row is the slowest loop and the longest delay of releases from 30 N in the bench (`World` of
bench/force), and the softest contact on which none of them overshot by more than 5 %. At 15 and
30 Hz and 60 ms, contacts of 1e3 and 2e3 N/m overshoot by 9 to 20 %. Below the softest contact of
its row the law uses the plain law's gain, which is safe for every softer contact; outside all rows
the plain law runs.
"""

from dataclasses import dataclass

from common.config.cell import CellConfig


@dataclass(frozen=True, slots=True)
class AdaptiveRange:
    """Slowest loop, longest delay, and the softest contact with at most 5 % overshoot there."""

    slowest_hz: float
    longest_delay_s: float
    softest_N_m: float


MEASURED = (
    AdaptiveRange(60.0, 0.060, 1e3),
    AdaptiveRange(125.0, 0.070, 1e3),
    AdaptiveRange(15.0, 0.030, 2e3),
    AdaptiveRange(15.0, 0.060, 5e3),
)
SAME = 1.0 - 1e-6  # tolerance of rates and delays typed with fewer digits


def loop_hz(cell: CellConfig) -> float:
    """Return the loop rate: the slower one of regulator and robot [Hz]."""
    return min(cell.rates.control_hz, cell.rates.robot_hz)


def softest_N_m(cell: CellConfig) -> float | None:
    """Return the softest contact the adaptive law is valid for in a cell [N/m]; None: none."""
    rate_hz, delay_s = loop_hz(cell), cell.robot.delay_s
    rows = (
        row.softest_N_m
        for row in MEASURED
        if rate_hz >= SAME * row.slowest_hz and SAME * delay_s <= row.longest_delay_s
    )
    return min(rows, default=None)


def restriction(cell: CellConfig) -> str:
    """Return the restriction of the adaptive law in a cell, empty when there is none."""
    softest = softest_N_m(cell)
    loop = f"{loop_hz(cell):g} Hz and {cell.robot.delay_s * 1e3:g} ms of delay"
    if softest is None:
        longest_ms = max(row.longest_delay_s for row in MEASURED) * 1e3
        slowest_hz = min(row.slowest_hz for row in MEASURED)
        return (
            f"the adaptive law was never measured at {loop} (down to {slowest_hz:g} Hz, up to "
            f"{longest_ms:g} ms): the plain law runs in its place"
        )
    if softest <= min(row.softest_N_m for row in MEASURED):
        return ""
    return (
        f"at {loop} the adaptive law is valid from {softest:g} N/m upwards: softer contacts use "
        "the plain law's gain"
    )
