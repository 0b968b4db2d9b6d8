"""Processes that stand still: the force stays within its promises, or the arm holds in contact."""

import itertools
from collections.abc import Callable

import pytest

from bench.stalls import CASES, PROCESSES, StallCase, drawn, play
from forcemesh.clock import NS_PER_S
from tests.fakes.long import long

TOUCHES_S = (0.04, long(0.06), 0.08, long(0.1), 0.12, long(0.14), 0.16)  # after the near plate


@pytest.mark.parametrize("seed", [0, 1, *(long(seed) for seed in range(2, 12))])
@pytest.mark.parametrize("case", CASES, ids=str)
def test_the_force_keeps_its_promises_under_seeded_stalls(case: StallCase, seed: int) -> None:
    """No press beyond 1.3 times the set point, no lift-off beyond 5 % of it."""
    found = play(case, drawn(seed))
    assert found.is_good, found
    assert found.held or found.press > 0.9


@pytest.mark.parametrize("touch_s", TOUCHES_S)
@pytest.mark.parametrize("process", [*map(long, PROCESSES[:3]), *PROCESSES[3:]])
def test_a_process_that_stands_still_around_the_touch_makes_no_peak(
    process: str, touch_s: float
) -> None:
    """Found: 60 ms of the arbiter at the touch pressed with 3.8 times the set point."""
    found = play(CASES[2], once(touch_s, process, 0.06))
    assert found.is_good, found
    assert not found.held
    assert found.press > 0.9


def once(pause_s: float, who: str, duration_s: float) -> Callable[[], tuple[int, str, int]]:
    """Return one stall, and none after it."""
    stalls = itertools.chain([(pause_s, duration_s)], itertools.repeat((1e3, 0.0)))

    def draw() -> tuple[int, str, int]:
        after_s, for_s = next(stalls)
        return round(after_s * NS_PER_S), who, round(for_s * NS_PER_S)

    return draw
