"""Processes that stand still: the force stays within its promises, or the arm holds in contact."""

import itertools
import random

import pytest

from bench.results import Row
from bench.stalls import CASES, PROCESSES, Draw, drawn, play
from forcemesh.clock import NS_PER_S
from tests.fakes.long import long

NAMES = [f"{case['law']}-{case['stiffness_N_m']:g}" for case in CASES]
TOUCHES_S = (0.04, long(0.06), 0.08, long(0.1), 0.12, long(0.14), 0.16)  # after the near plate


@pytest.mark.parametrize("seed", [0, 1, *(long(seed) for seed in range(2, 12))])
@pytest.mark.parametrize("case", CASES, ids=NAMES)
def test_the_force_keeps_its_promises_under_seeded_stalls(case: Row, seed: int) -> None:
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


@pytest.mark.parametrize("lead_s", [long(-0.008), -0.002, 0.0, long(0.008), 0.03])
@pytest.mark.parametrize("stall_s", [long(0.01), 0.03, 0.06])
@pytest.mark.parametrize("process", [*map(long, PROCESSES[:3]), *PROCESSES[3:]])
def test_a_start_during_a_stall_does_not_lift_off(
    process: str, stall_s: float, lead_s: float
) -> None:
    """Found: 60 ms of the arbiter lifted off by 111 %: what it had not released was executed."""
    found = play(CASES[2], once(1e3, process, stall_s), lead_s)
    assert found.is_good, found
    assert not found.held
    assert found.press > 0.9


@pytest.mark.parametrize("process", ["wrench", "all"])
def test_a_start_on_stale_data_is_refused_and_the_arm_stays(process: str) -> None:
    """Found: the bench ended with the refusal."""
    found = play(CASES[2], once(1e3, process, 0.12), 0.115)
    assert found.held
    assert found.is_good, found


@pytest.mark.parametrize("seed", [0, 1, *(long(seed) for seed in range(2, 12))])
@pytest.mark.parametrize("case", CASES[2:], ids=NAMES[2:])
def test_processes_that_wake_a_little_late_change_nothing(case: Row, seed: int) -> None:
    """Found: the arbiter's limits, by its own clock, made 24 % of overshoot out of such delays."""
    found = play(case, wakes_late(seed))
    assert not found.held
    assert 0.9 < found.press < 1.05, found
    assert found.lift < 0.01, found


def wakes_late(seed: int) -> Draw:
    """Return delays of one to four periods of a millisecond, of one process after the other."""
    rng = random.Random(seed)

    def draw() -> tuple[int, str, int]:
        after_ns = round(rng.uniform(0.0, 0.006) * NS_PER_S)
        return after_ns, rng.choice(PROCESSES), rng.choice((1, 1, 2, 3, 4)) * 1_000_000

    return draw


def once(pause_s: float, who: str, duration_s: float) -> Draw:
    """Return one stall, and none after it."""
    stalls = itertools.chain([(pause_s, duration_s)], itertools.repeat((1e3, 0.0)))

    def draw() -> tuple[int, str, int]:
        after_s, for_s = next(stalls)
        return round(after_s * NS_PER_S), who, round(for_s * NS_PER_S)

    return draw
