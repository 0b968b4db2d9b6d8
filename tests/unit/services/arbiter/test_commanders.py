"""One commander at a time, and the limits of the commands that pass."""

import math

import pytest

from common.config.arm import UNKNOWN_ARM
from forcemesh.messages import GoalReport, PoseRecord, Speed
from forcemesh.requests import MoveRequest
from tests.fakes.arbiter_world import (
    CELL,
    MOVE_DOWN,
    PERIOD_NS,
    World,
    shifted,
    with_limits,
)

LIMITS = CELL.limits
FIRST_M = LIMITS.accel_m_s2 * (PERIOD_NS * 1e-9) ** 2  # way of the first period from rest
NOWHERE = PoseRecord(position_m=(0.0, 0.5, 0.35), orientation_xyzw=(0.0, 0.0, 0.0, 0.0))

BAD_MOVES = {
    "a pose that is outside": (MoveRequest(kind="pose", pose=shifted(z_m=0.5)), "workspace"),
    "a pose without a pose": (MoveRequest(kind="pose"), "malformed"),
    "joints without joints": (MoveRequest(kind="joints"), "malformed"),
    "by without joints": (MoveRequest(kind="by", pose=shifted()), "malformed"),
    "no orientation": (MoveRequest(kind="pose", pose=NOWHERE), "not_finite"),
    "joints out of range": (MoveRequest(kind="joints", joint_rad=(0, 3, 0, 0, 0, 0)), "joint"),
    "by out of range": (MoveRequest(kind="by", joint_rad=(0, 0, 0, 0, -3, 0)), "joint"),
    "a huge number": (MoveRequest(kind="joints", joint_rad=(99.0,) * 6), "joint"),
    "too fast": (
        MoveRequest(kind="pose", pose=shifted(z_m=-0.05), speed_m_s=0.251),
        "speed",
    ),
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
