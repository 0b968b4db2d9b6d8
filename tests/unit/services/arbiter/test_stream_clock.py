"""Time base of streamed set points: smooth motion stays as it is; wrong stamps gain nothing."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.motion.limits import ArmBounds, Limits
from common.motion.rate_limiter import CommandedMotion, at_rest
from services.arbiter.stream import SampleClock, Tick, follow
from tests.fakes.arbiter_world import CELL, PERIOD_NS, T_START

LIMITS = replace(Limits.of(CELL), step_m=10.0)
BOUNDS = ArmBounds(LIMITS, CELL.tool.T_flange_tcp.pose, T_START)
LONGEST_NS = 3 * PERIOD_NS
MS = 1_000_000
USED = 0.95  # of the acceleration, by the regulator

gaps = st.lists(st.integers(1 * MS, LONGEST_NS), min_size=1, max_size=40)


class Follower:
    """The arbiter's stream, stepped at any times."""

    def __init__(self) -> None:
        """Rest at the start."""
        self.motion: CommandedMotion = at_rest(T_START)
        self.clock = SampleClock(0, 0)
        self.now_ns = 0

    def step(self, wake_ns: int, stamp_ns: int, height_m: float) -> float:
        """Follow a target above the start; return the height of the set point [m]."""
        self.now_ns += wake_ns
        longest_s = LONGEST_NS / 1e9
        self.clock, dt_s = self.clock.next(stamp_ns, self.now_ns, longest_s)
        tick = Tick(T_START, self.now_ns, wake_ns / 1e9, longest_s)
        followed = follow(self.motion, above(height_m), BOUNDS, tick, dt_s=dt_s)
        assert isinstance(followed, CommandedMotion), followed
        self.motion = followed
        return float(followed.T_base_flange.translation[2] - T_START.translation[2])


def above(height_m: float) -> pin.SE3:
    """Return a pose above the start."""
    return pin.SE3(T_START.rotation, T_START.translation + np.array([0.0, 0.0, height_m]))


def ramp(gaps_ns: list[int]) -> list[tuple[int, float]]:
    """Return stamps and heights of a motion that accelerates, then brakes, within the limits."""
    height_m, speed_m_s, stamp_ns, path = 0.0, 0.0, 0, [(0, 0.0)]
    for number, gap_ns in enumerate(gaps_ns):
        dt_s = gap_ns / 1e9
        change_m_s = USED * LIMITS.accel_m_s2 * dt_s
        is_up = number < len(gaps_ns) // 2
        next_m_s = speed_m_s + change_m_s if is_up else max(speed_m_s - change_m_s, 0.0)
        speed_m_s = min(next_m_s, 0.9 * LIMITS.speed_m_s)
        height_m, stamp_ns = height_m + speed_m_s * dt_s, stamp_ns + gap_ns
        path.append((stamp_ns, height_m))
    return path


@given(gaps, st.lists(st.integers(0, 6 * MS), min_size=41, max_size=41))
def test_a_motion_within_the_limits_is_followed_whenever_the_arbiter_wakes(
    gaps_ns: list[int], delays_ns: list[int]
) -> None:
    """Found: wake-ups of 3.3 and 5 ms in turn made 25 % of overshoot out of a smooth release."""
    follower = Follower()
    for (stamp_ns, height_m), delay_ns in zip(ramp(gaps_ns), delays_ns, strict=False):
        wake_ns = max(stamp_ns + delay_ns - follower.now_ns, 1)
        assert abs(follower.step(wake_ns, stamp_ns, height_m) - height_m) < 1e-9
        assert not follower.motion.lags
        assert abs(follower.step(1, stamp_ns, height_m) - height_m) < 1e-9  # the same target again


def passed_ms(clock: SampleClock, steps: int, *, stamp_ms: int, now_ms: int) -> float:
    """Return the time that a clock gives for steps of these lengths [ms]."""
    total_s = 0.0
    for _ in range(steps):
        stamp_ns, now_ns = clock.stamp_ns + stamp_ms * MS, clock.now_ns + now_ms * MS
        clock, dt_s = clock.next(stamp_ns, now_ns, LONGEST_NS / 1e9)
        total_s += dt_s
    return 1e3 * total_s


def test_fast_stamps_gain_the_lead_and_no_more() -> None:
    """Twice as fast as the arbiter's clock, twenty steps of it; after a silence as much again."""
    longest_ms = LONGEST_NS / MS
    clock = SampleClock(5_000 * MS, 3_000 * MS)
    assert passed_ms(clock, 20, stamp_ms=8, now_ms=4) == pytest.approx(80.0 + longest_ms)
    silent, _ = clock.next(clock.stamp_ns, clock.now_ns + 500 * MS, LONGEST_NS / 1e9)
    assert passed_ms(silent, 20, stamp_ms=8, now_ms=4) == pytest.approx(80.0 + 2.0 * longest_ms)
    assert passed_ms(clock, 20, stamp_ms=4, now_ms=4) == pytest.approx(80.0)
    assert passed_ms(clock, 20, stamp_ms=3, now_ms=4) == pytest.approx(60.0)


def test_a_target_that_stood_for_long_has_brought_the_arm_to_rest() -> None:
    """The motion does not go on from the speed of long ago."""
    follower = Follower()
    for stamp_ns, height_m in ramp([PERIOD_NS] * 12)[:7]:
        follower.step(PERIOD_NS, stamp_ns, height_m)
    assert not follower.motion.is_at_rest
    height_m = follower.step(50 * MS, follower.clock.stamp_ns + 50 * MS, height_m)
    assert follower.motion.is_at_rest
    assert abs(height_m - ramp([PERIOD_NS] * 12)[6][1]) < 1e-9
