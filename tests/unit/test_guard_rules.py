"""What the last check counts over time, what it asks of the arm itself, of moves and of forces."""

import random

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.config import load_cell
from common.convert import record_of
from common.guard import MEASURED_SLACK_M, Guard
from common.messages import Feedback, Gains, Goal, Speed, Trip, WrenchAtTcp
from tests.contract.rig import DEMO_CELL, shifted

CELL = load_cell(DEMO_CELL, {"limits.tether_m": 0.3})
LIMITS = CELL.limits
DOWN = pin.SE3(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.5, 0.3]))
JOINTS = (0.0, 0.0, -1.5, 0.0, -1.5, 0.0)
MS = 1_000_000
# What docs/reliability.md says, not what the code under test does.
SPEED_MARGIN, ACCEL_MARGIN, WINDOW_S, HALF_S, EARLY_S = 1.25, 1.5, 0.25, 0.06, 0.02


def code(trip: Trip | None) -> str:
    """The rule, or nothing."""
    return "" if trip is None else trip.code


def guard_at(T: pin.SE3 = DOWN, now_ns: int = 0) -> Guard:
    """A guard whose lease and stream begin at a pose."""
    guard = Guard(CELL)
    guard.start(T)
    assert guard.seed(T, now_ns) is None
    return guard


# --- over time ------------------------------------------------------------------------------------


def test_to_and_fro_within_60_ms_is_no_rest() -> None:
    """The mean velocity is nothing, the way is not: it counts as the start that it is."""
    most_m = ACCEL_MARGIN * LIMITS.accel_m_s2 * HALF_S**2 + LIMITS.speed_m_s * EARLY_S
    guard, away = guard_at(), shifted(DOWN, x_m=0.6 * most_m)
    assert code(guard.setpoint(away, DOWN, 20 * MS)) == ""
    assert code(guard.setpoint(DOWN, away, 40 * MS)) == "acceleration"


@given(st.integers(0, 2**32), st.floats(0.2, 20.0), st.booleans())
@settings(max_examples=60, deadline=None)
def test_whatever_is_asked_for_no_window_gets_more_way_than_the_limit_gives(
    seed: int, factor: float, renews: bool
) -> None:
    """Any rhythm, any steps, new leases and new streams in between: a flood gains nothing."""
    rng, guard, T, now_ns = random.Random(seed), guard_at(), DOWN, 0
    let_through: list[tuple[int, float]] = []
    for _ in range(300):
        now_ns += rng.choice((0, 0, 1, 1, 4, 20)) * MS
        if renews and rng.random() < 0.2:
            guard.start(T)
            if guard.seed(T, now_ns) is not None:
                continue
        way_m = rng.uniform(0.0, factor * LIMITS.speed_m_s * 4e-3)
        wanted = shifted(T, **{rng.choice(("x_m", "y_m")): rng.choice((-1, 1)) * way_m})
        if guard.setpoint(wanted, T, now_ns) is None:
            let_through.append((now_ns, way_m))
            T = wanted
    for at_ns, _ in let_through:
        window = [way for then, way in let_through if 0 <= at_ns - then < WINDOW_S * 1e9]
        assert sum(window) <= SPEED_MARGIN * LIMITS.speed_m_s * WINDOW_S + 1e-9


def test_a_new_lease_brings_no_new_way() -> None:
    """A hundred leases at one instant together get the one step that time had earned."""
    guard, T, way_m = guard_at(), DOWN, 0.0
    for _ in range(100):
        guard.start(T)
        guard.seed(T, 0)
        wanted = shifted(T, x_m=0.002)
        if guard.setpoint(wanted, T, 0) is None:
            T, way_m = wanted, way_m + 0.002
    assert way_m <= LIMITS.step_m + 1e-9


@pytest.mark.parametrize(("share", "rule"), [(0.99, ""), (1.01, "acceleration")])
def test_a_sudden_set_point_is_refused_below_the_step_too(share: float, rule: str) -> None:
    """From rest; the limit is the cell's, with what a late message may look like beside it."""
    most_m = ACCEL_MARGIN * LIMITS.accel_m_s2 * HALF_S**2 + LIMITS.speed_m_s * EARLY_S
    assert most_m < LIMITS.step_m / 1.2
    guard = guard_at()
    assert code(guard.setpoint(shifted(DOWN, x_m=share * most_m), DOWN, 4 * MS)) == rule


@given(st.floats(0.01, 1.0), st.floats(0.02, 1.0), st.integers(1, 8), st.integers(0, 2**16))
@settings(max_examples=40, deadline=None)
def test_a_stream_within_the_limits_is_never_stopped(
    speed: float, accel: float, period_ms: int, seed: int
) -> None:
    """Any share of both limits, messages up to 10 ms late, there and back."""
    guard, rng = guard_at(), random.Random(seed)
    accel_m_s2, speed_m_s = accel * LIMITS.accel_m_s2, speed * LIMITS.speed_m_s
    x_m, v_m_s, towards, T = 0.0, 0.0, 1.0, DOWN
    for number in range(1, 1500 // period_ms):
        if abs(x_m) > 0.1:
            towards = -np.sign(x_m)
        change = accel_m_s2 * period_ms * 1e-3
        v_m_s = float(np.clip(v_m_s + towards * change, -speed_m_s, speed_m_s))
        x_m += v_m_s * period_ms * 1e-3
        late_ms = rng.choice((0.0, 0.0, 0.0, 2.0, 10.0))
        wanted = shifted(DOWN, x_m=x_m)
        at_ns = max(round((number * period_ms + late_ms) * MS), 0)
        assert guard.setpoint(wanted, T, at_ns) is None
        T = wanted


# --- the arm itself -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("x_m", "rule"),
    [
        (LIMITS.workspace_max_m[0] + 0.5 * MEASURED_SLACK_M, ""),
        (LIMITS.workspace_max_m[0] + 1.5 * MEASURED_SLACK_M, "workspace"),
        (float("nan"), "not_finite"),
    ],
)
def test_an_arm_outside_its_limits_is_noticed(x_m: float, rule: str) -> None:
    """With a little beside them, for what settles and rounds."""
    guard = guard_at(shifted(DOWN, x_m=0.3))
    T = pin.SE3(DOWN.rotation, np.array([x_m, 0.5, 0.3]))
    assert code(guard.arm(T, JOINTS, 0)) == rule


