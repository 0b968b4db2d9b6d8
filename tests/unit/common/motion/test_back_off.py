"""The travel out of a load or off a wall, and its limits, whatever is measured. Pure."""

from math import hypot, radians

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.config.cell import PlaneSection
from common.config.load import load_cell
from common.motion import back_off
from common.motion.arm_check import ARBITER_SLACK, ROBOT_SLACK, ArmCheck, Slack
from common.motion.back_off import (
    LONGEST_BACK_OFF_M,
    RISE_N,
    SPEED_M_S,
    BackOffPlan,
    LoadRatchet,
    RISE_Nm,
    motion_trip,
)
from common.motion.convert import record_of
from common.motion.frames import rotation_from_vector
from common.motion.limits import Limits, check_workspace
from forcemesh.messages import Goal, Speed, Trip, Vec3, WrenchAtTcp
from tests.contract.rig import DEMO_CELL, shifted

CELL = load_cell(DEMO_CELL)
LIMITS = Limits.of(CELL)
TOOL = CELL.tool.T_flange_tcp.pose
DOWN = pin.SE3(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.5, 0.3]))
JOINTS = (0.0, 0.0, -1.5, 0.0, -1.5, 0.0)
MS = 1_000_000
SLOW = Speed(mechanical_m_s=SPEED_M_S)

numbers = st.floats(-200.0, 200.0)
vectors = st.tuples(numbers, numbers, numbers)
spots = st.tuples(st.floats(-1.0, 1.0), st.floats(-0.5, 1.5), st.floats(-0.5, 1.5))
turns = st.tuples(*[st.floats(-1.7, 1.7)] * 3)


def wrench_of(force_N: Vec3 = (0.0, 0.0, 0.0), torque_Nm: Vec3 = (0.0, 0.0, 0.0)) -> WrenchAtTcp:
    """Return a wrench that counts."""
    return WrenchAtTcp(calibrated=True, force_N=force_N, torque_Nm=torque_Nm)


def plan(T: pin.SE3, wrench: WrenchAtTcp | None, *, confirmed: bool = False) -> BackOffPlan | Trip:
    """Return the travel out in the demo's cell."""
    return back_off.plan(LIMITS, T, TOOL, wrench, confirmed=confirmed)


def code(found: BackOffPlan | Trip | None) -> str:
    """Return the rule, or the kind of the plan."""
    if found is None:
        return ""
    return found.code if isinstance(found, Trip) else found.kind


# --- the travel -----------------------------------------------------------------------------------


@given(spots, turns, vectors, vectors, st.booleans(), st.booleans())
@settings(max_examples=300, deadline=None)
def test_a_back_off_is_short_worsens_nothing_and_turns_nothing(
    p, turn, force_N, torque_Nm, known, confirmed
) -> None:
    """Whatever is measured and wherever the arm is."""
    T = pin.SE3(rotation_from_vector(np.array(turn)), np.array(p))
    wrench = wrench_of(force_N, torque_Nm) if known else None
    found = plan(T, wrench, confirmed=confirmed)
    if isinstance(found, Trip):
        return
    end = found.goal(T)
    assert np.array_equal(end.rotation, T.rotation)
    travel_m = float(np.linalg.norm(end.translation - T.translation))
    assert travel_m <= (back_off.BLIND_M if found.kind == "blind" else LONGEST_BACK_OFF_M) + 1e-9
    before, after = (T * TOOL).translation, (end * TOOL).translation
    low, high = (
        np.minimum(LIMITS.workspace_min_m, before),
        np.maximum(LIMITS.workspace_max_m, before),
    )
    assert ((after >= low - 1e-9) & (after <= high + 1e-9)).all()
    if found.kind == "force":
        assert wrench is not None
        assert back_off.is_loaded(LIMITS, wrench)
        cosine = float(found.travel_m @ np.array(force_N)) / travel_m / hypot(*force_N)
        assert cosine > 0.8
    if found.kind == "blind":
        assert confirmed


