"""Who takes the arm from whom, and that it rests in between: every ordered pair."""

from itertools import pairwise, product
from math import radians
from typing import Any, get_args

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.motion.convert import pose_of
from forcemesh.faults import tripped
from forcemesh.messages import Accepted, Asker, Commander, RobotCommand
from forcemesh.requests import MoveRequest
from services.arbiter.ownership import REST_S, SETTLE_WITHIN_S
from services.arbiter.ranks import RANKS, outranks
from tests.fakes.arbiter_robot import MOTIONS, RobotWorld
from tests.fakes.arbiter_world import CELL, MOVE_DOWN, PERIOD_NS, STOPPED, World, shifted, way_m

OWNERS = ("regulator", "controller", "program", "operator")  # controller: the regulator, there
ASKERS: tuple[Asker, ...] = get_args(Asker)
# Written out a second time on purpose: whoever changes the ranks must mean it.
TAKES = {
    ("regulator", "program"),
    ("regulator", "operator"),
    ("controller", "program"),
    ("controller", "operator"),
    ("program", "operator"),
}
BY_PROGRAM = MOVE_DOWN.model_copy(update={"commander": "program"})
FIRST_M = CELL.limits.accel_m_s2 * (PERIOD_NS * 1e-9) ** 2  # way of the first period from rest
pairs = list(product(OWNERS, ASKERS))


def named(owner: Any) -> Commander:
    """Return an owner's name on the bus: the regulator, wherever it runs."""
    return "regulator" if owner == "controller" else owner


def settle(world: RobotWorld, until: str = "ACTIVE", at_most: int = 200) -> RobotCommand:
    """Let periods pass until the next owner has begun; the regulator hears of it."""
    for _ in range(at_most):
        command = world.tick()
        world.stop_the_regulator()
        if world.core.state == until:
            return command
    raise AssertionError(f"still {world.core.state}")


def ways_m(world: RobotWorld) -> list[float]:
    """Return how far each set point is from the one before."""
    poses = [said.pose for said in world.commands if said.kind == "setpoint"]
    return [way_m(a, b) for a, b in pairwise(poses) if b is not None]


def test_every_commander_has_a_rank_of_its_own() -> None:
    """One table, complete, without ties: of two there is always one that gives way."""
    assert set(RANKS) == set(get_args(Commander))
    assert len(set(RANKS.values())) == len(RANKS)
    assert sorted(RANKS, key=lambda name: RANKS[name]) == [
        "none", "regulator", "program", "operator"
    ]  # fmt: skip


@pytest.mark.parametrize(("owner", "asker"), pairs)
def test_who_takes_the_arm_from_whom(owner: str, asker: Asker) -> None:
    """Swept: a higher rank is accepted, an equal or lower one hears who has the arm."""
    world = RobotWorld().give(owner)
    before = world.core.status()
    reply = world.ask(asker)
    assert reply is not None

    assert reply.accepted == ((owner, asker) in TAKES)
    assert reply.accepted == outranks(asker, named(owner))
    if not reply.accepted:
        assert reply.code == "busy"
        assert named(owner) in reply.text
        assert world.core.status() == before
        assert world.tick(20).kind in MOTIONS


@pytest.mark.parametrize(("owner", "asker"), sorted(TAKES))
def test_the_next_owner_begins_when_the_arm_has_come_to_rest(owner: str, asker: str) -> None:
    """Idle from the first period on; the new one moves when the robot has rested for a while."""
    world = RobotWorld().give(owner)
    first = len(world.commands)
    assert world.ask(asker)
    assert world.core.state == "SETTLING"
    command = settle(world)

    assert (command.kind, command.commander) == ("goal", asker)
    between = world.commands[first:-1]
    assert {said.kind for said in between} == {"idle"}
    rested = round(REST_S * 1e9 / PERIOD_NS)
    assert not any(world.began_moving[-rested:])
    assert len(between) >= world.lag_periods + world.brake_periods + rested - 1


@pytest.mark.parametrize(("owner", "asker"), sorted(TAKES))
def test_every_owner_has_a_turn_of_its_own_under_one_lease(owner: str, asker: str) -> None:
    """So the robot and everybody else can tell what belongs to whom."""
    world = RobotWorld().give(owner)
    before = world.commands[-1].permission
    world.ask(asker)
    after = settle(world).permission

    assert before is not None
    assert after is not None
    assert before.lease == after.lease
    assert before.ownership < after.ownership
    assert world.core.status().ownership == after.ownership


@pytest.mark.parametrize(("owner", "asker"), sorted(TAKES))
def test_the_owner_before_is_told(owner: str, asker: str) -> None:
    """At once who took the arm and who comes next; and still while the new one commands."""
    world = RobotWorld().give(owner)
    world.ask(asker)
    status = world.core.status()
    assert (status.state, status.commander, status.next_commander) == ("SETTLING", "none", asker)
    settle(world)
    status = world.core.status()

    assert (status.commander, status.next_commander) == (asker, "none")
    assert [trip.code for trip in status.trips] == ["preempted"]
    assert status.trips[0].text == f"the {asker} took the arm from the {named(owner)}"


