"""Hand-over of the arm for every ordered pair of commanders, with rest in between."""

from itertools import pairwise, product
from math import radians
from typing import Any, get_args

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.motion.convert import pose_of
from common.motion.permission import outranks
from forcemesh.messages import Accepted, Asker, Commander, RobotCommand
from forcemesh.requests import MoveRequest
from services.arbiter.commanders import REST_S
from tests.fakes.arbiter_robot import MOTIONS, RobotWorld
from tests.fakes.arbiter_world import (
    CELL,
    MOVE_DOWN,
    PERIOD_NS,
    STOPPED,
    World,
    distance_m,
    shifted,
)

OWNERS = (
    "regulator",
    "controller",
    "program",
    "operator",
)  # controller: the regulator with loop host controller
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
FIRST_M = CELL.limits.accel_m_s2 * (PERIOD_NS * 1e-9) ** 2  # travel of the first period from rest
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