@pytest.mark.parametrize(
    ("wrench", "confirmed", "kind"),
    [
        (wrench_of((0.0, 0.0, 75.0)), False, "force"),
        (wrench_of((40.0, 0.0, 40.0)), True, "force"),  # a second confirmation changes no direction
        (wrench_of((0.0, 0.0, 29.0)), False, "already"),
        (wrench_of((0.0, 0.0, 10.0), (0.0, 0.0, 6.0)), False, "force"),
        (wrench_of((0.0, 0.0, 4.0), (0.0, 0.0, 6.0)), False, "no_direction"),
        (wrench_of((0.0, 0.0, 4.0), (0.0, 0.0, 6.0)), True, "blind"),
        (wrench_of((0.0, 0.0, -75.0)), False, "no_direction"),  # it would press forward
        (wrench_of((0.0, 0.0, -75.0)), True, "blind"),
        (None, False, "no_direction"),
        (None, True, "blind"),
        (WrenchAtTcp(force_N=(0.0, 0.0, 75.0)), False, "no_direction"),
        (WrenchAtTcp(force_N=(0.0, 0.0, 75.0)), True, "blind"),
    ],
)
def test_the_followed_direction(wrench: WrenchAtTcp | None, confirmed: bool, kind: str) -> None:
    """The tool points down: a push upwards comes from below."""
    assert code(plan(DOWN, wrench, confirmed=confirmed)) == kind


def test_a_tool_outside_goes_straight_back_in() -> None:
    """12 mm beyond a wall: 13 mm back, so that it is inside; 50 mm beyond: 20 mm."""
    wall_m = float(LIMITS.workspace_max_m[0])
    for beyond_m, travel_m in ((0.012, 0.013), (0.05, LONGEST_BACK_OFF_M)):
        T = pin.SE3(DOWN.rotation, np.array([wall_m + beyond_m, 0.5, 0.3]))
        found = plan(T, wrench_of())
        assert isinstance(found, BackOffPlan)
        assert found.kind == "workspace"
        assert found.travel_m == pytest.approx([-travel_m, 0.0, 0.0])


def test_a_tool_behind_a_plane_backs_off_by_its_normal() -> None:
    """A slanted wall."""
    plane = PlaneSection(point_m=(0.0, 0.0, 0.15), normal=(0.0, 1.0, 2.0))
    changed = CELL.limits.model_copy(update={"planes": (plane,)})
    limits = Limits.of(CELL.model_copy(update={"limits": changed}))
    T = pin.SE3(DOWN.rotation, np.array([0.0, 0.2, 0.20]))
    assert check_workspace(limits, T * TOOL) is not None
    found = back_off.plan(limits, T, TOOL, wrench_of(), confirmed=False)
    assert isinstance(found, BackOffPlan)
    assert found.kind == "workspace"
    assert float(found.travel_m @ limits.planes[0].normal) > 0.0


# --- the ratchet ----------------------------------------------------------------------------------


@given(st.lists(st.tuples(vectors, vectors), min_size=1, max_size=40))
def test_the_ceiling_only_comes_down(samples) -> None:
    """Whatever the wrench does, the force let through is at most 3 N above the least so far."""
    load, lowest_N, lowest_Nm = LoadRatchet(), np.inf, np.inf
    for force_N, torque_Nm in samples:
        wrench = wrench_of(force_N, torque_Nm)
        load, trip = load.after(wrench, "while backing off")
        too_much = hypot(*force_N) > lowest_N + RISE_N or hypot(*torque_Nm) > lowest_Nm + RISE_Nm
        assert (trip is not None) == too_much
        lowest_N, lowest_Nm = min(lowest_N, hypot(*force_N)), min(lowest_Nm, hypot(*torque_Nm))
        assert (load.lowest_N, load.lowest_Nm) == (lowest_N, lowest_Nm)


def test_a_force_that_does_not_fall_is_no_contact() -> None:
    """A lost bias reads the same wherever the tool goes: it ends after half the travel."""
    load, trip, travel_m = LoadRatchet(), None, 0.0
    while trip is None and travel_m < LONGEST_BACK_OFF_M:
        travel_m += 1e-4
        load, trip = load.after(wrench_of((0.0, 0.0, 75.0)), "while backing off")
        T = shifted(DOWN, z_m=travel_m)
        trip = trip or motion_trip(DOWN, T, travel_m / SPEED_M_S, load)
    assert travel_m == pytest.approx(back_off.MUST_FALL_AFTER_M, abs=2e-4)
    assert trip is not None
    assert trip.code == "still_loaded"
    assert "no contact" in trip.text


