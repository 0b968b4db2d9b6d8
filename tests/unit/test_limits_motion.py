"""How commanded poses may move: whatever is wished for, speed and acceleration are kept."""

from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from common.frames import rotation_between, rotation_from_vector
from common.limits import Limits
from common.motion_limits import (
    Pace,
    brake,
    limit_motion,
    resting_place,
    still,
)
from tests.fakes.arbiter_world import CELL

LIMITS = Limits.of(CELL)
DT_S = 0.004
SLACK = 1.0 + 1e-6
ROUNDING = 1e-7  # of the logarithm of a rotation, per period

spots = hnp.arrays(float, 3, elements=st.floats(-0.2, 0.2))
turns = hnp.arrays(float, 3, elements=st.floats(-0.6, 0.6))
times = st.floats(0.0, 1e-7) | st.floats(1e-6, 0.02)
wishes = st.lists(st.tuples(spots, turns, times), min_size=1, max_size=15)


def at(p: np.ndarray, turn: np.ndarray) -> pin.SE3:
    """Return a pose."""
    return pin.SE3(rotation_from_vector(turn), np.array(p, dtype=float))


def size(vector: np.ndarray) -> float:
    """Return a length."""
    return float(np.linalg.norm(vector))


def moved(before: Pace, after: Pace) -> tuple[float, float]:
    """Return way and turn between two periods."""
    a, b = before.T_base_flange, after.T_base_flange
    return size(b.translation - a.translation), size(rotation_between(a.rotation, b.rotation))


# --- speed and acceleration -----------------------------------------------------------------------


@given(spots, turns, wishes)
def test_no_sequence_of_wishes_breaks_speed_or_acceleration(p, turn, wishes) -> None:
    """However wild and irregular: each step within its speed, each change of speed within its."""
    pace = still(at(p, turn))
    for p_wished, turn_wished, dt_s in wishes:
        after = limit_motion(LIMITS, pace, at(p_wished, turn_wished), dt_s)
        way_m, turn_rad = moved(pace, after)
        assert way_m <= LIMITS.speed_m_s * dt_s * SLACK + 1e-12
        assert turn_rad <= LIMITS.speed_rad_s * dt_s * SLACK + ROUNDING
        assert size(after.speed_m_s - pace.speed_m_s) <= LIMITS.accel_m_s2 * dt_s * SLACK + 1e-9
        change_rad_s = size(after.turning_rad_s - pace.turning_rad_s)
        assert change_rad_s <= LIMITS.accel_rad_s2 * dt_s * SLACK + 1e-9
        assert dt_s < 1e-6 or way_m == pytest.approx(size(after.speed_m_s) * dt_s, abs=1e-12)
        pace = after


@settings(max_examples=25)
@given(spots, turns)
def test_a_standing_wish_is_reached_and_not_passed(p_wished, turn_wished) -> None:
    """From rest: it arrives, to the very pose, and never goes farther by more than rounding."""
    pace, wish = still(at(np.zeros(3), np.zeros(3))), at(p_wished, turn_wished)
    way_m, turn_rad = size(p_wished), size(turn_wished)
    for _ in range(3000):
        pace = limit_motion(LIMITS, pace, wish, DT_S)
        start = pace.T_base_flange
        assert size(start.translation) <= way_m + 1e-5
        assert size(rotation_between(np.eye(3), start.rotation)) <= turn_rad + 1e-4
        if pace.is_there and pace.is_still:
            break
    assert pace.T_base_flange is wish


@given(speed=st.floats(-1.0, 1.0), start=st.floats(-1.0, 1.0))
def test_a_stream_within_the_limits_is_let_through_untouched(speed: float, start: float) -> None:
    """The very object each period, so the force loop does not feel that there are limits."""
    most_m = LIMITS.accel_m_s2 * DT_S * DT_S
    way_m, y_m, pace = 0.0, 0.1 * start, still(at(np.array([0.0, 0.1 * start, 0.0]), np.zeros(3)))
    for _ in range(20):
        way_m = max(min(way_m + speed * most_m, LIMITS.speed_m_s * DT_S), -LIMITS.speed_m_s * DT_S)
        y_m += 0.999 * way_m
        wish = at(np.array([0.0, y_m, 0.0]), np.zeros(3))
        pace = limit_motion(LIMITS, pace, wish, DT_S)
        assert pace.T_base_flange is wish