def test_an_arm_that_left_its_tether_or_a_joint_range_is_noticed() -> None:
    """Measured, whoever moved it."""
    assert code(guard_at().arm(shifted(DOWN, x_m=0.31), JOINTS, 0)) == "tether"
    assert code(guard_at().arm(DOWN, (0.0, 0.0, 0.0, 0.0, 0.0, 6.4), 0)) == "joint"


@pytest.mark.parametrize(("share", "rule"), [(0.9, ""), (1.3, "joint_speed")])
@pytest.mark.parametrize("period_ms", [4, 25, 60])
def test_a_joint_that_turns_too_fast_is_noticed(share: float, rule: str, period_ms: int) -> None:
    """Over a tenth of a second, whatever the rate of the reports."""
    guard, rules = guard_at(), set()
    speed = share * np.radians(CELL.robot.joint_speed_max_deg_s[4])
    for now_ms in range(0, 300, period_ms):
        q = (0.0, 0.0, -1.5, 0.0, -1.5 + speed * now_ms * 1e-3, 0.0)
        rules.add(code(guard.arm(DOWN, q, now_ms * MS)))
    assert rules - {""} - {"joint"} == ({rule} - {""})


def test_a_plane_is_kept_for_commands_and_a_little_wider_for_the_arm() -> None:
    """The tool may not be commanded behind it, and may not be found far behind it."""
    plane = {"point_m": [0.0, 0.0, 0.1], "normal": [0.0, 0.0, 1.0]}
    guard = Guard(load_cell(DEMO_CELL, {"limits.planes": [plane]}))
    guard.start(DOWN)
    tool_at_the_plane = shifted(DOWN, z_m=-0.04)
    guard.seed(tool_at_the_plane, 0)
    below = shifted(tool_at_the_plane, z_m=-0.001)
    assert code(guard.setpoint(below, tool_at_the_plane, MS)) == "workspace"
    assert code(guard.arm(below, JOINTS, 0)) == ""
    assert code(guard.arm(shifted(below, z_m=-0.002), JOINTS, 0)) == "workspace"


# --- moves, force feedback, the wrench ------------------------------------------------------------


def test_a_straight_move_that_swings_the_tool_out_is_refused_though_its_end_is_inside() -> None:
    """Half a turn about y passes where the tool points sideways, beyond the wall."""
    R = pin.utils.rotate("y", np.pi * 0.999) @ DOWN.rotation
    end = pin.SE3(R, np.array([0.0, 0.5, 0.1]))
    cell = load_cell(DEMO_CELL, {"limits.workspace_max_m": [0.1, 0.8, 0.6],
                                 "limits.workspace_min_m": [-0.1, 0.2, -0.2]})  # fmt: skip
    guard = Guard(cell)
    # Armed half-way, so that both ends are on the tether.
    guard.start(pin.SE3(pin.utils.rotate("y", np.pi * 0.5) @ DOWN.rotation, end.translation))
    trip = guard.goal(Goal(id=1, kind="pose", pose=record_of(end)), Speed(), DOWN, JOINTS)
    assert trip is not None
    assert (trip.code, "on the way" in trip.text) == ("workspace", True)


def test_a_move_of_the_joints_is_judged_by_where_the_tool_goes_where_that_is_known() -> None:
    """Without the arm's geometry only the joints' ranges are."""
    turned = Goal(id=1, kind="joints", joint_rad=(1.0, 0.0, -1.5, 0.0, -1.5, 0.0))

    def flange_at(q: np.ndarray) -> pin.SE3:
        return shifted(DOWN, x_m=float(q[0]))

    for geometry, rule in ((None, ""), (flange_at, "workspace")):
        guard = Guard(load_cell(DEMO_CELL), geometry)
        guard.start(DOWN)
        assert code(guard.goal(turned, Speed(), DOWN, JOINTS)) == rule


@pytest.mark.parametrize(
    ("press_N", "lever_m", "rule"),
    [
        (39.0, 0.0, ""),
        (41.0, 0.0, "setpoint"),
        (0.0, 0.29, ""),
        (0.0, 0.31, "malformed"),
    ],
)
def test_force_feedback_is_asked_for_within_bounds(
    press_N: float, lever_m: float, rule: str
) -> None:
    """The set point, and the point to turn about; speeds are kept by the controller."""
    feedback = Feedback(
        mode="both",
        setpoint_force_N=(0.0, press_N, 0.0),
        lever_m=(0.0, 0.0, lever_m),
        gains=Gains(),
    )
    assert code(guard_at().feedback(feedback)) == rule


def test_the_ceilings_count_where_a_wrench_is_known() -> None:
    """60 N and 10 N m in this cell."""
    guard = guard_at()
    assert guard.wrench(None) is None
    assert guard.wrench(WrenchAtTcp(force_N=(0.0, 59.0, 0.0))) is None
    assert code(guard.wrench(WrenchAtTcp(force_N=(0.0, 61.0, 0.0)))) == "force"
    assert code(guard.wrench(WrenchAtTcp(torque_Nm=(0.0, 0.0, 10.1)))) == "torque"
