"""H41: the arm is not where it was commanded. Never reported of one that follows, however late."""

from collections.abc import Callable
from math import nextafter, radians

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.config.load import load_cell
from common.motion.frames import rotation_from_vector
from common.motion.tracking import TrackingMonitor
from tests.contract.rig import DEMO_CELL, shifted

CELL = load_cell(DEMO_CELL, {"rates.robot_hz": 50})
DOWN = pin.SE3(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.5, 0.3]))
HOME = (0.0, 0.0, -1.5, 0.0, -1.5, 0.0)
MS = 1_000_000
REPORT_MS = 20
# As common/motion/tracking.py has them; written out, so that a change there fails here.
PERIODS = 5
ALLOWED_S = 2.0 * (CELL.robot.delay_s + CELL.robot.lag_s) + 0.1


def streamed(speed_m_s: float, delay_ms: int, follows: float, ms: int = 2000) -> str:
    """Stream up for a while; the arm does a share of it, late. Return the rule that tripped."""
    tracking = TrackingMonitor(CELL)
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


def verdict(tracking: TrackingMonitor, T: pin.SE3, q: tuple[float, ...] = HOME) -> str:
    """Return the verdict on an arm that stays in a place."""
    trips = [tracking.judge(T, np.array(q), number * MS) for number in range(PERIODS + 1)]
    return "" if trips[-1] is None else trips[-1].code


