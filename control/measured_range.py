"""Measured range of the laws: loop rate, delay and contact stiffness. Data.

Releases from 30 N in the bench (bench/force); no contact of a row overshot by more than
5 %.

Adaptive law: each row is the slowest loop, the longest delay and the softest contact. At 15 and
30 Hz and 60 ms, contacts of 1e3 and 2e3 N/m overshoot by 9 to 20 %. Below the softest contact of
its row the law uses the plain law's gain, which is safe for every softer contact; outside all rows
the plain law runs.

Plain law with the gain rule's gains (`tuned_plain`), 0 to 150 ms of delay: in loops slower than
125 Hz contacts softer than 5e3 N/m overshot by up to 28 %: inertia caps the gain there, and that
cap ignores the loop period.
"""

from math import inf
from typing import NamedTuple

from common.config.cell import CellConfig


class AdaptiveRange(NamedTuple):
    """Slowest loop, longest delay, and the softest contact there."""

    slowest_hz: float
    longest_delay_s: float
    softest_N_m: float


ADAPTIVE = (
    AdaptiveRange(60.0, 0.060, 1e3),
    AdaptiveRange(125.0, 0.070, 1e3),
    AdaptiveRange(15.0, 0.030, 2e3),
    AdaptiveRange(15.0, 0.120, 5e3),
)


class SegmentRange(NamedTuple):
    """Longest least segment, and there: stiffest contact, fastest rise of its force."""

    longest_s: float
    stiffest_N_m: float
    force_rate_N_s: float  # stiffness times approach speed


# Force control over TCP: the table `bears` of docs/results/over-tcp.json.
SEGMENTS = (
    SegmentRange(0.016, 1e5, 112.0),
    SegmentRange(0.020, 1e5, 112.0),
    SegmentRange(0.030, 1e5, 112.0),
    SegmentRange(0.045, 3e4, 75.0),
    SegmentRange(0.060, 3e4, 56.0),
)
ROUNDING_MOST_N = 1.0  # of a set point in the gateway's packet, at the contact's stiffness
PLAIN = ((125.0, 1e3), (15.0, 5e3))  # slowest loop [Hz] and softest contact [N/m]
LONGEST_TAU_S, STIFFEST_N_M = 0.17, 2e5  # of the plain law
SAME = 1.0 - 1e-6  # tolerance of numbers typed with fewer digits


def softest_N_m(cell: CellConfig) -> float | None:
    """Return the softest contact the adaptive law is valid for in a cell [N/m]; None: none."""
    rate_hz, delay_s = cell.plant.loop_hz, cell.robot.delay_s
    rows = (
        row.softest_N_m
        for row in ADAPTIVE
        if rate_hz >= SAME * row.slowest_hz and SAME * delay_s <= row.longest_delay_s
    )
    return min(rows, default=None)


def restriction(cell: CellConfig) -> str:
    """Return the restriction of the adaptive law in a cell, empty when there is none."""
    softest = softest_N_m(cell)
    loop = f"{cell.plant.loop_hz:g} Hz and {cell.robot.delay_s * 1e3:g} ms of delay"
    if softest is None:
        longest_ms = max(row.longest_delay_s for row in ADAPTIVE) * 1e3
        slowest_hz = min(row.slowest_hz for row in ADAPTIVE)
        return (
            f"the adaptive law was never measured at {loop} (down to {slowest_hz:g} Hz, up to "
            f"{longest_ms:g} ms): the plain law runs in its place"
        )
    if softest <= min(row.softest_N_m for row in ADAPTIVE):
        return ""
    return (
        f"at {loop} the adaptive law is valid from {softest:g} N/m upwards: softer contacts use "
        "the plain law's gain"
    )


def segment_range(segment_s: float) -> SegmentRange | None:
    """Return what a controller with such segments bears; None: none as long were measured."""
    rows = [row for row in SEGMENTS if SAME * segment_s <= row.longest_s]
    return min(rows, default=None)


def segment_approach_m_s(cell: CellConfig) -> float:
    """Return the fastest approach that the segments of a cell's controller bear [m/s].

    Infinite without segments, and where arming refuses the contact for another reason.
    """
    if cell.gateway is None or cell.gateway.protocol == "plain":
        return inf
    row = segment_range(cell.gateway.least_segment_s)
    return inf if row is None else SAME * row.force_rate_N_s / cell.contact.stiffness_N_m


def range_violation(loop_hz: float, tau_s: float, stiffness_N_m: float) -> str:
    """Return what is outside the plain law's range and the remedy, empty when nothing is.

    Args:
        loop_hz: Loop rate, the slower one of regulator and robot.
        tau_s: Loop delay.
        stiffness_N_m: Contact stiffness.
    """
    contacts = [softest for slowest_hz, softest in PLAIN if loop_hz >= SAME * slowest_hz]
    if not contacts:
        return (
            f"too slow: the loop runs at {loop_hz:g} Hz, the law was measured down to "
            f"{min(PLAIN)[0]:g} Hz (rates.control_hz, rates.robot_hz)"
        )
    if SAME * tau_s > LONGEST_TAU_S:
        return (
            f"too slow: the loop delay is {1e3 * tau_s:.0f} ms, the law was measured up to "
            f"{1e3 * LONGEST_TAU_S:.0f} ms: shorten the controller's smoothing and the link's delay"
        )
    if SAME * stiffness_N_m > STIFFEST_N_M:
        return (
            f"too stiff: {stiffness_N_m:.3g} N/m, the law was measured up to {STIFFEST_N_M:g}: put "
            "a compliant element between the tool and the contact"
        )
    softest = min(contacts)
    if stiffness_N_m < SAME * softest:
        return (
            f"too soft: {stiffness_N_m:.3g} N/m, at {loop_hz:g} Hz the law was measured from "
            f"{softest:g} N/m: keep contact.stiffness_N_m at {softest:g} or above, "
            "its gains are safe on softer contacts"
        )
    return ""
