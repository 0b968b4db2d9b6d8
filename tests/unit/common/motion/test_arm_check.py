"""Check of commands and of the measured arm: the same rules in arbiter and robot process."""

import random
from collections.abc import Callable
from math import nextafter, radians

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.config.load import load_cell
from common.motion.arm_check import ARBITER_SLACK, ROBOT_SLACK, ArmCheck, JointTrack, Slack
from common.motion.convert import record_of
from forcemesh.messages import Feedback, Gains, Goal, Speed, Trip, WrenchAtTcp
from tests.contract.rig import DEMO_CELL, shifted

CELL = load_cell(
    DEMO_CELL,
    {
        "limits.tether_m": 0.3, "limits.step_m": 0.01, "limits.speed_m_s": 0.1,
        "limits.accel_m_s2": 20.0, "limits.accel_deg_s2": 5000.0,
    },
)  # fmt: skip
LIMITS = CELL.limits
DOWN = pin.SE3(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.5, 0.3]))  # TCP 160 mm below
NOWHERE = pin.SE3(np.eye(3), np.full(3, np.nan))
JOINTS = (0.0, 0.0, -1.5, 0.0, -1.5, 0.0)
MS = 1_000_000


def guard_at(T: pin.SE3 = DOWN, now_ns: int = 0) -> ArmCheck:
    """Return a check whose lease and stream begin at a pose."""
    guard = ArmCheck(CELL)
    guard.start(T)
    assert guard.seed(T, now_ns) is None
    return guard


def code(trip: Trip | None) -> str:
    """Return the code of a trip, or nothing."""
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


def test_the_tether_is_fastened_where_the_lease_began() -> None:
    """300 mm from there, however small the steps; a new lease fastens it anew."""
    guard, T, now_ns = guard_at(DOWN), DOWN, 0
    rules: list[str] = []
    while not rules or rules[-1] == "":
        now_ns += 100 * MS
        T_target = shifted(T, x_m=0.0051)
        rules.append(code(guard.setpoint(T_target, T, now_ns)))
        T = T_target
    assert (len(rules), rules[-1]) == (59, "tether")  # 58 * 5.1 = 295.8 mm
    guard.start(T)
    guard.seed(T, now_ns)
    assert guard.setpoint(shifted(T, x_m=0.005), T, now_ns + 100 * MS) is None