# --- the robot's own check ------------------------------------------------------------------------


def freed_guard(wrench: WrenchAtTcp | None, T: pin.SE3 = DOWN) -> ArmCheck:
    """Return a check under a lease to back off."""
    guard = ArmCheck(CELL)
    guard.start(T, "back_off")
    assert guard.wrench(wrench) is None
    return guard


def goal_to(T: pin.SE3) -> Goal:
    """Return a goal."""
    return Goal(id=1, kind="pose", pose=record_of(T))


TURNED = pin.SE3(
    rotation_from_vector(np.array([0.0, 0.0, radians(0.5)])) @ DOWN.rotation, DOWN.translation
)


@pytest.mark.parametrize(
    ("T", "speed", "rule"),
    [
        (shifted(DOWN, z_m=0.020), SLOW, ""),
        (shifted(DOWN, z_m=0.010), SLOW, ""),
        (shifted(DOWN, z_m=0.022), SLOW, "state"),
        (shifted(DOWN, z_m=-0.010), SLOW, "state"),
        (shifted(DOWN, x_m=0.010, z_m=0.010), SLOW, "state"),
        (shifted(DOWN, z_m=0.010), Speed(mechanical_m_s=0.006), "speed"),
        (TURNED, SLOW, "state"),
    ],
)
def test_the_robot_takes_the_goal_alone_that_it_would_have_computed(
    T: pin.SE3, speed: Speed, rule: str
) -> None:
    """75 N from below: up, not far, slowly, without a turn."""
    guard = freed_guard(wrench_of((0.0, 0.0, 75.0)))
    assert code(guard.goal(goal_to(T), speed, DOWN, JOINTS)) == rule


def test_the_robot_takes_nothing_but_that_goal() -> None:
    """No joints, no set points; and no goal when there is nothing to get away from."""
    guard = freed_guard(wrench_of((0.0, 0.0, 75.0)))
    joints = Goal(id=1, kind="by", joint_rad=(0.0, 0.0, 0.01, 0.0, 0.0, 0.0))
    assert code(guard.goal(joints, SLOW, DOWN, JOINTS)) == "state"
    assert code(guard.seed(DOWN, 0)) == "state"
    assert code(guard.setpoint(shifted(DOWN, z_m=1e-4), DOWN, 4 * MS)) == "state"
    nowhere = Goal(id=1, kind="pose")
    assert code(guard.goal(nowhere, SLOW, DOWN, JOINTS)) == "state"
    free = freed_guard(wrench_of((0.0, 0.0, 5.0)))
    assert code(free.goal(goal_to(shifted(DOWN, z_m=0.01)), SLOW, DOWN, JOINTS)) == "already"


def test_the_robot_s_ceiling_is_a_ratchet_then_and_the_cell_s_again_afterwards() -> None:
    """75, down to 40, up to 43: and 43.1 is too much, far below the ceiling of 60."""
    guard = freed_guard(wrench_of((0.0, 0.0, 75.0)))
    for force, rule in ((77.9, ""), (40.0, ""), (43.0, ""), (43.1, "force")):
        assert code(guard.wrench(wrench_of((0.0, 0.0, force)))) == rule
    guard.start(DOWN)
    assert guard.wrench(wrench_of((0.0, 0.0, 59.0))) is None
    assert code(guard.wrench(wrench_of((0.0, 0.0, 61.0)))) == "force"


def test_the_robot_watches_travel_and_turn() -> None:
    """An arm that goes farther than 20 mm, or turns, ends the lease."""
    for T, rule in (
        (shifted(DOWN, z_m=0.0205), ""),
        (shifted(DOWN, z_m=0.024), "tether"),
        (pin.SE3(rotation_from_vector(np.array([0.0, radians(2.0), 0.0])) @ DOWN.rotation,
                 DOWN.translation), "tether"),
    ):  # fmt: skip
        guard = freed_guard(wrench_of((0.0, 0.0, 75.0)))
        guard.wrench(wrench_of((0.0, 0.0, 35.0)))
        assert guard.arm(DOWN, JOINTS, 0) is None
        assert code(guard.arm(T, JOINTS, 5000 * MS)) == rule