@settings(max_examples=25)
@given(st.floats(0.005, 0.15), st.floats(0.002, 0.008))
def test_a_stream_that_starts_at_once_is_caught_up_with(speed_m_s: float, dt_s: float) -> None:
    """After the ramp there is no lag left, and it was not told to go back meanwhile."""
    pace = still(at(np.zeros(3), np.zeros(3)))
    for period in range(1, 400):
        wish = at(np.array([period * dt_s * speed_m_s, 0.0, 0.0]), np.zeros(3))
        pace = limit_motion(LIMITS, pace, wish, dt_s)
        assert not pace.lags
        if pace.is_there:
            break
    assert pace.is_there


def test_a_stream_that_is_too_fast_lags() -> None:
    """The regulator is told to go on from what was let through, before it runs far ahead."""
    pace, farthest_m = still(at(np.zeros(3), np.zeros(3))), 0.5 * LIMITS.speed_m_s**2 / 2.0
    for period in range(1, 400):
        wish = at(np.array([period * DT_S * 1.2 * LIMITS.speed_m_s, 0.0, 0.0]), np.zeros(3))
        pace = limit_motion(LIMITS, pace, wish, DT_S)
        behind_m = size(wish.translation - pace.T_base_flange.translation)
        assert pace.lags == (behind_m > farthest_m)
    assert pace.lags


@given(turns.filter(lambda turn: size(turn) > 0.01), spots)
def test_a_tool_that_turns_about_its_tip_still_does(turn, tip_m) -> None:
    """Way and turn are cut by the same share: in the first period the tip hardly moves."""
    wish = at(tip_m - rotation_from_vector(turn) @ tip_m, turn)
    pace = limit_motion(LIMITS, still(at(np.zeros(3), np.zeros(3))), wish, DT_S)
    T, first_rad = pace.T_base_flange, LIMITS.accel_rad_s2 * DT_S * DT_S
    slip_m = size(T.act(tip_m) - tip_m)

    assert slip_m <= size(turn) * first_rad * size(tip_m) + 1e-9


def test_no_time_means_no_motion() -> None:
    """At dt = 0 the pose and its speed stay."""
    pace = limit_motion(LIMITS, still(at(np.zeros(3), np.zeros(3))), at(np.ones(3), np.ones(3)), 0)
    assert size(pace.T_base_flange.translation) == 0.0
    assert pace.is_still


# --- braking --------------------------------------------------------------------------------------


@given(wishes)
def test_braking_ends_where_it_was_foretold(wishes) -> None:
    """At rest after the shortest time, not beyond the resting place, near to it."""
    pace = still(at(np.zeros(3), np.zeros(3)))
    for p_wished, turn_wished, _ in wishes:
        pace = limit_motion(LIMITS, pace, at(p_wished, turn_wished), DT_S)
    T_from, T_rest = pace.T_base_flange, resting_place(LIMITS, pace)
    periods = 0
    while not pace.is_still:
        after = brake(LIMITS, pace, DT_S)
        assert size(after.speed_m_s - pace.speed_m_s) <= LIMITS.accel_m_s2 * DT_S * SLACK
        pace, periods = after, periods + 1
        assert periods < 200
    way_m = size(T_rest.translation - T_from.translation)
    assert size(pace.T_base_flange.translation - T_from.translation) <= way_m + 1e-12
    assert size(pace.T_base_flange.translation - T_rest.translation) <= (
        LIMITS.speed_m_s * DT_S + 1e-12
    )


def test_a_speed_of_the_regulator_is_reached_in_a_few_periods() -> None:
    """The default acceleration is quick beside the force loop: 50 mm/s in 25 ms."""
    pace, speeds = still(at(np.zeros(3), np.zeros(3))), [0.0]
    for period in range(1, 12):
        wish = at(np.array([period * DT_S * CELL.force.speed_max_m_s, 0.0, 0.0]), np.zeros(3))
        pace = limit_motion(LIMITS, pace, wish, DT_S)
        speeds.append(size(pace.speed_m_s))
    assert all(b - a <= LIMITS.accel_m_s2 * DT_S * SLACK for a, b in pairwise(speeds))
    assert max(speeds[:8]) >= CELL.force.speed_max_m_s