@pytest.mark.parametrize(
    ("goal", "rule"),
    [
        (Goal(id=1, kind="pose", pose=record_of(shifted(DOWN, x_m=0.29))), ""),
        (Goal(id=1, kind="pose", pose=record_of(shifted(DOWN, x_m=0.31))), "tether"),
        (Goal(id=1, kind="pose", pose=record_of(shifted(DOWN, x_m=0.41))), "workspace"),
        (Goal(id=1, kind="joints", joint_rad=(0.0, 0.0, 0.0, 0.0, 0.0, 6.2)), ""),
        (Goal(id=1, kind="joints", joint_rad=(0.0, 0.0, 0.0, 0.0, 0.0, 6.4)), "joint"),
        (Goal(id=1, kind="by", joint_rad=(0.0, 0.0, -1.0, 0.0, 0.0, 0.0)), ""),
        (Goal(id=1, kind="by", joint_rad=(0.0, 0.0, -1.5, 0.0, 0.0, 0.0)), "joint"),
        (Goal(id=1, kind="joints", joint_rad=(0.0,) * 7), "joint_count"),
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


# --- over time ------------------------------------------------------------------------------------


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
        T_target = shifted(DOWN, x_m=x_m)
        at_ns = max(round((number * period_ms + late_ms) * MS), 0)
        assert guard.setpoint(T_target, T, at_ns) is None
        T = T_target


# --- the arm itself -------------------------------------------------------------------------------


def tip_at(x_m: float, y_m: float, z_m: float) -> pin.SE3:
    """Return the flange whose tool points down and ends in a place; the tool is 160 mm long."""
    return pin.SE3(DOWN.rotation, np.array([x_m, y_m, z_m + 0.16]))


def turned(turn_deg: float) -> pin.SE3:
    """Return the flange turned about its own axis, which contains the tool."""
    return pin.SE3(pin.utils.rotate("z", radians(turn_deg)) @ DOWN.rotation, DOWN.translation)


def joint_at(number: int, deg: float) -> tuple[float, ...]:
    """Return joint angles of zero but for one, counted from 1."""
    return tuple(radians(deg) * (each == number) for each in range(1, 7))


# The arm within and beyond the slack of each limit, in a cell with a slanted wall.
EDGE_CELL = load_cell(
    DEMO_CELL,
    {
        "limits.tether_m": 0.5,
        "limits.planes": [{"point_m": [-0.35, 0.25, 0.0], "normal": [2.0, 2.0, 0.0]}],
    },
)
PLACES = {
    "x min": ("workspace", tip_at(-0.40199, 0.5, 0.14), tip_at(-0.40201, 0.5, 0.14)),
    "x max": ("workspace", tip_at(0.40199, 0.5, 0.14), tip_at(0.40201, 0.5, 0.14)),
    "z min": ("workspace", tip_at(0.0, 0.5, -0.20199), tip_at(0.0, 0.5, -0.20201)),
    "z max": ("workspace", tip_at(0.0, 0.5, 0.60199), tip_at(0.0, 0.5, 0.60201)),
    "plane": (
        "workspace",
        tip_at(-0.35 - 0.00282, 0.25, 0.14),
        tip_at(-0.35 - 0.00284, 0.25, 0.14),
    ),
    "tether": (
        "tether",
        shifted(DOWN, x_m=0.6 * 0.50199, z_m=0.8 * 0.50199),
        shifted(DOWN, x_m=0.6 * 0.50201, z_m=0.8 * 0.50201),
    ),
    "tether's turn": ("tether", turned(150.499), turned(150.501)),
}


@pytest.mark.parametrize("edge", PLACES)
def test_the_arm_may_be_found_2_mm_and_half_a_degree_beyond_its_limits(edge: str) -> None:
    """At every limit of a place: reports are rounded, and a controller settles."""
    rule, within, beyond = PLACES[edge]
    for T, expected in ((within, ""), (beyond, rule)):
        guard = ArmCheck(EDGE_CELL)
        guard.start(DOWN)
        assert code(guard.arm(T, JOINTS, 0)) == expected


@pytest.mark.parametrize("number", range(1, 7))
def test_a_joint_may_be_found_half_a_degree_beyond_its_range(number: int) -> None:
    """At both ends."""
    low_deg, high_deg = CELL.robot.joint_min_deg[number - 1], CELL.robot.joint_max_deg[number - 1]
    for deg, rule in (
        (low_deg - 0.499, ""), (low_deg - 0.501, "joint"),
        (high_deg + 0.499, ""), (high_deg + 0.501, "joint"),
    ):  # fmt: skip
        assert code(guard_at().arm(DOWN, joint_at(number, deg), 0)) == rule


@pytest.mark.parametrize("period_ms", [4, 20, 25, 200])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_joint_may_turn_a_tenth_faster_than_it_can_in_a_tenth_of_a_second(
    period_ms: int, sign: float
) -> None:
    """Exactly, also where it jumps at once; with slow reports, from one to the next."""
    fastest, within_s = radians(550.0), max(100, period_ms) * 1e-3
    for share, rule in ((1.1 - 1e-6, ""), (1.1 + 1e-6, "joint_speed")):
        guard, last_ms = guard_at(), 600 // period_ms * period_ms
        for now_ms in range(0, last_ms, period_ms):
            assert guard.arm(DOWN, (0.0,) * 6, now_ms * MS) is None
        turned_rad = sign * share * fastest * within_s
        trip = guard.arm(DOWN, (0.0, 0.0, 0.0, 0.0, turned_rad, 0.0), last_ms * MS)
        assert code(trip) == rule
        if trip is not None:
            assert (trip.value, trip.limit) == pytest.approx((share * fastest, 1.1 * fastest))
            assert "joint 5 turns at 605 degrees/s" in trip.text


# --- moves, force feedback, the wrench ------------------------------------------------------------


def test_a_straight_move_that_swings_the_tool_out_is_refused_though_its_end_is_inside() -> None:
    """Half a turn about y passes where the tool points sideways, beyond the wall."""
    R = pin.utils.rotate("y", np.pi * 0.999) @ DOWN.rotation
    end = pin.SE3(R, np.array([0.0, 0.5, 0.1]))
    cell = load_cell(DEMO_CELL, {"limits.workspace_max_m": [0.1, 0.8, 0.6],
                                 "limits.workspace_min_m": [-0.1, 0.2, -0.2]})  # fmt: skip
    guard = ArmCheck(cell)
    # Armed midway, so that both ends are on the tether.
    guard.start(pin.SE3(pin.utils.rotate("y", np.pi * 0.5) @ DOWN.rotation, end.translation))
    trip = guard.goal(Goal(id=1, kind="pose", pose=record_of(end)), Speed(), DOWN, JOINTS)
    assert trip is not None
    assert (trip.code, "on the path" in trip.text) == ("workspace", True)


def test_a_move_of_the_joints_is_judged_by_where_the_tool_goes_where_that_is_known() -> None:
    """Without the arm's geometry only the joints' ranges are. A pose in its goal is not read."""
    turned = Goal(id=1, kind="joints", joint_rad=(1.0, 0.0, -1.5, 0.0, -1.5, 0.0))
    both = turned.replaced(pose=record_of(DOWN))

    def flange_at(q: np.ndarray) -> pin.SE3:
        return shifted(DOWN, x_m=float(q[0]))

    for geometry, rule in ((None, ""), (flange_at, "workspace")):
        guard = ArmCheck(load_cell(DEMO_CELL), flange_at=geometry)
        guard.start(DOWN)
        for goal in (turned, both):
            assert code(guard.goal(goal, Speed(), DOWN, JOINTS)) == rule


@pytest.mark.parametrize(
    ("tether_m", "x_m", "on_the_path", "at_the_end"),
    [
        (1.0, 0.4019, "", "workspace"),
        (1.0, 0.4021, "workspace", "workspace"),
        (0.2, 0.2019, "", "tether"),
        (0.2, 0.2021, "tether", "tether"),
    ],
)
def test_a_move_of_the_joints_is_judged_after_each_24th_of_its_path(
    tether_m: float, x_m: float, on_the_path: str, at_the_end: str
) -> None:
    """On the path as a measured arm, at its end as a command; at its start it is measured."""
    cell = load_cell(DEMO_CELL, {"limits.tether_m": tether_m})
    turn_by = Goal(id=1, kind="by", joint_rad=(1.2, 0.0, 0.0, 0.0, 0.0, 0.0))
    for part in range(25):
        bad_rad = 0.5 + 1.2 * part / 24

        def flange_at(q: np.ndarray, bad_rad: float = bad_rad) -> pin.SE3:
            return shifted(DOWN, x_m=x_m if abs(q[0] - bad_rad) < 1e-9 else 0.0)

        guard = ArmCheck(cell, flange_at=flange_at)
        guard.start(DOWN)
        trip = guard.goal(turn_by, Speed(), DOWN, (0.5, *JOINTS[1:]))
        assert code(trip) == ("" if part == 0 else at_the_end if part == 24 else on_the_path)
        if trip is not None:
            assert ("on the path" in trip.text) == (part < 24)


MOVE = Goal(id=1, kind="pose", pose=record_of(shifted(DOWN, x_m=0.1)))
TOO_FAR = Goal(id=1, kind="pose", pose=record_of(shifted(DOWN, x_m=0.35)))
TURN = Goal(id=1, kind="by", joint_rad=(0.1, 0.0, 0.0, 0.0, 0.0, 0.0))
PRESS = Feedback(mode="both", setpoint_force_N=(0.0, 10.0, 0.0), gains=Gains())
HARD_PRESS = PRESS.replaced(setpoint_force_N=(0.0, 41.0, 0.0))


@pytest.mark.parametrize(
    ("name", "most", "code"),
    [
        ("setpoint_force_N", 40.0, "setpoint"),
        ("setpoint_torque_Nm", LIMITS.torque_Nm, "setpoint"),
        ("lever_m", 0.3, "malformed"),
    ],
)
def test_force_feedback_is_limited_by_set_points_and_lever(
    name: str, most: float, code: str
) -> None:
    """The limit itself is allowed; speeds are limited by the controller."""
    assert guard_at().feedback(PRESS.replaced(**{name: (0.0, most, 0.0)})) is None
    above = nextafter(most, 100.0)
    trip = guard_at().feedback(PRESS.replaced(**{name: (0.0, above, 0.0)}))
    assert trip is not None
    assert (trip.code, trip.value, trip.limit) == (code, above, most)


@pytest.mark.parametrize(
    ("moves", "ends"),
    [
        (lambda guard: guard.goal(MOVE, Speed(), DOWN, JOINTS), True),
        (lambda guard: guard.goal(TURN, Speed(), DOWN, JOINTS), True),
        (lambda guard: guard.feedback(PRESS), True),
        (lambda guard: guard.goal(TOO_FAR, Speed(), DOWN, JOINTS), False),
        (lambda guard: guard.feedback(HARD_PRESS), False),
    ],
)
def test_a_stream_ends_when_something_else_may_move_the_arm(
    moves: Callable[[ArmCheck], Trip | None], ends: bool
) -> None:
    """The next one begins at the measured pose; a refused one has moved nothing."""
    guard = guard_at()
    assert guard.setpoint(DOWN, DOWN, 4 * MS) is None
    assert (moves(guard) is None) == ends
    assert code(guard.setpoint(DOWN, DOWN, 8 * MS)) == ("no_stream" if ends else "")
    assert guard.seed(DOWN, 12 * MS) is None
    assert guard.setpoint(DOWN, DOWN, 16 * MS) is None


@pytest.mark.parametrize(
    ("T", "rule"),
    [
        (DOWN, ""),
        (shifted(DOWN, x_m=0.31), "tether"),
        (shifted(DOWN, x_m=0.41), "workspace"),
        (shifted(DOWN, x_m=float("nan")), "not_finite"),
    ],
)
def test_a_stream_begins_only_where_a_set_point_may_be(T: pin.SE3, rule: str) -> None:
    """An arm outside is no beginning, and no set point follows."""
    guard = ArmCheck(CELL)
    guard.start(DOWN)
    assert code(guard.seed(T, 0)) == rule
    assert code(guard.setpoint(DOWN, DOWN, 4 * MS)) == ("no_stream" if rule else "")


def test_the_ceilings_count_where_a_wrench_is_known() -> None:
    """60 N and 10 N m in this cell."""
    guard = guard_at()
    assert guard.wrench(None) is None
    assert guard.wrench(WrenchAtTcp(force_N=(0.0, 59.0, 0.0))) is None
    assert code(guard.wrench(WrenchAtTcp(force_N=(0.0, 61.0, 0.0)))) == "force"
    assert code(guard.wrench(WrenchAtTcp(torque_Nm=(0.0, 0.0, 10.1)))) == "torque"


def test_before_a_lease_every_command_is_refused_and_no_tether_counts() -> None:
    """The measured arm is checked; to move it needs a lease."""
    guard = ArmCheck(CELL)
    assert guard.arm(DOWN, JOINTS, 0) is None
    for goal in (MOVE, TURN):
        assert code(guard.goal(goal, Speed(), DOWN, JOINTS)) == "no_lease"
    assert code(guard.seed(DOWN, 0)) == "no_lease"
    assert code(guard.setpoint(DOWN, DOWN, 0)) == "no_lease"
    assert code(guard.feedback(PRESS)) == "no_lease"


def test_from_an_unknown_place_the_end_of_a_move_counts() -> None:
    """No path can be sampled from there."""
    guard = guard_at()
    assert guard.goal(MOVE, Speed(), NOWHERE, JOINTS) is None
    assert code(guard.goal(TOO_FAR, Speed(), NOWHERE, JOINTS)) == "tether"


# --- joint speeds ---------------------------------------------------------------------------------


@pytest.mark.parametrize("period_ms", [4, 20, 25, 70, 200])
def test_a_joint_s_speed_is_from_the_last_sample_that_is_a_tenth_of_a_second_old(
    period_ms: int,
) -> None:
    """Also where it jumps at once; before there is such a sample no speed is known."""
    back = -(-100 // period_ms)  # samples
    for known in range(1, 3 * back):
        track, stamp_ns = JointTrack(), 10**9
        for number in range(known + 1):
            stamp_ns = 10**9 + number * period_ms * 1_000_000
            assert (track.speed_rad_s is not None) == (number > back)
            track.add(stamp_ns, np.full(6, 0.5 + (number == known)))
        speed = track.speed_rad_s
        if known < back:
            assert speed is None
        else:
            assert speed == pytest.approx(np.full(6, 1e3 / (back * period_ms)))


def test_a_sample_that_is_published_again_with_its_stamp_changes_nothing() -> None:
    """Nor does an older one: time never goes back."""
    track = JointTrack()
    for stamp_ns, angle_rad in ((10**9, 0.0), (2 * 10**9, 1.0), (2 * 10**9, 9.0), (10**9 + 1, 9.0)):
        track.add(stamp_ns, np.full(6, angle_rad))
    assert track.speed_rad_s == pytest.approx(np.ones(6))


@pytest.mark.parametrize(("slack", "share"), [(ARBITER_SLACK, 0.5), (ROBOT_SLACK, 1.1)])
@pytest.mark.parametrize("joint", range(6))
def test_each_joint_has_its_speed(joint: int, slack: Slack, share: float) -> None:
    """Swept about the limit, both signs: the cell's share, and what the joint itself can do."""
    fastest = share * radians(CELL.robot.joint_speed_max_deg_s[joint])
    for speed in (0.999 * fastest, -0.999 * fastest, 1.001 * fastest, -1.001 * fastest):
        check = ArmCheck(CELL, slack)
        check.start(DOWN)
        joint_rad = np.zeros(6)
        assert check.arm(DOWN, joint_rad, 0) is None
        joint_rad[joint] += 0.1 * speed
        trip = check.arm(DOWN, joint_rad, 100 * MS)
        assert code(trip) == ("joint_speed" if abs(speed) > fastest else "")
        if trip is not None:
            assert (trip.value, trip.limit) == (pytest.approx(abs(speed)), pytest.approx(fastest))


def test_joint_angles_that_cannot_be_are_refused_and_give_no_speed() -> None:
    """Of another arm, or not finite; the next report counts from the last good one."""
    guard = guard_at()
    for joint_rad, rule in (
        (JOINTS, ""),
        ((0.0,) * 7, "joint_count"),
        ((float("nan"), *JOINTS[1:]), "not_finite"),
        (JOINTS, ""),
    ):
        assert code(guard.arm(DOWN, joint_rad, 100 * MS)) == rule


@pytest.mark.parametrize(("slack", "slack_m"), [(ARBITER_SLACK, 0.0), (ROBOT_SLACK, 2e-3)])
def test_the_arbiter_reports_first(slack: Slack, slack_m: float) -> None:
    """The measured arm may be beyond a limit on commands by the slack of the process."""
    for side_m in (-0.1e-3, 0.1e-3):
        check = ArmCheck(CELL, slack)
        check.start(DOWN)
        T = shifted(DOWN, x_m=LIMITS.tether_m + slack_m + side_m)
        assert code(check.arm(T, JOINTS, 0)) == ("tether" if side_m > 0.0 else "")