@pytest.mark.parametrize(
    ("x_m", "y_m", "turn_deg", "rule"),
    [
        (0.0, 0.0, 0.0, ""),
        (0.1, 0.009, 0.0, ""),
        (0.17, 0.0, 0.0, ""),
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
    """However fast it goes: off the line, behind its start and beyond its end it is off."""
    tracking = TrackingMonitor(CELL)
    tracking.line(DOWN, shifted(DOWN, x_m=0.2))
    R = rotation_from_vector(np.array([0.0, radians(turn_deg), 0.0])) @ DOWN.rotation
    assert verdict(tracking, pin.SE3(R, shifted(DOWN, x_m, y_m).translation)) == rule


@pytest.mark.parametrize(
    ("share", "off_deg", "rule"),
    [(0.0, 0.0, ""), (0.5, 4.9, ""), (0.5, 5.1, "tracking"), (1.2, 0.0, "tracking")],
)
def test_a_move_of_the_joints_keeps_their_proportion(
    share: float, off_deg: float, rule: str
) -> None:
    """All start and arrive together; the flange's pose is not checked."""
    travel = np.array([0.5, -0.4, 0.0, 0.0, 0.0, 0.3])
    tracking = TrackingMonitor(CELL)
    tracking.joint_move(HOME, np.array(HOME) + travel)
    q = np.array(HOME) + share * travel + np.array([0.0, 0.0, radians(off_deg), 0.0, 0.0, 0.0])
    assert verdict(tracking, shifted(DOWN, x_m=0.3), tuple(q)) == rule


# --- to the last digit ----------------------------------------------------------------------------


def verdict_at(tracking: TrackingMonitor, T: pin.SE3, now_ns: int) -> str:
    """Return the rule that trips where six equal reports come at one time."""
    trips = [tracking.judge(T, HOME, now_ns) for _ in range(PERIODS + 1)]
    return "" if trips[-1] is None else trips[-1].code


@pytest.mark.parametrize(("robot_hz", "delay_ns"), [(50, 161_400_000), (250, 145_400_000)])
def test_an_older_set_point_counts_for_the_delay_to_the_nanosecond(
    robot_hz: int, delay_ns: int
) -> None:
    """Twice delay and lag, a report and a tenth of a second: here 2 * (10 + 10.7) + 20 + 100 ms."""
    cell = load_cell(DEMO_CELL, {"rates.robot_hz": robot_hz})
    for late_ns, rule in ((delay_ns - 1, ""), (delay_ns, "tracking")):
        for before in ([], [shifted(DOWN, y_m=0.1), shifted(DOWN, y_m=0.2)]):
            tracking = TrackingMonitor(cell)
            for number, T in enumerate([*before, DOWN]):
                tracking.stream(T, number * MS)
            tracking.stream(shifted(DOWN, x_m=0.1), 1000 * MS)
            assert verdict_at(tracking, DOWN, 1000 * MS + late_ns) == rule
            assert verdict_at(tracking, shifted(DOWN, x_m=0.1), 1000 * MS + late_ns) == ""


CORNERS = np.array([[0.0, 0.0], [0.05, 0.05], [0.1, 0.0], [0.15, 0.05]])  # x and y of set points


def zigzag() -> tuple[TrackingMonitor, list[pin.SE3]]:
    """Return a monitor with four set points, each turned farther, and the set points."""
    places = [
        pin.SE3(rotation_from_vector(np.array([0.0, 0.0, 0.4 * k])) @ DOWN.rotation,
                DOWN.translation + np.array([x_m, y_m, 0.0]))
        for k, (x_m, y_m) in enumerate(CORNERS)
    ]  # fmt: skip
    tracking = TrackingMonitor(CELL)
    for number, T in enumerate(places):
        tracking.stream(T, number * MS)
    return tracking, places


@pytest.mark.parametrize("oldest", [0, 1, 2, 3])
def test_of_the_set_points_within_the_delay_each_counts(oldest: int) -> None:
    """Also one that is right in its place while another is in its turn."""
    tracking, places = zigzag()
    assert verdict_at(tracking, places[oldest], 10 * MS) == ""
    assert verdict_at(tracking, shifted(places[oldest], z_m=0.011), 10 * MS) == "tracking"
    other = pin.SE3(places[oldest].rotation, places[3 - oldest].translation)
    assert verdict_at(tracking, other, 10 * MS) == ""


@pytest.mark.parametrize(
    ("a", "b", "rule"),
    [(0, 1, ""), (1, 2, ""), (2, 3, ""), (0, 2, "tracking"), (1, 3, "tracking")],
)
def test_between_two_set_points_the_arm_may_be_that_follow_each_other(
    a: int, b: int, rule: str
) -> None:
    """Midway from one to the next, and on no short cut."""
    x_m, y_m = 0.5 * (CORNERS[a] + CORNERS[b])
    assert verdict_at(zigzag()[0], shifted(DOWN, x_m, y_m), 10 * MS) == rule


def test_the_distance_of_the_cell_is_allowed_to_the_last_digit() -> None:
    """10 mm and 5 degrees; a larger distance is named with its size and the limit."""
    at_rest = pin.SE3(np.eye(3), np.zeros(3))
    for x_m, found in ((0.01, None), (nextafter(0.01, 1.0), nextafter(0.01, 1.0))):
        tracking = TrackingMonitor(CELL)
        tracking.rest(at_rest, moving=False)
        away = shifted(at_rest, x_m=x_m)
        trip = [tracking.judge(away, HOME, k * MS) for k in range(PERIODS + 1)][-1]
        assert (trip and trip.value) == found
        assert trip is None or (trip.limit, "10.0 mm away" in trip.text) == (0.01, True)
    for q_rad, found in ((radians(5.0), None), (nextafter(radians(5.0), 1.0), radians(5.0))):
        tracking = TrackingMonitor(CELL)
        tracking.joint_move((0.0,) * 6, (0.0,) * 6)
        q = np.array([0.0, 0.0, q_rad, 0.0, 0.0, 0.0])
        trip = [tracking.judge(at_rest, q, k * MS) for k in range(PERIODS + 1)][-1]
        assert (trip and trip.limit) == found
        assert trip is None or (trip.value, "5.0 degrees away" in trip.text) == (q_rad, True)


def test_an_arm_that_is_turned_is_reported_by_its_angle_where_its_place_is_allowed() -> None:
    """10 mm away it may be, to the last digit; 6 degrees turned it may not."""
    tracking = TrackingMonitor(CELL)
    tracking.rest(pin.SE3(np.eye(3), np.zeros(3)), moving=False)
    away = pin.SE3(rotation_from_vector(np.array([0.0, 0.0, radians(6.0)])), np.array([0.01, 0, 0]))
    trip = [tracking.judge(away, HOME, k * MS) for k in range(PERIODS + 1)][-1]
    assert trip is not None
    assert (trip.value, trip.limit) == (pytest.approx(radians(6.0)), radians(5.0))


# --- from one motion to the next ------------------------------------------------------------------

BENT = (0.5, 0.0, -1.5, 0.0, -1.5, 0.0)
COMMANDS: dict[str, Callable[[TrackingMonitor, pin.SE3], None]] = {
    "stream": lambda tracking, T: tracking.stream(T, 5000 * MS),
    "line": lambda tracking, T: tracking.line(T, shifted(T, z_m=0.02)),
    "turn": lambda tracking, T: tracking.joint_move(HOME, HOME),
    "rest": lambda tracking, T: tracking.rest(T, moving=False),
}
FREE: dict[str, Callable[[TrackingMonitor, pin.SE3], None]] = {
    "new": lambda tracking, T: None,
    "free": lambda tracking, T: tracking.free(),
    "braking": lambda tracking, T: tracking.rest(T, moving=True),
}
CHANGES = [(a, b) for a in (COMMANDS | FREE) for b in COMMANDS if a != b]


@pytest.mark.parametrize(("first", "then"), CHANGES)
def test_commands_before_another_motion_do_not_count(first: str, then: str) -> None:
    """Neither its place nor its reports: five more may be off, and the sixth is a trip."""
    tracking, before, now = TrackingMonitor(CELL), shifted(DOWN, x_m=-0.2), shifted(DOWN, x_m=0.2)
    (COMMANDS | FREE)[first](tracking, before)
    for number in range(PERIODS):
        assert tracking.judge(shifted(DOWN, y_m=0.2), np.array(BENT), number * MS) is None
    COMMANDS[then](tracking, now)
    trips = [tracking.judge(before, np.array(BENT), 5000 * MS) for _ in range(PERIODS + 1)]
    assert [trip is not None for trip in trips] == [False] * PERIODS + [True]
    assert tracking.judge(now, HOME, 5000 * MS) is None
    trips = [tracking.judge(before, np.array(BENT), 5000 * MS) for _ in range(PERIODS + 1)]
    assert [trip is not None for trip in trips] == [False] * PERIODS + [True]
