"""Limits of commanded motion: speed and acceleration are kept for any target."""

from dataclasses import replace
from math import dist, hypot, nextafter, radians

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from common.motion.frames import rotation_between
from common.motion.limits import Limits
from common.motion.rate_limiter import (
    REST,
    CommandedMotion,
    at_rest,
    brake,
    limit_motion,
    resting_place,
)
from tests.fakes.arbiter_world import CELL, displaced, pose_at

LIMITS = Limits.of(CELL)
DT_S = 0.004
SLACK = 1.0 + 1e-6
ROUNDING = 1e-7  # of the logarithm of a rotation, per period

spots = hnp.arrays(float, 3, elements=st.floats(-0.2, 0.2))
turns = hnp.arrays(float, 3, elements=st.floats(-0.6, 0.6))
times = st.floats(0.0, 1e-7) | st.floats(1e-6, 0.02)
targets = st.lists(st.tuples(spots, turns, times), min_size=1, max_size=15)


def size(vector: np.ndarray) -> float:
    """Return a length."""
    return float(np.linalg.norm(vector))


def is_at_target(motion: CommandedMotion) -> bool:
    """Return whether the pose is the target."""
    return motion.T_base_flange is motion.T_target


def moved(before: CommandedMotion, after: CommandedMotion) -> tuple[float, float]:
    """Return travel and turn between two periods."""
    a, b = before.T_base_flange, after.T_base_flange
    return size(b.translation - a.translation), size(rotation_between(a.rotation, b.rotation))


# --- speed and acceleration -----------------------------------------------------------------------


FAR = np.array([0.2, 0.0, 0.0])  # drawn targets are rarely on one side for long enough


@example(-FAR, -3.0 * FAR, [(FAR, 3.0 * FAR, 0.02)] * 15)
@given(spots, turns, targets)
def test_no_sequence_of_targets_breaks_speed_or_acceleration(p, turn, targets) -> None:
    """However wild and irregular: each step within its speed, each change of speed within its."""
    motion = at_rest(pose_at(p, turn))
    for p_target, turn_target, dt_s in targets:
        after = limit_motion(LIMITS, motion, pose_at(p_target, turn_target), dt_s)
        travel_m, turn_rad = moved(motion, after)
        assert travel_m <= LIMITS.speed_m_s * dt_s * SLACK + 1e-12
        assert turn_rad <= LIMITS.speed_rad_s * dt_s * SLACK + ROUNDING
        assert dist(after.speeds[0], motion.speeds[0]) <= LIMITS.accel_m_s2 * dt_s * SLACK + 1e-9
        change_rad_s = dist(after.speeds[1], motion.speeds[1])
        assert change_rad_s <= LIMITS.accel_rad_s2 * dt_s * SLACK + 1e-9
        assert dt_s < 1e-6 or travel_m == pytest.approx(hypot(*after.speeds[0]) * dt_s, abs=1e-12)
        motion = after


@settings(max_examples=25)
@given(spots, turns)
def test_a_constant_target_is_reached_and_not_passed(p_target, turn_target) -> None:
    """From rest: it arrives, to the very pose, and never goes farther by more than rounding."""
    motion, T_target = at_rest(pose_at(np.zeros(3), np.zeros(3))), pose_at(p_target, turn_target)
    travel_m, turn_rad = size(p_target), size(turn_target)
    for _ in range(3000):
        motion = limit_motion(LIMITS, motion, T_target, DT_S)
        start = motion.T_base_flange
        assert size(start.translation) <= travel_m + 1e-5
        assert size(rotation_between(np.eye(3), start.rotation)) <= turn_rad + 1e-4
        if is_at_target(motion) and motion.is_at_rest:
            break
    assert motion.T_base_flange is T_target


# --- to the last digit ----------------------------------------------------------------------------