@pytest.mark.parametrize("host", ["regulator", "controller"])
@pytest.mark.parametrize("owner", ASKERS)
def test_force_feedback_never_takes_the_arm_from_a_move(owner: str, host: str) -> None:
    """Neither during it nor after it: it has to be stopped and started anew."""
    world = RobotWorld().give(owner)
    world.ask(host)
    assert {said.kind for said in [world.tick() for _ in range(50)]} == {"goal"}
    world.change("robot", goal=world.robot.goal.model_copy(update={"state": "done"}))
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
    """However late the robot hears and however long it brakes; meanwhile it is told where it is."""
    world = RobotWorld(lag_periods=lag, brake_periods=brake).give("program")
    world.change("robot", goal=world.robot.goal.model_copy(update={"state": "done"}))
    world.tick()
    world.place(pose_of(shifted(z_m=stop_z_m)))
    world.tick()
    before, command = world.robot, world.tick()
    while command.kind == "idle":
        assert len(world.commands) < 500
        world.ask("regulator")
        before, command = world.robot, world.tick()
        assert (command.kind, command.limited) in {("idle", True), ("setpoint", False)}
        assert way_m(command.pose, before) <= FIRST_M
    assert not before.status.moving


def test_a_robot_that_does_not_echo_the_new_turn_lets_nobody_begin() -> None:
    """It says that it rests, but it has not heard yet: it may still be about to move."""
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


def test_a_robot_that_holds_by_itself_lets_nobody_begin() -> None:
    """Its lease may be dead: then it holds soon, and only a person leads out."""
    world = RobotWorld().give("program")
    world.ask("operator")
    for _ in range(200):
        world.change("robot", hold=tripped("robot_holds", "lease 1 ended"), accepted=None)
        World.tick(world)
        assert world.core.status().commander == "none"
    assert world.core.state == "HOLDING"
    assert world.core.status().trips[-1].code == "robot_holds"


def test_an_arm_that_does_not_come_to_rest_is_held_with_the_reason() -> None:
    """Nobody waits for ever, and nobody begins on a moving arm."""
    world = RobotWorld(brake_periods=10**6).give("program")
    world.ask("operator")
    world.tick(round((SETTLE_WITHIN_S - 0.1) * 1e9 / PERIOD_NS))
    assert world.core.state == "SETTLING"
    world.tick(round(0.2 * 1e9 / PERIOD_NS))

    assert world.core.state == "HOLDING"
    (trip,) = world.core.status().trips
    assert (trip.code, "operator" in trip.text) == ("handover", True)


def test_who_waits_can_be_overtaken_by_a_higher_rank_only() -> None:
    """A program waits for the regulator's arm; a person comes before it, a program does not."""
    world = RobotWorld().give("regulator")
    first = world.ask("program")
    assert first is not None
    again = world.ask("program")
    assert again is not None
    assert (again.code, "program" in again.text) == ("busy", True)
    person = world.ask("operator")
    assert person is not None
    assert person.accepted
    assert world.core.status().trips[0].text == "the operator took the arm from the program"
    command = settle(world)

    assert command.goal is not None
    assert (command.commander, command.goal.id) == ("operator", person.value)
    assert first.value != person.value


@pytest.mark.parametrize("owner", ["none", *OWNERS])
def test_hold_ends_what_waits_too(owner: str) -> None:
    """From SETTLING as from anywhere: no claim outlives a hold and an arming."""
    world = RobotWorld()
    _ = world.make_armed() if owner == "none" else world.give(owner)
    if owner != "operator":
        world.ask("operator")
    assert world.core.hold("enough").accepted
    status = world.core.status()
    assert (status.state, status.commander, status.next_commander) == ("HOLDING", "none", "none")
    world.messages["target"] = STOPPED
    world.pass_s(1.0)
    assert world.core.arm(world.inputs()).accepted
    assert {said.kind for said in [world.tick() for _ in range(100)]} == {"idle"}


def test_a_move_by_angles_counts_from_where_the_arm_has_come_to_rest() -> None:
    """Judged again then: what would now leave the range is not begun, and the reason is told."""
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


def test_a_stopped_regulator_fades_and_gives_the_arm_back() -> None:
    """No jerk at `force stop`: the set points come to rest within the limit of acceleration."""
    world = RobotWorld().make_armed()
    for period in range(80):
        world.propose(shifted(z_m=-0.0002 * period))
        world.tick()
    world.messages["target"] = STOPPED
    while world.tick().kind == "setpoint":
        assert len(world.commands) < 500

    assert (world.commands[-1].kind, world.core.state) == ("idle", "ARMED")
    ways = ways_m(world)
    assert ways[-1] <= FIRST_M * (1.0 + 1e-6) < 0.2 * max(ways)
    assert max(abs(b - a) for a, b in pairwise(ways)) <= FIRST_M * (1.0 + 1e-6)
