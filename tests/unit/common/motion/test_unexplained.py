"""Unexplained motion: quiet at rest, in noise and after a run-out; finds every creep."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.config.cell import CellConfig
from common.config.load import load_cell
from common.motion.frames import rotation_from_vector
from common.motion.unexplained import (
    REST_POSITION_M,
    RUN_OUT_S,
    ARM_STIFFNESS_N_m,
    UnexplainedMotion,
    reach_of,
    rest_bounds,
)
from forcemesh.clock import NS_PER_S
from forcemesh.messages import Trip
from tests.contract.robots import plain_cell
from tests.fakes.bench import CELL, DEMO

REPORT_S = 1.0 / CELL.rates.robot_hz
X_M, Y_RAD = rest_bounds(CELL)
RESTED_S = 0.5  # longer than it takes to have rested
Unit = st.floats(-1.0, 1.0)


def pose(x_m: float = 0.0, turn_rad: float = 0.0, axis: int = 0) -> pin.SE3:
    """Return a pose that far away, and turned by that much, along and about one axis."""
    direction = np.eye(3)[axis]
    return pin.SE3(rotation_from_vector(turn_rad * direction), x_m * direction)


class Reported:
    """A monitor and the time of its reports."""

    def __init__(self, cell: CellConfig = CELL) -> None:
        self.monitor, self.at_ns = UnexplainedMotion(cell), 10**12  # a clock that has run long
        self.period_s = 1.0 / cell.rates.robot_hz

    def report(self, T: pin.SE3, times: int = 1) -> Trip | None:
        """Report a pose; return the last verdict."""
        trip = None
        for _ in range(times):
            self.at_ns += round(self.period_s * NS_PER_S)
            trip = self.monitor.judge(T, self.at_ns)
        return trip

    def rest(self, T: pin.SE3) -> "Reported":
        """Report one pose until it is the rest pose."""
        assert self.report(T, round(RESTED_S / REPORT_S)) is None
        return self


@given(st.lists(st.tuples(Unit, Unit, st.integers(0, 2)), min_size=1, max_size=60))
def test_whatever_stays_within_the_bounds_is_quiet(shares: list[tuple[float, float, int]]) -> None:
    """Noise, drift and springing in contact, in any order and in every axis."""
    reported = Reported().rest(pose())
    for x, turn, axis in shares:
        assert reported.report(pose(0.999 * x * X_M, 0.999 * turn * Y_RAD, axis)) is None


@given(
    speed_m_s=st.floats(1e-4, 0.25), at_once=st.booleans(), turns=st.booleans(),
    axis=st.integers(0, 2), noise=st.integers(0, 2**32 - 1),
)  # fmt: skip
def test_every_creep_is_found(
    speed_m_s: float,
    at_once: bool,
    turns: bool,
    axis: int,
    noise: int,
) -> None:
    """From rest, or at once after the last command: at the latest X beyond the longest run-out."""
    reported, random = Reported(), np.random.default_rng(noise)
    if not at_once:
        reported.rest(pose())
    bound_m = X_M + 2.0 * REST_POSITION_M + speed_m_s * (RUN_OUT_S * at_once + 5 * REPORT_S)
    for gone_m in np.arange(0.0, bound_m + X_M / 4, max(speed_m_s * REPORT_S, X_M / 2000)):
        wrong_m = gone_m + random.uniform(-0.5, 0.5) * REST_POSITION_M
        place = pose(0.0, wrong_m * Y_RAD / X_M, axis) if turns else pose(wrong_m, 0.0, axis)
        step = max(1, round(X_M / 2000 / (speed_m_s * REPORT_S)))
        if (trip := reported.report(place, step)) is not None:
            assert gone_m > 0.9 * X_M
            assert trip.code == "unexplained_motion"
            assert trip.unit == ("rad" if turns else "m")
            return
    pytest.fail(f"{bound_m * 1e3:.2f} mm of motion were not found")


@pytest.mark.parametrize("kind", [0, 1])
@pytest.mark.parametrize(("share", "is_found"), [(0.99, False), (1.01, True), (np.nan, True)])
def test_the_bounds(kind: int, share: float, is_found: bool) -> None:
    """Either alone; a pose that is no number is not near."""
    there = pose(share * X_M * (1 - kind), share * Y_RAD * kind)
    assert (Reported().rest(pose()).report(there, 10) is not None) == is_found


def test_three_reports_in_a_row_decide_and_a_repeated_one_is_one() -> None:
    """One outlier is none; a motion that was found stays until something explains it."""
    far = pose(2.0 * X_M)
    reported = Reported().rest(pose())
    for _ in range(3):
        assert reported.report(far, 2) is None
        assert reported.monitor.judge(far, reported.at_ns) is None
        assert reported.report(pose()) is None
    assert reported.report(far, 3) is not None
    assert reported.report(pose(), 10) is not None
    reported.monitor.explain()
    assert reported.rest(far).report(far, 10) is None


@pytest.mark.parametrize("decay_s", [0.05, 0.3])
def test_a_run_out_is_no_unexplained_motion(decay_s: float) -> None:
    """50 mm of braking, and of a slow end, after the last command."""
    reported = Reported()
    for number in range(round(4.0 / REPORT_S)):
        assert reported.report(pose(0.05 * np.exp(-number * REPORT_S / decay_s))) is None


def test_the_bounds_follow_from_the_cell() -> None:
    """Force ceiling and scales; whole millimetres are coarser than the reach of a goal."""
    force_N = 58.0
    other = load_cell(DEMO, {"limits.force_N": force_N})
    saved_m = X_M - rest_bounds(other).position_m
    assert saved_m == pytest.approx(2.0 * (CELL.limits.force_N - force_N) / ARM_STIFFNESS_N_m)
    fine = plain_cell()
    names = ("position_per_mm", "oat_per_deg", "joint_per_deg")
    whole = plain_cell(**{f"gateway.plain.{name}": 1 for name in names})
    assert rest_bounds(fine).position_m < X_M < rest_bounds(whole).position_m < 6e-3
    assert rest_bounds(fine).rotation_rad < Y_RAD < rest_bounds(whole).rotation_rad < 0.1


def test_the_bounds_by_hand() -> None:
    """2 (0.5 + 0.2 + 60 N / 1e5 N/m) mm, and 2 (3 + 2 + (10 + 0.3 * 60) N m / 1e4 N m/rad) mrad."""
    cell = load_cell(DEMO, {"limits.force_N": 60.0, "limits.torque_Nm": 10.0})
    assert rest_bounds(cell) == pytest.approx((2.6e-3, 15.6e-3))


@pytest.mark.parametrize(("oat", "joint"), [(2, 50), (50, 2)])
def test_the_coarser_angle_decides_how_near_a_goal_must_come(oat: int, joint: int) -> None:
    """1.75 units of half a degree."""
    cell = plain_cell(**{"gateway.plain.oat_per_deg": oat, "gateway.plain.joint_per_deg": joint})
    assert cell.gateway is not None
    assert reach_of(cell.gateway.plain).rotation_rad == pytest.approx(np.radians(1.75 / 2))


@pytest.mark.parametrize(
    ("delay_s", "lag_s", "robot_hz", "rests_s"),
    [(0.02, 0.01, 250.0, 0.372), (0.1, 0.05, 100.0, 0.63), (0.0, 0.02, 50.0, 0.4)],
)
def test_a_pose_counts_as_rest_after_its_time(delay_s, lag_s, robot_hz, rests_s) -> None:
    """0.3 s, twice delay and lag, and three reports at one pose; a shorter stay is none."""
    values = {"robot.delay_s": delay_s, "robot.lag_s": lag_s, "rates.robot_hz": robot_hz}
    cell = load_cell(DEMO, values)

    def finds(after_s: float) -> bool:
        reported = Reported(cell)
        assert reported.report(pose(), 1 + round(after_s * robot_hz)) is None
        return reported.report(pose(2.0 * X_M), 3) is not None

    assert finds(rests_s + 2.0 / robot_hz)
    assert not finds(rests_s - 2.0 / robot_hz)


def test_a_creeping_arm_has_rested_after_three_seconds() -> None:
    """From then on its travel counts: it is found X later."""
    reported, step_m, number = Reported(), 1.5 * REST_POSITION_M, 0
    while reported.report(pose(number * step_m)) is None:
        number += 1
    assert number * REPORT_S == pytest.approx(3.0 + (X_M / step_m + 3.0) * REPORT_S, abs=0.02)