# --- moves ----------------------------------------------------------------------------------------


def test_a_move_may_not_add_much_to_the_force() -> None:
    """20 N above the least of the move; between moves only the ceiling counts."""
    guard = ArmCheck(CELL)
    guard.start(DOWN)
    for force, in_move, rule in (
        (2.0, True, ""), (21.0, True, ""), (23.0, True, "force"), (23.0, False, ""),
        (40.0, False, ""), (40.0, True, ""), (59.0, True, ""), (10.0, True, ""),
        (31.0, True, "force"),
    ):  # fmt: skip
        assert code(guard.wrench(wrench_of((0.0, 0.0, force)), in_move=in_move)) == rule
    unknown = WrenchAtTcp(force_N=(0.0, 0.0, 55.0))  # the tool's weight, as it turns
    assert guard.wrench(unknown, in_move=True) is None


@pytest.mark.parametrize(
    ("x_m", "rule"), [(0.19e-3, ""), (0.21e-3, "workspace"), (3e-3, "workspace")]
)
def test_the_travel_back_goes_no_farther_beyond_a_wall_than_reports_are_rounded(
    x_m: float, rule: str
) -> None:
    """The tool at the wall, pushed upwards: 0.2 mm aside; the direction alone would let it pass."""
    at_wall = pin.SE3(DOWN.rotation, np.array([0.4, 0.5, 0.3]))
    guard = freed_guard(wrench_of((0.0, 0.0, 75.0)), at_wall)
    goal = goal_to(shifted(at_wall, x_m=x_m, z_m=0.010))
    assert code(guard.goal(goal, SLOW, at_wall, JOINTS)) == rule


def test_the_robot_lets_the_arm_go_back_without_a_force_to_follow() -> None:
    """A person has confirmed it at the arbiter: 5 mm on the tool's axis, which points down."""
    for z_m, rule in ((0.005, ""), (0.0061, "state")):
        guard = freed_guard(None)
        assert code(guard.goal(goal_to(shifted(DOWN, z_m=z_m)), SLOW, DOWN, JOINTS)) == rule


@pytest.mark.parametrize(("slack", "tether_m"), [(ARBITER_SLACK, 0.022), (ROBOT_SLACK, 0.023)])
def test_the_arbiter_ends_a_back_off_that_goes_too_far_before_the_robot_does(
    slack: Slack, tether_m: float
) -> None:
    """Its time counts by the own clock, whatever the robot's clock says."""
    for travel_m, rule in ((tether_m - 1e-4, ""), (tether_m + 1e-4, "tether")):
        check = ArmCheck(CELL, slack)
        check.start(DOWN, "back_off")
        check.wrench(wrench_of((0.0, 0.0, 75.0)))
        check.wrench(wrench_of((0.0, 0.0, 35.0)))
        assert check.arm(DOWN, JOINTS, 0, now_ns=0) is None
        T = shifted(DOWN, z_m=travel_m)
        assert code(check.arm(T, JOINTS, 1, now_ns=5000 * MS)) == rule
        if not rule:
            assert code(check.arm(T, JOINTS, 2, now_ns=10_001 * MS)) == "still_loaded"


def test_backing_off_is_never_faster_than_the_cell_allows() -> None:
    """Also in a cell that is slower than backing off is elsewhere."""
    slow = load_cell(DEMO_CELL, {"limits.speed_m_s": 0.003})
    check = ArmCheck(slow)
    check.start(DOWN, "back_off")
    assert check.wrench(wrench_of((0.0, 0.0, 75.0))) is None
    goal = goal_to(shifted(DOWN, z_m=0.010))
    for speed_m_s, rule in ((0.003, ""), (0.004, "speed")):
        speed = Speed(mechanical_m_s=speed_m_s)
        assert code(check.goal(goal, speed, DOWN, JOINTS)) == rule
