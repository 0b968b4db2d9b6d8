"""Where the adaptive law was measured: how slow a loop, how late an arm, how soft a contact. Data.

Each row is the slowest loop and the longest delay of releases from 30 N in the bench (`World` of
bench/force), and the softest contact on which none of them overshot by more than 5 %. At 15 and
30 Hz and 60 ms, contacts of 1e3 and 2e3 N/m overshoot by 9 to 20 %. Softer than its row the plain
law's gain holds, which is safe for every softer contact; beyond all rows the plain law runs.
"""

from dataclasses import dataclass

from common.config.cell import Cell


@dataclass(frozen=True, slots=True)
class MeasuredLoops:
    """Loops that are at least so fast and arms at most so late; softest contact that was well."""

    slowest_hz: float
    longest_delay_s: float
    softest_N_m: float


MEASURED = (
    MeasuredLoops(60.0, 0.060, 1e3),
    MeasuredLoops(125.0, 0.070, 1e3),
    MeasuredLoops(15.0, 0.030, 2e3),
    MeasuredLoops(15.0, 0.060, 5e3),
)
SAME = 1.0 - 1e-6  # a rate or a delay that was typed is the measured one


def loop_hz(cell: Cell) -> float:
    """Return how often the slower of regulator and robot turns [Hz]."""
    return min(cell.rates.control_hz, cell.rates.robot_hz)


def softest_N_m(cell: Cell) -> float | None:
    """Return the softest contact that the adaptive law bears in a cell; None: none at all."""
    rate_hz, delay_s = loop_hz(cell), cell.robot.delay_s
    rows = (
        row.softest_N_m
        for row in MEASURED
        if rate_hz >= SAME * row.slowest_hz and SAME * delay_s <= row.longest_delay_s
    )
    return min(rows, default=None)


def remark(cell: Cell) -> str:
    """Say what a person must know who asks for the adaptive law; empty: it holds everywhere."""
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
        f"at {loop} the adaptive law holds from {softest:g} N/m on: on softer contacts the plain "
        "law's gain is used"
    )