# The demo's limits: 0.25 m/s and 60 degrees/s, 2 m/s2 and 480 degrees/s2.
SPEEDS = (0.25, radians(60.0))
ACCELS = (2.0, radians(480.0))
ORIGIN = pose_at(np.zeros(3), np.zeros(3))
each_kind = pytest.mark.parametrize("kind", [0, 1], ids=["travel", "turn"])


def moving(kind: int, speed: float, T_target: pin.SE3 = ORIGIN) -> CommandedMotion:
    """Return a pace at the origin that goes in x, or turns about z."""
    speeds = ((speed * (1 - kind), 0.0, 0.0), (0.0, 0.0, speed * kind))
    return CommandedMotion(ORIGIN, T_target, speeds)


def place_and_speed(kind: int, motion: CommandedMotion) -> tuple[float, float]:
    """Return how far a pace is, and how fast it goes there."""
    if kind == 0:
        return float(motion.T_base_flange.translation[0]), motion.speeds[0][0]
    turn_rad = rotation_between(np.eye(3), motion.T_base_flange.rotation)
    return float(turn_rad[2]), motion.speeds[1][2]


@each_kind
def test_rest_is_slower_than_a_billionth_of_the_unit(kind: int) -> None:
    """1 nm/s is rest, the next number is not; at rest no pace lags."""
    for sign in (1.0, -1.0):
        assert moving(kind, sign * 1e-9).is_at_rest
        assert not moving(kind, sign * nextafter(1e-9, 1.0)).is_at_rest
    assert not at_rest(ORIGIN).lags


@each_kind
def test_in_less_than_a_microsecond_nothing_moves(kind: int) -> None:
    """The target is stored; in a microsecond it moves."""
    before, T_target = moving(kind, 0.1), displaced(kind, 0.01)
    after = limit_motion(LIMITS, before, T_target, nextafter(1e-6, 0.0))
    assert (after.T_base_flange, after.T_target) == (before.T_base_flange, T_target)
    assert place_and_speed(kind, after) == (0.0, 0.1)
    assert place_and_speed(kind, limit_motion(LIMITS, before, T_target, 1e-6))[0] > 0.0


@each_kind
@pytest.mark.parametrize("periods", [1, 2, 5])
@pytest.mark.parametrize("share", [0.0, 0.3, -0.3])
def test_a_target_is_approached_as_fast_as_it_can_be_braked(
    kind: int, periods: int, share: float
) -> None:
    """As it moves, too: each step is slower by the acceleration, and the last one ends there."""
    slower, speed = ACCELS[kind] * DT_S, share * SPEEDS[kind]
    place = slower * DT_S * periods * (periods + 1) / 2
    motion = moving(kind, speed + slower * periods, displaced(kind, place))
    for left in range(periods, 0, -1):
        place += speed * DT_S
        motion = limit_motion(LIMITS, motion, displaced(kind, place), DT_S)
        assert place_and_speed(kind, motion)[1] == pytest.approx(speed + slower * left, rel=1e-6)
        still_to_go = slower * DT_S * left * (left - 1) / 2
        assert place_and_speed(kind, motion)[0] == pytest.approx(place - still_to_go, abs=1e-9)


@each_kind
def test_a_target_that_is_nearer_than_the_slowest_step_is_reached_in_one(kind: int) -> None:
    """Exactly, and not passed."""
    near = 0.5 * ACCELS[kind] * DT_S * DT_S
    assert is_at_target(limit_motion(LIMITS, at_rest(ORIGIN), displaced(kind, near), DT_S))
    before = CommandedMotion(ORIGIN, displaced(kind, near), REST)
    assert is_at_target(limit_motion(LIMITS, before, displaced(kind, near), DT_S))


@each_kind
def test_a_target_that_jumps_back_and_is_still_ahead_is_not_run_away_from(kind: int) -> None:
    """Its speed counts up to the limit alone: a jump is no continued motion."""
    ahead = 0.2 * SPEEDS[kind]
    before = CommandedMotion(ORIGIN, displaced(kind, 2.0 * ahead), REST)
    motion = limit_motion(LIMITS, before, displaced(kind, ahead), DT_S)
    assert place_and_speed(kind, motion)[1] == pytest.approx(ACCELS[kind] * DT_S)


