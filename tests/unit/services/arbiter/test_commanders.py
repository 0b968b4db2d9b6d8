"""Goals and set points of one commander, and the hand-over between two, with rest in between."""

import math
from itertools import pairwise, product
from math import radians
from typing import Any, get_args

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.config.arm import UNKNOWN_ARM
from common.motion.convert import pose_of
from common.motion.permission import outranks
from forcemesh.faults import tripped
from forcemesh.messages import (
    Accepted,
    Asker,
    Commander,
    GoalReport,
    PoseRecord,
    RobotCommand,
    Speed,
)
from forcemesh.requests import MoveRequest
from services.arbiter.commanders import REST_S
from tests.fakes.arbiter_robot import MOTIONS, RobotWorld
from tests.fakes.arbiter_world import (
    CELL,
    MOVE_DOWN,
    MOVE_JOINTS,
    PERIOD_NS,
    STOPPED,
    World,
    distance_m,
    shifted,
    with_limits,
)

LIMITS = CELL.limits
FIRST_M = LIMITS.accel_m_s2 * (PERIOD_NS * 1e-9) ** 2  # way of the first period from rest
NOWHERE = PoseRecord(position_m=(0.0, 0.5, 0.35), orientation_xyzw=(0.0, 0.0, 0.0, 0.0))

BAD_MOVES = {
    "outside": (MoveRequest(kind="pose", pose=shifted(z_m=0.5)), "workspace"),
    "no orientation": (MoveRequest(kind="pose", pose=NOWHERE), "not_finite"),
    "too fast": (MoveRequest(kind="pose", pose=shifted(z_m=-0.05), speed_m_s=0.251), "speed"),
}


# --- goals ----------------------------------------------------------------------------------------


def test_a_goal_is_repeated_each_period_until_the_robot_reports() -> None:
    """Id and content stay the same under the same lease; done gives the arm back."""
    world = World().make_armed()
    assert world.core.move(MOVE_DOWN, world.inputs()).accepted
    commands = [world.tick() for _ in range(20)]
    assert all(command == commands[0] for command in commands)
    assert commands[0].goal is not None
    assert (commands[0].kind, commands[0].goal.pose) == ("goal", MOVE_DOWN.pose)

    world.report_goal("running")
    assert world.tick().kind == "goal"
    world.report_goal("done")
    assert (world.tick().kind, world.core.state, world.core.status().trips) == ("idle", "ARMED", ())


@pytest.mark.parametrize("last_id", [0, 1, 2, 10**6])
def test_a_goal_never_has_a_number_that_the_robot_already_knows(last_id: int) -> None:
    """A restarted arbiter continues the count: else its first goal would count as done."""
    world = World().make_armed()
    world.change("robot", goal=GoalReport(id=last_id, state="done"))
    assert world.core.move(MOVE_DOWN, world.inputs()).accepted
    command = world.tick(10)
    assert command.kind == "goal"
    assert command.goal is not None
    assert command.goal.id > last_id


@pytest.mark.parametrize(("move", "code"), BAD_MOVES.values(), ids=BAD_MOVES)
def test_a_move_that_breaks_a_rule_is_refused_with_its_code(move: MoveRequest, code: str) -> None:
    """No motion and no change of state results."""
    world = World().make_armed()
    reply = world.core.move(move, world.inputs())

    assert (reply.accepted, reply.code) == (False, code)
    assert reply.text
    assert (world.tick().kind, world.core.state) == ("idle", "ARMED")


def test_speeds_are_refused_above_the_limit_and_used_from_then_on() -> None:
    """The effective speed counts: mechanical times modular."""
    world = World().make_armed()
    fast = Speed(mechanical_m_s=LIMITS.speed_m_s * 2.0, modular_fraction=0.51)
    reply = world.core.set_speed(fast)
    assert (reply.accepted, reply.code, reply.limit) == (False, "speed", LIMITS.speed_m_s)
    right = fast.replaced(modular_fraction=0.5)
    reply = world.core.set_speed(right)
    assert reply.accepted
    assert reply.value == pytest.approx(LIMITS.speed_m_s)
    assert "250.0 mm/s" in reply.text
    world.core.move(MOVE_DOWN, world.inputs())
    assert world.tick().speed == right


# --- set points -----------------------------------------------------------------------------------


def test_an_arm_without_a_model_follows_set_points_too() -> None:
    """Its joints are not checked ahead, which the reply to `arm` says."""
    robot = CELL.robot.model_copy(update={"model": UNKNOWN_ARM})
    world = World(CELL.model_copy(update={"robot": robot})).make_active("regulator")
    world.propose(shifted(x_m=0.001))
    assert world.tick().kind == "setpoint"


