"""Backing off under the arbiter: conditions, commands, and its end."""

from math import hypot

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.config.cell import CellConfig
from common.motion.back_off import LONGEST_BACK_OFF_M, RISE_N, SPEED_M_S
from common.motion.convert import pose_of, record_of
from common.motion.frames import rotation_between
from forcemesh.faults import FAULTS
from forcemesh.messages import MAY_MOVE, RobotCommand, RobotState, Speed, Vec3, WrenchAtTcp
from forcemesh.requests import Reply
from services.arbiter.backing_off import BackingOff
from tests.fakes.arbiter_world import MOVE_DOWN, PERIOD_NS, T_START, World
from tests.fakes.bench import CELL

DT_S = PERIOD_NS * 1e-9


def loaded(force_N: Vec3 = (0.0, 0.0, 75.0), cell: CellConfig = CELL) -> World:
    """Return an arbiter that holds above its ceiling."""
    world = World(cell).make_armed()
    world.change("wrench", force_N=force_N)
    world.tick()
    assert world.core.state == "HOLDING"
    world.pass_s(1.1)
    return world


def robot_of(world: World) -> RobotState:
    """Return the newest state of the robot."""
    robot = world.messages["robot"]
    assert isinstance(robot, RobotState)
    return robot


def back_off(world: World, *, confirmed: bool = False) -> Reply:
    """Request to back off."""
    return world.core.back_off(world.inputs(), confirmed=confirmed)


def follow(world: World, command: RobotCommand) -> None:
    """Let the robot move by the command at its speed."""
    if command.kind != "goal" or command.goal is None or command.goal.pose is None:
        return
    T, target = pose_of(robot_of(world)), pose_of(command.goal.pose)
    travel = target.translation - T.translation
    far_m = float(np.linalg.norm(travel))
    share = min(1.0, command.speed.mechanical_m_s * DT_S / far_m) if far_m > 0.0 else 1.0
    world.place(pin.SE3(target.rotation, T.translation + share * travel))
    state = "done" if share == 1.0 else "running"
    report = {"id": command.goal.id, "state": state}
    world.change("robot", goal=robot_of(world).goal.replaced(**report))


def spring(world: World, stiffness_N_m: float, force_N: float) -> None:
    """Let the force of the plate below decrease with the tool's height."""
    up_m = float(pose_of(robot_of(world)).translation[2] - T_START.translation[2])
    world.change("wrench", force_N=(0.0, 0.0, max(0.0, force_N - stiffness_N_m * up_m)))


def codes(world: World) -> list[str]:
    """Return the codes of the trips."""
    return [trip.code for trip in world.core.status().trips]


@pytest.mark.parametrize("stiffness_N_m", [3000.0, 20_000.0, 200_000.0])
def test_an_arm_above_its_ceiling_is_freed(stiffness_N_m: float) -> None:
    """Arming is refused and names the remedy; backing off ends below half of the ceiling, held."""
    world = loaded()
    for purpose in ("all", "jog"):
        reply = world.core.arm(world.inputs(), purpose)
        assert (reply.accepted, reply.code) == (False, "force")
    assert "forcemesh back-off" in FAULTS["force"].remedy
    assert "forcemesh back-off" in world.core.status().clears
    reply = back_off(world)
    assert reply.accepted, reply
    assert "along the measured force" in reply.text
    assert world.core.status().armed_for == "back_off"
    for _ in range(2000):
        command = world.tick()
        if command.permission is None:
            break
        assert command.permission.purpose == "back_off"
        follow(world, command)
        spring(world, stiffness_N_m, 75.0)
    assert world.core.state == "HOLDING"
    assert codes(world) == ["back_off"]
    assert "free after" in world.core.status().trips[0].text
    wrench = world.messages["wrench"]
    assert isinstance(wrench, WrenchAtTcp)
    assert hypot(*wrench.force_N) < 0.5 * world.cell.limits.force_N
    world.pass_s(1.1)
    assert world.core.arm(world.inputs(), "jog").accepted


def test_a_tool_outside_the_workspace_is_moved_back() -> None:
    """The motion is straight and no longer than needed."""
    world = World().make_ready()
    assert world.core.arm(world.inputs()).accepted
    world.tick()
    outside = pin.SE3(T_START.rotation, T_START.translation + np.array([0.412, 0.0, 0.0]))
    world.place(outside)
    world.tick()
    assert codes(world) == ["workspace"]
    world.pass_s(1.1)
    assert world.core.arm(world.inputs(), "jog").code == "workspace"
    assert back_off(world).accepted
    for _ in range(2000):
        command = world.tick()
        if command.permission is None:
            break
        follow(world, command)
    assert codes(world) == ["back_off"]
    x_m = robot_of(world).position_m[0]
    assert 0.3985 < x_m <= 0.4


def test_without_a_usable_force_it_requires_a_confirmation_and_moves_5_mm_back() -> None:
    """Without the sensor there is a fault, before and after."""
    world = loaded()
    world.silent.update({"sensor", "wrench", "sensor/health"})
    world.pass_s(1.1)
    assert world.core.arm(world.inputs(), "jog").accepted is False
    reply = back_off(world)
    assert (reply.accepted, reply.code) == (False, "no_direction")
    reply = back_off(world, confirmed=True)
    assert reply.accepted, reply
    for _ in range(1000):
        command = world.tick()
        if command.permission is None:
            break
        follow(world, command)
    up_m = pose_of(robot_of(world)).translation - T_START.translation
    assert up_m == pytest.approx([0.0, 0.0, 0.005], abs=1e-5)
    assert world.core.state == "FAULT"
    assert codes(world)[0] == "still_loaded"