@each_kind
def test_braking_takes_off_the_acceleration_in_each_period(kind: int) -> None:
    """Down to rest; a pace that brakes does not lag."""
    slower = ACCELS[kind] * DT_S
    motion, travel = moving(kind, 3.5 * slower), 0.0
    for left in (2.5, 1.5, 0.5, 0.0, 0.0):
        motion, travel = brake(LIMITS, motion, DT_S), travel + left * slower * DT_S
        assert place_and_speed(kind, motion) == pytest.approx((travel, left * slower), abs=1e-12)
        assert not motion.lags
    assert motion.is_at_rest


@each_kind
def test_braking_for_no_time_changes_neither_pose_nor_speed(kind: int) -> None:
    """Two periods may have one time stamp: the speed may change by nothing, and by no 0/0."""
    assert place_and_speed(kind, brake(LIMITS, moving(kind, 0.1), 0.0)) == (0.0, 0.1)


@pytest.mark.parametrize(
    ("speed", "turning", "half_s"),
    [(0.2, 0.0, 0.05), (0.0, 0.8, 0.4 / ACCELS[1]), (0.2, 0.1, 0.05), (0.01, 0.8, 0.4 / ACCELS[1])],
)
def test_a_motion_rests_after_half_of_its_speed_for_the_time_it_brakes(
    speed: float, turning: float, half_s: float
) -> None:
    """Its square over 2 a; travel and turn end together, after the longer time of both."""
    motion = CommandedMotion(ORIGIN, ORIGIN, ((0.0, speed, 0.0), (0.0, 0.0, turning)))
    T = resting_place(LIMITS, motion)
    assert T.translation == pytest.approx([0.0, speed * half_s, 0.0])
    assert rotation_between(np.eye(3), T.rotation) == pytest.approx([0.0, 0.0, turning * half_s])


@each_kind
@pytest.mark.parametrize("dt_s", [0.004, 0.1])
def test_a_pace_lags_when_it_is_behind_by_more_than_full_speed_takes_to_brake(
    kind: int, dt_s: float
) -> None:
    """Or by more than a period at full speed, where periods are long."""
    speed, accel = SPEEDS[kind], ACCELS[kind]
    farthest = max(speed * dt_s, 0.5 * speed**2 / accel)
    first = accel * dt_s * dt_s  # what it goes in the first period, from rest
    for share, lags in ((1.0 - 1e-6, False), (1.0 + 1e-6, True)):
        T_target = displaced(kind, first + share * farthest)
        motion = limit_motion(LIMITS, at_rest(ORIGIN), T_target, dt_s)
        assert place_and_speed(kind, motion)[0] == pytest.approx(first)
        assert motion.lags == lags


@pytest.mark.parametrize(
    ("kind", "speed_rad_s", "dt_s", "first", "behind"),
    [
        (0, SPEEDS[1], 0.004, 2.0 * 0.004**2, 0.015625),  # 0.25 m/s braked with 2 m/s2
        (0, SPEEDS[1], 0.125, 2.0 * 0.125**2, 0.03125),  # a period at 0.25 m/s
        (1, 0.5, 0.125, 0.0625, 0.0625),  # a period at 0.5 rad/s
    ],
)
def test_a_pace_that_is_behind_by_the_limit_itself_does_not_lag(
    kind: int, speed_rad_s: float, dt_s: float, first: float, behind: float
) -> None:
    """By the next number it does: in numbers that a difference and a rotation give back exactly."""
    limits, farthest = replace(LIMITS, speed_rad_s=speed_rad_s), first + behind
    for amount, lags in ((farthest, False), (nextafter(farthest, 1.0), True)):
        motion = limit_motion(limits, at_rest(ORIGIN), displaced(kind, amount), dt_s)
        assert motion.lags is lags