def test_a_set_point_too_far_from_the_arm_holds() -> None:
    """The arm does not follow: after `step_m` of set points it holds with the distance."""
    world = with_limits(step_m=0.005).make_active("regulator")
    world.propose(shifted(x_m=0.1))
    kinds = [world.tick().kind for _ in range(30)]

    assert kinds.index("hold") == pytest.approx(math.sqrt(2.0 * 0.005 / FIRST_M), abs=2)
    assert set(kinds[kinds.index("hold") :]) == {"hold"}
    (trip,) = world.core.status().trips
    assert (trip.code, trip.limit) == ("step", 0.005)


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"pose": NOWHERE}, "not_finite"),
        ({"pose": None}, "regulator"),
    ],
)
def test_an_invalid_target_holds(changes: dict[str, object], code: str) -> None:
    """A missing pose, orientation or content for the controller leads to a hold."""
    world = World().make_active("regulator")
    world.change("target", **changes)
    command = world.tick()

    assert (command.kind, command.permission) == ("hold", None)
    assert world.core.status().trips[0].code == code


OWNERS = ("regulator", "controller", "program", "operator")  # controller: the regulator there
REQUESTERS: tuple[Asker, ...] = get_args(Asker)
# Repeated on purpose: a change of the ranks has to be made twice.
TAKES = {
    ("regulator", "program"),
    ("regulator", "operator"),
    ("controller", "program"),
    ("controller", "operator"),
    ("program", "operator"),
}
BY_PROGRAM = MOVE_DOWN.replaced(commander="program")
pairs = list(product(OWNERS, REQUESTERS))


def commander_of(owner: Any) -> Commander:
    """Return an owner's name on the bus: the regulator on either loop host."""
    return "regulator" if owner == "controller" else owner


def settle(world: RobotWorld, until: str = "ACTIVE", at_most: int = 200) -> RobotCommand:
    """Let periods pass until the next owner has begun; the regulator receives the status."""
    for _ in range(at_most):
        command = world.tick()
        world.stop_the_regulator()
        if world.core.state == until:
            return command
    raise AssertionError(f"still {world.core.state}")


@pytest.mark.parametrize(("owner", "requester"), pairs)
def test_a_higher_rank_takes_the_arm(owner: str, requester: Asker) -> None:
    """Swept: a higher rank is accepted; the refusal of an equal or lower one names the owner."""
    world = RobotWorld().give(owner)
    before = world.core.status()
    reply = world.ask(requester)
    assert reply is not None

    assert reply.accepted == ((owner, requester) in TAKES)
    assert reply.accepted == outranks(requester, commander_of(owner))
    if not reply.accepted:
        assert reply.code == "busy"
        assert commander_of(owner) in reply.text
        assert world.core.status() == before
        assert world.tick(20).kind in MOTIONS


@pytest.mark.parametrize(("owner", "requester"), sorted(TAKES))
def test_the_next_owner_begins_when_the_arm_is_at_rest(owner: str, requester: str) -> None:
    """Idle from the first period on; the new owner moves when the robot has rested for a while."""
    world = RobotWorld().give(owner)
    first = len(world.commands)
    assert world.ask(requester)
    assert world.core.state == "SETTLING"
    command = settle(world)

    assert (command.kind, command.commander) == ("goal", requester)
    between = world.commands[first:-1]
    assert {command.kind for command in between} == {"idle"}
    rested = round(REST_S * 1e9 / PERIOD_NS)
    assert not any(world.began_moving[-rested:])
    assert len(between) >= world.lag_periods + world.brake_periods + rested - 1


@pytest.mark.parametrize("host", ["regulator", "controller"])
@pytest.mark.parametrize("owner", REQUESTERS)
def test_force_feedback_never_takes_the_arm_from_a_move(owner: str, host: str) -> None:
    """Neither during the move nor after it: it has to be stopped and started again."""
    world = RobotWorld().give(owner)
    world.ask(host)
    assert {command.kind for command in [world.tick() for _ in range(50)]} == {"goal"}
    world.change("robot", goal=world.robot.goal.replaced(state="done"))
    assert world.tick().kind == "idle"
    assert world.tick(100).kind == "idle"

    world.messages["target"] = STOPPED
    world.tick()
    world.ask(host)
    assert world.tick(2).kind in MOTIONS


@settings(max_examples=12)
@given(lag=st.integers(0, 10), brake=st.integers(0, 60), stop_z_m=st.floats(-0.004, 0.004))
def test_a_regulator_begins_at_the_measured_pose_at_rest(
    lag: int, brake: int, stop_z_m: float
) -> None:
    """For any delay and braking of the robot; meanwhile the regulator receives the pose."""
    world = RobotWorld(lag_periods=lag, brake_periods=brake).give("program")
    world.change("robot", goal=world.robot.goal.replaced(state="done"))
    world.tick()
    world.place(pose_of(shifted(z_m=stop_z_m)))
    world.tick()
    before, command = world.robot, world.tick()
    while command.kind == "idle":
        assert len(world.commands) < 500
        world.ask("regulator")
        before, command = world.robot, world.tick()
        assert (command.kind, command.limited) in {("idle", True), ("setpoint", False)}
        assert distance_m(command.pose, before) <= FIRST_M
    assert not before.status.moving


