"""Measured range of the plain law with the gain rule's gains: data, as adaptive_map.py. Pure.

Releases from 30 N in the bench (`World` of bench/force, `tuned_plain`), 0 to 150 ms of delay, 15 to
250 Hz: each settled, and overshot by 5 % at most. In loops slower than 125 Hz contacts softer than
5e3 N/m overshot by up to 28 %: inertia caps the gain there, and that cap ignores the loop period.
"""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class PlainRange:
    """Slowest loop, and the softest contact with at most 5 % overshoot there."""

    slowest_hz: float
    softest_N_m: float


MEASURED = (PlainRange(125.0, 1e3), PlainRange(15.0, 5e3))
LONGEST_TAU_S = 0.17
STIFFEST_N_M = 2e5
SAME = 1.0 - 1e-6  # tolerance of numbers typed with fewer digits


def range_violation(loop_hz: float, tau_s: float, stiffness_N_m: float) -> str:
    """Return which quantity is outside the measured range and the remedy, empty when none is.

    Args:
        loop_hz: Loop rate, the slower one of regulator and robot.
        tau_s: Loop delay.
        stiffness_N_m: Contact stiffness.
    """
    softest = [row.softest_N_m for row in MEASURED if loop_hz >= SAME * row.slowest_hz]
    if not softest:
        slowest_hz = min(row.slowest_hz for row in MEASURED)
        return (
            f"too slow: the loop runs at {loop_hz:g} Hz, the law was measured down to "
            f"{slowest_hz:g} Hz (rates.control_hz, rates.robot_hz)"
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
    if stiffness_N_m < SAME * min(softest):
        return (
            f"too soft: {stiffness_N_m:.3g} N/m, at {loop_hz:g} Hz the law was measured from "
            f"{min(softest):g} N/m: keep contact.stiffness_N_m at {min(softest):g} or above, "
            "its gains are safe on softer contacts"
        )
    return ""