def test_no_other_command_is_accepted_meanwhile() -> None:
    """No move, no force feedback, no other purpose; hold is accepted."""
    world = loaded()
    assert back_off(world).accepted
    assert world.core.state == "ACTIVE"
    assert world.core.move(MOVE_DOWN, world.inputs()).code == "busy"
    assert world.core.arm(world.inputs()).code == "state"
    world.propose(record_of(T_START))
    kinds = {world.tick().kind for _ in range(200)}
    assert kinds <= {"idle", "goal"}
    assert world.core.hold("enough").accepted
    assert (world.tick().kind, codes(world)) == ("hold", ["hold"])


forces = st.lists(
    st.tuples(*[st.floats(-120.0, 120.0)] * 3, st.integers(1, 60)), min_size=1, max_size=8
)


@settings(max_examples=25, deadline=None)
@given(st.floats(-60.0, 60.0), st.floats(20.0, 100.0), forces)
def test_force_travel_speed_and_rotation_stay_bounded_for_any_wrench(
    sideways_N, up_N, then
) -> None:
    """The permission requires a force below the ratchet; the goal is a single short one."""
    world = loaded((sideways_N, 0.0, up_N + 60.0))
    if not back_off(world).accepted:
        return
    start, lowest_N, goals = pose_of(robot_of(world)), np.inf, set()
    for *force_N, periods in then:
        world.change("wrench", force_N=tuple(force_N))
        for _ in range(periods):
            command = world.tick()
            force = hypot(*force_N)
            if command.permission is not None:
                assert force <= lowest_N + RISE_N
            lowest_N = min(lowest_N, force)
            if command.kind != "goal":
                assert command.kind in {"idle", "hold"}
                continue
            assert command.goal is not None
            assert command.goal.pose is not None
            goals.add(command.goal.pose)
            T = pose_of(command.goal.pose)
            assert np.linalg.norm(T.translation - start.translation) <= LONGEST_BACK_OFF_M + 1e-9
            assert np.linalg.norm(rotation_between(start.rotation, T.rotation)) < 1e-6
            assert command.speed.mechanical_m_s * command.speed.modular_fraction <= SPEED_M_S
            follow(world, command)
    assert len(goals) <= 1


# --- moves in contact -----------------------------------------------------------------------------


def test_a_cell_slower_than_backing_off_uses_its_own_speed() -> None:
    """Before, this was refused with `speed`, and only the pendant could free the arm."""
    slow = CELL.limits.model_copy(update={"speed_m_s": 0.5 * SPEED_M_S})
    world = loaded(cell=CELL.model_copy(update={"limits": slow}))
    assert back_off(world).accepted
    command = world.tick()
    assert command.kind == "goal"
    assert command.speed is not None
    assert command.speed.mechanical_m_s * command.speed.modular_fraction == 0.5 * SPEED_M_S


def test_a_move_stops_at_its_own_force_rise() -> None:
    """The limit is 20 N above the least force of the move, far below the ceiling of 60."""
    world = World().make_armed()
    world.change("wrench", force_N=(0.0, 0.0, 10.0))
    assert world.core.move(MOVE_DOWN, world.inputs()).accepted
    world.tick(50)
    for force, continues in ((29.0, True), (31.0, False)):
        world.change("wrench", force_N=(0.0, 0.0, force))
        assert (world.tick().permission is not None) == continues
    assert codes(world) == ["force"]
    assert "limits.move_rise_N" in world.core.status().trips[0].text
    assert world.core.state not in MAY_MOVE


def test_without_a_calibration_the_force_rise_of_a_move_is_not_checked() -> None:
    """The tool's weight turns with the tool; the ceiling counts."""
    world = World().make_ready()
    world.change("wrench", calibrated=False)
    assert world.core.arm(world.inputs(), "jog").accepted
    assert world.core.move(MOVE_DOWN, world.inputs()).accepted
    world.tick(50)
    world.change("wrench", force_N=(0.0, 0.0, 50.0))
    assert world.tick(2).permission is not None


def test_it_leaves_a_fault_and_requires_a_robot() -> None:
    """From FAULT and BOOT it is possible without a sensor, but never without the robot."""
    world = World().make_armed()
    world.silent.update({"sensor", "wrench"})
    world.tick()
    assert world.core.state == "FAULT"
    world.pass_s(1.1)
    assert back_off(world, confirmed=True).accepted
    fresh = World()
    fresh.silent.update({"sensor", "wrench"})
    fresh.pass_s(1.1)
    assert fresh.core.state == "BOOT"
    fresh.silent.add("robot")
    assert back_off(fresh, confirmed=True).accepted is False
    fresh.silent.discard("robot")
    fresh.pass_s(1.1)
    assert back_off(fresh, confirmed=True).accepted


def test_the_arbiters_own_goal_is_checked_like_any_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """A goal beyond a limit is refused by its number, and the lease ends in a hold."""
    monkeypatch.setattr(BackingOff, "speed", Speed(mechanical_m_s=2.0 * SPEED_M_S))
    world = loaded()
    reply = back_off(world)
    assert (reply.accepted, reply.code) == (False, "speed")
    assert (reply.value, reply.limit) == (2.0 * SPEED_M_S, SPEED_M_S)
    for _ in range(20):
        assert world.tick().kind == "hold"
    assert (world.core.state, codes(world)) == ("HOLDING", ["speed"])