def test_a_robot_without_an_echo_of_the_new_turn_delays_the_hand_over() -> None:
    """A robot at rest that has not received the turn may still move by an older command."""
    world = World().make_armed()
    assert world.core.move(BY_PROGRAM, world.inputs()).accepted
    turn = world.core.status().ownership
    world.change("robot", accepted=Accepted(epoch=1, seq=1, ownership=turn, at_ns=1))
    assert world.tick().commander == "program"
    assert world.core.move(MOVE_DOWN, world.inputs()).accepted
    assert world.tick(100).kind == "idle"
    assert world.core.state == "SETTLING"

    world.change("robot", accepted=Accepted(epoch=1, seq=1, ownership=turn + 1, at_ns=1))
    assert world.pass_s(0.2).commander == "operator"


def test_a_relative_move_starts_from_the_angles_at_rest() -> None:
    """It is checked again then: a move out of range does not begin, and the reason is reported."""
    world = RobotWorld()
    world.change("robot", joint_rad=(0.0, radians(120.0), 0.0, 0.0, 0.0, 0.0))
    world.give("program")
    by = MoveRequest(kind="by", joint_rad=(0.0, radians(14.0), 0.0, 0.0, 0.0, 0.0))
    assert world.core.move(by, world.inputs()).accepted
    world.change("robot", joint_rad=(0.0, radians(121.5), 0.0, 0.0, 0.0, 0.0))
    settle(world, "ARMED")

    assert [trip.code for trip in world.core.status().trips] == ["preempted", "goal_refused"]
    assert "joint 2" in world.core.status().trips[1].text
    assert world.tick(50).kind == "idle"


def test_a_stopped_regulator_fades_and_releases_the_arm() -> None:
    """`force stop` causes no jerk: the set points stop within the acceleration limit."""
    world = RobotWorld().make_armed()
    for period in range(80):
        world.propose(shifted(z_m=-0.0002 * period))
        world.tick()
    world.messages["target"] = STOPPED
    while world.tick().kind == "setpoint":
        assert len(world.commands) < 500

    assert (world.commands[-1].kind, world.core.state) == ("idle", "ARMED")
    travels = world.travels_m
    assert travels[-1] <= FIRST_M * (1.0 + 1e-6) < 0.2 * max(travels)
    assert max(abs(b - a) for a, b in pairwise(travels)) <= FIRST_M * (1.0 + 1e-6)


def test_arming_does_not_resume_a_regulator_that_never_stopped() -> None:
    """After a hold and an arming, force feedback continues only after a new start."""
    world = World().make_active("regulator")
    world.core.hold("enough")
    assert world.core.arm(world.inputs()).accepted
    assert world.tick(100).kind == "idle"

    world.messages["target"] = STOPPED
    world.tick()
    world.propose(shifted())
    assert world.tick().kind == "setpoint"


def test_the_speed_of_a_move_is_for_that_move_only() -> None:
    """A fast move does not make the next one fast."""
    world = World().make_armed()
    slow = Speed(mechanical_m_s=0.01, accel_fraction=0.3)
    world.core.set_speed(slow)
    world.core.move(MOVE_DOWN.replaced(speed_m_s=0.2), world.inputs())
    speed = world.tick().speed
    assert speed.mechanical_m_s * speed.modular_fraction == pytest.approx(0.2)
    assert speed.accel_fraction == 0.3
    world.report_goal("done")
    assert world.tick().speed == slow
    world.core.move(MOVE_JOINTS, world.inputs())
    assert world.pass_s(0.2).kind == "goal"
    assert world.tick().speed == slow


def test_a_robot_that_holds_by_itself_stops_the_hand_over() -> None:
    """Its lease may have ended: then the arbiter holds soon, and only an operator clears it."""
    world = RobotWorld().give("program")
    world.ask("operator")
    for _ in range(200):
        world.change("robot", hold=tripped("robot_holds", "lease 1 ended"), accepted=None)
        World.tick(world)
        assert world.core.status().commander == "none"
    assert world.core.state == "HOLDING"
    assert world.core.status().trips[-1].code == "robot_holds"


def test_the_arm_rests_for_a_tenth_of_a_second_before_the_next_owner() -> None:
    """Exactly so long, from the first report of an arm at rest."""
    world = RobotWorld().give("program")
    world.ask("operator")
    settle(world)
    assert world.began_moving[::-1].index(True) == 0.1e9 / PERIOD_NS + 1


def test_an_arm_that_does_not_come_to_rest_within_three_seconds_is_held() -> None:
    """No owner begins on a moving arm; the reason names the one who waited."""
    world = RobotWorld(brake_periods=10**6).give("program")
    world.ask("operator")
    world.tick(round(3e9) // PERIOD_NS)
    assert world.core.state == "SETTLING"
    world.tick(2)
    assert world.core.state == "HOLDING"
    (trip,) = world.core.status().trips
    assert (trip.code, "operator" in trip.text) == ("handover", True)
