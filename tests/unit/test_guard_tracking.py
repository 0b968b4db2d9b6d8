"""H41: the arm is not where it was commanded. Never said of one that follows, however late."""

from math import radians

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.config import load_cell
from common.frames import rotation_from_vector
from common.tracking import Tracking
from tests.contract.rig import DEMO_CELL, shifted

CELL = load_cell(DEMO_CELL, {"rates.robot_hz": 50})
DOWN = pin.SE3(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.5, 0.3]))
HOME = (0.0, 0.0, -1.5, 0.0, -1.5, 0.0)
MS = 1_000_000
REPORT_MS = 20
LIMIT_M = CELL.limits.tracking_m
# As common/tracking.py has them; written out, so that a change there is seen here.
PERIODS = 5
ALLOWED_S = 2.0 * (CELL.robot.delay_s + CELL.robot.lag_s) + 0.1


def streamed(speed_m_s: float, delay_ms: int, follows: float, ms: int = 2000) -> str:
    """Stream up for a while; the arm does a share of it, late. Return the rule that tripped."""
    tracking = Tracking(CELL)
    for now_ms in range(0, ms, 4):
        tracking.stream(shifted(DOWN, z_m=speed_m_s * now_ms * 1e-3), now_ms * MS)
        if now_ms % REPORT_MS == 0:
            z_m = follows * speed_m_s * max(0, now_ms - delay_ms) * 1e-3
            trip = tracking.judge(shifted(DOWN, z_m=z_m), HOME, now_ms * MS)
            if trip is not None:
                return trip.code
    return ""


@given(st.floats(0.0, 0.25), st.integers(0, round(ALLOWED_S * 1e3)))
@settings(max_examples=30, deadline=None)
def test_an_arm_that_follows_within_its_delay_is_never_off(speed_m_s: float, delay_ms: int) -> None:
    """Whatever the speed, and whatever the delay up to twice the cell's and a tenth of a second."""
    assert streamed(speed_m_s, delay_ms, follows=1.0) == ""


@pytest.mark.parametrize("follows", [0.0, -1.0, 0.2])
def test_an_arm_that_stays_goes_back_or_falls_behind_is_off(follows: float) -> None:
    """20 mm/s for two seconds are 40 mm."""
    assert streamed(0.02, 0, follows) == "tracking"


@given(st.integers(1, 40))
@settings(max_examples=20, deadline=None)
def test_five_reports_may_be_off_and_the_sixth_in_a_row_is_a_trip(off: int) -> None:
    """One that is right again begins the count anew."""
    tracking, away = Tracking(CELL), shifted(DOWN, x_m=1.1 * LIMIT_M)
    tracking.rest(DOWN, moving=False)
    trips = [tracking.judge(away, HOME, number * MS) for number in range(off)]
    assert [trip is not None for trip in trips] == [k >= PERIODS for k in range(off)]
    assert tracking.judge(DOWN, HOME, off * MS) is None
    assert tracking.judge(away, HOME, off * MS) is None


def verdict(tracking: Tracking, T: pin.SE3, q: tuple[float, ...] = HOME) -> str:
    """What is said of an arm that stays in a place."""
    trips = [tracking.judge(T, np.array(q), number * MS) for number in range(PERIODS + 1)]
    return "" if trips[-1] is None else trips[-1].code


@pytest.mark.parametrize(
    ("x_m", "y_m", "turn_deg", "rule"),
    [
        (0.0, 0.0, 0.0, ""),
        (0.1, 0.009, 0.0, ""),
        (0.2, 0.0, 0.0, ""),
        (0.1, 0.011, 0.0, "tracking"),
        (-0.011, 0.0, 0.0, "tracking"),
        (0.211, 0.0, 0.0, "tracking"),
        (0.1, 0.0, 4.9, ""),
        (0.1, 0.0, 5.1, "tracking"),
    ],
)
def test_a_straight_move_stays_on_its_line(
    x_m: float, y_m: float, turn_deg: float, rule: str
) -> None:
    """However fast it goes: beside the line, behind its start and beyond its end it is off."""
    tracking = Tracking(CELL)
    tracking.line(DOWN, shifted(DOWN, x_m=0.2))
    R = rotation_from_vector(np.array([0.0, radians(turn_deg), 0.0])) @ DOWN.rotation
    assert verdict(tracking, pin.SE3(R, shifted(DOWN, x_m, y_m).translation)) == rule


@pytest.mark.parametrize(
    ("share", "beside_deg", "rule"),
    [(0.0, 0.0, ""), (0.5, 4.9, ""), (0.5, 5.1, "tracking"), (1.2, 0.0, "tracking")],
)
def test_a_move_of_the_joints_keeps_their_proportion(
    share: float, beside_deg: float, rule: str
) -> None:
    """All start and arrive together; the flange's pose is not looked at."""
    way = np.array([0.5, -0.4, 0.0, 0.0, 0.0, 0.3])
    tracking = Tracking(CELL)
    tracking.turn(HOME, np.array(HOME) + way)
    q = np.array(HOME) + share * way + np.array([0.0, 0.0, radians(beside_deg), 0.0, 0.0, 0.0])
    assert verdict(tracking, shifted(DOWN, x_m=0.3), tuple(q)) == rule


def test_nothing_is_compared_while_the_arm_brakes_or_the_controller_leads() -> None:
    """Where it comes to rest is where it has to stay."""
    tracking = Tracking(CELL)
    tracking.line(DOWN, shifted(DOWN, x_m=0.2))
    tracking.rest(shifted(DOWN, y_m=0.1), moving=True)
    assert verdict(tracking, shifted(DOWN, y_m=0.2)) == ""
    tracking.rest(shifted(DOWN, y_m=0.2), moving=False)
    tracking.rest(shifted(DOWN, y_m=0.3), moving=False)
    assert verdict(tracking, shifted(DOWN, y_m=0.3)) == "tracking"
    tracking.free()
    assert verdict(tracking, shifted(DOWN, y_m=0.3)) == ""
