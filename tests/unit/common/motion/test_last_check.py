"""The limits at the last hop: the same laws as the arbiter's, with a state of their own."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from common.config.load import load_cell
from common.motion.convert import record_of
from common.motion.frames import rotation_from_vector
from common.motion.last_check import LastCheck
from common.motion.limits import Limits
from forcemesh.clock import NS_PER_S
from forcemesh.messages import Goal, Speed, Trip
from tests.contract.rig import DEMO_CELL, shifted

CHANGES = {
    "limits.tether_m": 0.2, "limits.step_m": 0.01, "limits.speed_m_s": 0.1, "limits.step_deg": 5,
    "limits.accel_m_s2": 20.0, "limits.accel_deg_s2": 5000.0,
}  # fmt: skip
CELL = load_cell(DEMO_CELL, CHANGES)
LIMITS = Limits.of(CELL)
T_FLANGE_TCP = CELL.tool.T_flange_tcp.pose
DOWN = pin.SE3(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.5, 0.3]))  # TCP 160 mm below
JOINTS = (0.0, 0.0, -1.5, 0.0, -1.5, 0.0)
MS = NS_PER_S // 1000


def guard_at(T: pin.SE3, now_ns: int = 0) -> LastCheck:
    """A guard whose lease and stream begin at a pose."""
    guard = LastCheck(CELL)
    guard.start(T)
    guard.seed(T, now_ns)
    return guard


def code(trip: Trip | None) -> str:
    """The rule, or nothing."""
    return "" if trip is None else trip.code


@pytest.mark.parametrize(
    ("p_m", "rule"),
    [
        ((0.0, 0.5, 0.3), ""),
        ((0.0, 0.509, 0.3), ""),
        ((0.0, 0.511, 0.3), "step"),
        ((0.0, 0.5, -0.05), "workspace"),  # the flange is inside, the tool is not
        ((float("nan"), 0.5, 0.3), "not_finite"),
    ],
)
def test_a_set_point_is_judged_by_tool_step_and_finiteness(
    p_m: tuple[float, float, float], rule: str
) -> None:
    """Workspace counts at the TCP, the step from the measured pose."""
    assert code(guard_at(DOWN).setpoint(pin.SE3(DOWN.rotation, np.array(p_m)), DOWN, 0)) == rule


def test_a_turn_of_one_step_is_refused_above_its_limit() -> None:
    """5 degrees at once, not 5.1."""
    for turn_deg, rule in ((4.9, ""), (5.1, "step")):
        R = rotation_from_vector(np.array([0.0, 0.0, np.radians(turn_deg)])) @ DOWN.rotation
        assert code(guard_at(DOWN).setpoint(pin.SE3(R, DOWN.translation), DOWN, 0)) == rule


@given(st.floats(0.05, 3.0), st.integers(1, 40))
@example(1.27, 4)
@example(1.27, 40)
def test_a_stream_keeps_the_speed_limit_whatever_its_period(factor: float, period_ms: int) -> None:
    """Below the limit nothing trips; above 1.25 times of it a second is never survived."""
    guard, step_m = guard_at(DOWN), factor * LIMITS.speed_m_s * period_ms * 1e-3
    T, tripped = DOWN, ""
    for number in range(1, 1000 // period_ms + 1):
        T_target = shifted(T, x_m=step_m * (-1) ** (number // 20))
        tripped = code(guard.setpoint(T_target, T, number * period_ms * MS))
        if tripped:
            break
        T = T_target
    if factor <= 1.0 and step_m < LIMITS.step_m:
        assert tripped == ""
    if factor > 1.26:
        assert tripped in {"speed", "step", "rate", "acceleration"}


def test_the_tether_is_fastened_where_the_lease_began() -> None:
    """200 mm from there, however small the steps; a new lease fastens it anew."""
    guard, T, now_ns = guard_at(DOWN), DOWN, 0
    rules: list[str] = []
    while not rules or rules[-1] == "":
        now_ns += 100 * MS
        T_target = shifted(T, x_m=0.0051)
        rules.append(code(guard.setpoint(T_target, T, now_ns)))
        T = T_target
    assert (len(rules), rules[-1]) == (40, "tether")  # 39 * 5.1 = 198.9 mm
    guard.start(T)
    guard.seed(T, now_ns)
    assert guard.setpoint(shifted(T, x_m=0.005), T, now_ns + 100 * MS) is None


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_tool_that_is_turned_on_and_on_is_stopped_by_its_tether(axis: int, sign: float) -> None:
    """Small turns that no other limit minds, until it is turned too far from how it was armed."""
    cell = load_cell(DEMO_CELL)
    guard, T, turned_deg, rule = LastCheck(cell), DOWN, 0.0, ""
    guard.start(T)
    guard.seed(T, 0)
    while rule == "" and turned_deg < 720.0:
        turned_deg += 0.5
        R = rotation_from_vector(np.radians(sign * turned_deg) * np.eye(3)[axis]) @ DOWN.rotation
        tip = DOWN * T_FLANGE_TCP
        T_target = pin.SE3(R, tip.translation) * pin.SE3(np.eye(3), -T_FLANGE_TCP.translation)
        rule = code(guard.setpoint(T_target, T, round(turned_deg * 100 * MS)))
        T = T_target
    assert rule == "tether"
    assert turned_deg == pytest.approx(cell.limits.tether_deg, abs=0.51)
    assert code(guard.arm(pin.SE3(T.rotation, DOWN.translation), JOINTS, 0)) in ("", "tether")


def test_a_goal_that_turns_the_tool_too_far_is_refused() -> None:
    """170 degrees from how it was armed; 140 it may."""
    for turn_deg, rule in ((140.0, ""), (170.0, "tether")):
        R = DOWN.rotation @ rotation_from_vector(np.array([0.0, 0.0, np.radians(turn_deg)]))
        goal = Goal(id=1, kind="pose", pose=record_of(pin.SE3(R, DOWN.translation)))
        assert code(guard_at(DOWN).goal(goal, Speed(), DOWN, JOINTS)) == rule


@pytest.mark.parametrize(
    ("goal", "rule"),
    [
        (Goal(id=1, kind="pose", pose=record_of(shifted(DOWN, x_m=0.19))), ""),
        (Goal(id=1, kind="pose", pose=record_of(shifted(DOWN, x_m=0.21))), "tether"),
        (Goal(id=1, kind="pose", pose=record_of(shifted(DOWN, x_m=0.41))), "workspace"),
        (Goal(id=1, kind="joints", joint_rad=(0.0, 0.0, 0.0, 0.0, 0.0, 6.2)), ""),
        (Goal(id=1, kind="joints", joint_rad=(0.0, 0.0, 0.0, 0.0, 0.0, 6.4)), "joint"),
        (Goal(id=1, kind="by", joint_rad=(0.0, 0.0, -1.0, 0.0, 0.0, 0.0)), ""),
        (Goal(id=1, kind="by", joint_rad=(0.0, 0.0, -1.5, 0.0, 0.0, 0.0)), "joint"),
        (Goal(id=1, kind="pose"), "malformed"),
        (Goal(id=1, kind="by"), "malformed"),
    ],
)
def test_a_goal_is_judged_at_its_end(goal: Goal, rule: str) -> None:
    """Pose: workspace and tether; joints: their range, relative ones from where they are."""
    assert code(guard_at(DOWN).goal(goal, Speed(), DOWN, JOINTS)) == rule


def test_a_goal_may_not_run_faster_than_the_cell_allows() -> None:
    """Mechanical times modular speed."""
    goal = Goal(id=1, kind="pose", pose=record_of(DOWN))
    for speed, rule in (
        (Speed(mechanical_m_s=0.2, modular_fraction=0.5), ""),
        (Speed(mechanical_m_s=0.2, modular_fraction=0.51), "speed"),
    ):
        assert code(guard_at(DOWN).goal(goal, speed, DOWN, JOINTS)) == rule


def test_without_a_lease_nothing_passes() -> None:
    """A guard that was never started lets nothing through."""
    guard = LastCheck(CELL)
    assert guard.setpoint(DOWN, DOWN, 0) is not None
    assert (
        guard.goal(Goal(id=1, kind="pose", pose=record_of(DOWN)), Speed(), DOWN, JOINTS) is not None
    )
