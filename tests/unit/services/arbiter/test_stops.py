"""How motion ends: at once, by fading, or by going back a little; by one table."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.motion.convert import pose_of
from common.motion.limits import Limits
from forcemesh.faults import FAULTS, tripped
from forcemesh.messages import PoseRecord, WrenchAtTcp
from services.arbiter.bounds import ArmBounds
from services.arbiter.stops import REACTIONS, Retreat, Stopping, begin, step
from services.arbiter.stream import Tick
from services.arbiter.stream import begin as begin_stream
from tests.fakes.arbiter_robot import RobotWorld
from tests.fakes.arbiter_world import CELL, PERIOD_NS, T_START, shifted, way_m

DT_S = PERIOD_NS * 1e-9
LIMITS = CELL.limits
CHANGE_M = LIMITS.accel_m_s2 * DT_S * DT_S * (1.0 + 1e-6)  # of one period's way
TIP_M = CELL.tool.T_flange_tcp.position_m[2]
FLOOR_M = LIMITS.workspace_min_m[2]
RETREAT_M = 0.001
RETREAT_FROM, RETREAT_WITHIN_S = 0.8, 2.0  # as docs/arbitration.md says
SOFT_N = RETREAT_FROM * LIMITS.force_N + 1.0


def world_with(**force: float) -> RobotWorld:
    """Return a world whose robot follows at once; fields of the section `force` may differ."""
    section = CELL.force.model_copy(update=force)
    return RobotWorld(CELL.model_copy(update={"force": section}), lag_periods=1)


def run(world: RobotWorld, velocity_m_s: tuple[float, float, float], periods: int) -> None:
    """Let the regulator stream set points at a speed from where it was, as long as it may."""
    if world.core.state == "BOOT":
        world.make_armed()
    for period in range(1, periods + 1):
        x_m, y_m, z_m = (v * period * DT_S for v in velocity_m_s)
        world.propose(shifted(x_m=x_m, y_m=y_m, z_m=z_m))
        world.tick()
        world.stop_the_regulator()
        if world.core.state == "HOLDING":
            return


def set_points(world: RobotWorld) -> list[PoseRecord]:
    """Return every pose that was commanded."""
    said = [command for command in world.commands if command.kind == "setpoint"]
    return [command.pose for command in said if command.pose is not None]


def ways_m(world: RobotWorld) -> list[float]:
    """Return how far each set point is from the one before."""
    return [way_m(b, a) for a, b in pairwise(set_points(world))]


# --- the table ------------------------------------------------------------------------------------


def test_what_ends_softly_is_this_and_nothing_else() -> None:
    """Row by row: one that is left out would be held at once, and nobody would notice."""
    fades = {"workspace", "tether", "joint_speed", "regulator", "travel"}
    assert dict.fromkeys(fades, "fade") | {"force": "retreat", "torque": "retreat"} == REACTIONS


@pytest.mark.parametrize("code", REACTIONS)
def test_only_what_a_person_can_arm_away_is_stopped_softly(code: str) -> None:
    """A FAULT means that something cannot be trusted any more: there is nothing to wait for."""
    assert FAULTS[code].kind == "HOLD"
    assert REACTIONS[code] in {"fade", "retreat"}


@pytest.mark.parametrize("code", ["hold", "step", "tracking", "robot_holds", "rate", "not_finite"])
def test_what_is_urgent_is_held_at_once(code: str) -> None:
    """A person's wish, an arm that does not follow, commands that cannot be believed."""
    assert code not in REACTIONS


def test_a_target_for_the_controller_without_content_holds() -> None:
    """It may begin, and then there is nothing to do."""
    world = world_with().make_armed()
    world.propose(None, host="controller")
    assert world.tick().permission is None
    assert world.core.status().trips[0].code == "regulator"


# --- fade -----------------------------------------------------------------------------------------

velocities = st.tuples(*[st.floats(-0.14, 0.14)] * 3).filter(lambda v: np.linalg.norm(v) > 0.1)


@settings(max_examples=8)
@given(velocities)
def test_set_points_fade_out_inside_the_workspace(velocity: tuple[float, float, float]) -> None:
    """Any way out: no set point outside, none that changes speed faster than allowed, then hold."""
    world = world_with()
    run(world, velocity, 2000)
    assert world.core.state == "HOLDING"
    assert world.core.status().trips[0].code == "workspace"
    low, high = np.array(LIMITS.workspace_min_m), np.array(LIMITS.workspace_max_m)
    for pose in set_points(world):
        T = pose_of(pose)
        tip = T.act(np.array([0.0, 0.0, TIP_M]))
        assert ((tip >= low - 1e-12) & (tip <= high + 1e-12)).all()
    ways = ways_m(world)
    assert max(abs(b - a) for a, b in pairwise(ways)) <= CHANGE_M
    assert ways[-1] <= CHANGE_M


def test_while_it_fades_the_state_is_stopping_and_the_cause_is_told() -> None:
    """The regulator hears that it must end; moves are refused; arming changes nothing."""
    world = world_with()
    world.make_armed()
    periods = 0
    while world.core.state != "STOPPING":
        periods += 1
        world.propose(shifted(z_m=-0.15 * periods * DT_S))
        world.tick()
        assert periods < 2000
    status = world.core.status()
    assert (status.commander, status.trips[0].code) == ("regulator", "workspace")
    reply = world.ask("operator")
    assert reply is not None
    assert (reply.accepted, reply.code) == (False, "not_armed")
    assert world.core.arm(world.inputs()).code == "already"
    assert world.core.state == "STOPPING"

    count = 0
    while world.tick().kind == "setpoint":
        count += 1
    assert world.core.state == "HOLDING"
    assert count == pytest.approx(0.15 / LIMITS.accel_m_s2 / DT_S, abs=2)
    assert [trip.code for trip in world.core.status().trips] == ["workspace"]


def test_a_regulator_that_gives_up_in_motion_fades() -> None:
    """With its own code where it has one; the set points do not stop dead."""
    for code, expected in (("travel", "travel"), ("", "regulator"), ("nonsense", "regulator")):
        world = world_with()
        run(world, (0.0, 0.0, -0.05), 40)
        world.propose(None, valid=False, reason="no contact", code=code)
        kinds = [world.tick().kind for _ in range(20)]
        assert kinds[0] == "setpoint"
        assert kinds[-1] == "hold"
        trip = world.core.status().trips[0]
        assert (trip.code, "no contact" in trip.text) == (expected, True)
        assert max(abs(b - a) for a, b in pairwise(ways_m(world))) <= CHANGE_M


def test_a_regulator_that_gives_up_for_a_fault_is_a_fault_at_once() -> None:
    """The table of faults says so of a wrong sign: nothing fades."""
    world = world_with()
    run(world, (0.0, 0.0, -0.05), 40)
    world.propose(None, valid=False, reason="pushed sideways", code="sensor_sign")
    assert world.tick().kind == "hold"
    assert world.core.state == "FAULT"
    assert world.core.status().trips[0].code == "sensor_sign"


@pytest.mark.parametrize("event", ["hold", "silence", "force"])
def test_what_is_urgent_cuts_a_fade_short(event: str) -> None:
    """A person, a lost input, too much force: no further set point, and both causes are told."""
    world = world_with()
    run(world, (0.0, 0.0, -0.05), 40)
    world.propose(None, valid=False, reason="enough", code="travel")
    assert world.tick().kind == "setpoint"
    if event == "hold":
        assert world.core.hold("coffee").accepted
    elif event == "silence":
        world.silent.add("sensor")
    else:
        world.change("wrench", force_N=(0.0, 0.0, LIMITS.force_N + 1.0))
    assert world.tick().kind == "hold"
    assert world.core.state == ("FAULT" if event == "silence" else "HOLDING")
    first, second = (trip.code for trip in world.core.status().trips)
    assert (first, second) == ("travel", "sensor_silent" if event == "silence" else event)


@pytest.mark.parametrize("owner", ["program", "operator", "controller"])
def test_what_is_not_streamed_is_held_at_once(owner: str) -> None:
    """A goal and the controller's own force feedback are braked by the robot, not by set points."""
    world = RobotWorld().give(owner)
    p = T_START.translation + np.array([0.0, 0.0, FLOOR_M - 0.2])
    T = pose_of(world.robot)
    T.translation = p
    world.place(T)
    assert world.tick().kind == "hold"
    assert world.core.status().trips[0].code == "workspace"


# --- retreat --------------------------------------------------------------------------------------


def pressing(retreat_m: float = RETREAT_M, **force: float) -> RobotWorld:
    """Return a world in which the tool presses down at 20 mm/s, and then too hard."""
    world = world_with(retreat_m=retreat_m, **force)
    run(world, (0.0, 0.0, -0.02), 40)
    world.change("wrench", force_N=(0.0, 0.0, SOFT_N))
    return world


@settings(max_examples=6)
@given(retreat_m=st.floats(0.0002, 0.002), speed_m_s=st.floats(0.002, 0.01))
def test_the_tool_goes_back_along_its_axis_and_holds(retreat_m: float, speed_m_s: float) -> None:
    """As far and as fast as the cell says, within the acceleration; then both facts are latched."""
    world = pressing(retreat_m, retreat_m_s=speed_m_s)
    before = set_points(world)[-1]
    world.tick()
    assert world.core.state == "STOPPING"
    while world.tick().kind == "setpoint":
        assert len(world.commands) < 2000
    back = set_points(world)[-1]

    assert world.core.state == "HOLDING"
    gone = pose_of(back).translation - pose_of(before).translation
    assert gone == pytest.approx([0.0, 0.0, retreat_m], abs=2e-5)
    fastest_m = speed_m_s * DT_S * (1.0 + 1e-6)
    upward = [w for a, b, w in zip(set_points(world), set_points(world)[1:], ways_m(world),
                                   strict=False) if b.position_m[2] > a.position_m[2]]  # fmt: skip
    assert max(upward) <= fastest_m
    (trip,) = world.core.status().trips
    assert trip.code == "force"
    assert f"{SOFT_N:.1f} N" in trip.text
    assert "the tool went back" in trip.text
    assert trip.limit == pytest.approx(RETREAT_FROM * LIMITS.force_N)


def test_without_opting_in_nothing_goes_back_and_the_whole_ceiling_counts() -> None:
    """The default: the arm holds where it is, at the ceiling of the cell."""
    world = pressing(0.0)
    assert world.tick().kind == "setpoint"
    assert world.core.state == "ACTIVE"
    world.change("wrench", force_N=(0.0, 0.0, LIMITS.force_N + 1.0))
    assert world.tick().kind == "hold"
    assert world.core.status().trips[0].limit == LIMITS.force_N


@pytest.mark.parametrize("force_N", [(0.0, 0.0, -SOFT_N), (SOFT_N, 0.0, 0.0)])
def test_only_a_push_against_the_press_makes_it_go_back(
    force_N: tuple[float, float, float],
) -> None:
    """Pulled, or pushed from the side, backwards is no better than here: hold."""
    world = pressing()
    world.change("wrench", force_N=force_N)
    assert world.tick().kind == "hold"
    assert world.core.state == "HOLDING"


@pytest.mark.parametrize("event", ["wrench", "force", "hold"])
def test_a_retreat_ends_with_the_wrench_and_when_it_gets_worse(event: str) -> None:
    """It goes on only while the wrench is valid and below the whole ceiling."""
    world = pressing()
    world.tick(10)
    assert world.core.state == "STOPPING"
    if event == "wrench":
        world.silent.add("wrench")
    elif event == "force":
        world.change("wrench", force_N=(0.0, 0.0, LIMITS.force_N + 0.1))
    else:
        world.core.hold("enough")
    assert world.tick().kind == "hold"
    assert world.core.state == ("FAULT" if event == "wrench" else "HOLDING")
    assert world.core.status().trips[0].code == "force"
    assert world.tick(50).kind == "hold"


def test_a_retreat_does_not_leave_the_workspace() -> None:
    """A wall behind the tool, half way: it goes to the wall and no farther."""
    wall_m = float(T_START.translation[2]) - TIP_M + 0.001
    limits = LIMITS.model_copy(update={"workspace_max_m": (*LIMITS.workspace_max_m[:2], wall_m)})
    force = CELL.force.model_copy(update={"retreat_m": 0.002})
    cell = CELL.model_copy(update={"limits": limits, "force": force})
    world = RobotWorld(cell, lag_periods=1)
    run(world, (0.0, 0.0, 0.0), 40)
    world.change("wrench", force_N=(0.0, 0.0, SOFT_N))
    while world.tick().kind == "setpoint":
        assert len(world.commands) < 2000
    assert world.core.state == "HOLDING"
    highest_m = max(pose.position_m[2] for pose in set_points(world)) - TIP_M
    assert wall_m - 1e-4 < highest_m <= wall_m + 1e-12


def test_the_force_ceiling_of_a_goal_is_the_whole_one() -> None:
    """The lower one is for set points that can go back; a move is held at the ceiling."""
    world = world_with(retreat_m=RETREAT_M)
    world.make_armed()
    world.change("wrench", force_N=(0.0, 0.0, SOFT_N))  # from there limits.move_rise_N is no limit
    world.ask("operator")
    world.tick(60)
    for force_N in (SOFT_N, LIMITS.force_N):
        world.change("wrench", force_N=(0.0, 0.0, force_N))
        assert world.tick().kind == "goal"
    world.change("wrench", force_N=(0.0, 0.0, LIMITS.force_N + 1.0))
    assert world.tick().kind == "hold"
    assert world.core.status().trips[0].limit == LIMITS.force_N


# --- one step of a retreat ------------------------------------------------------------------------

TRIP = tripped("force", "65 N pressed")
BOUNDS = ArmBounds(Limits.of(CELL), CELL.tool.T_flange_tcp.pose, T_START)


def retreat(way_m: float, speed_m_s: float, press_N: float = SOFT_N) -> Stopping | None:
    """Return how a retreat begins when so much presses against a tool at rest at the start."""
    press_axis = (T_START * BOUNDS.T_flange_tcp).rotation[:, 2]
    x_N, y_N, z_N = (-press_N * press_axis).tolist()
    wrench = WrenchAtTcp(force_N=(x_N, y_N, z_N))
    allowed = Retreat(way_m, speed_m_s)
    return begin(TRIP, begin_stream(T_START), BOUNDS, retreat=allowed, wrench=wrench, now_ns=0)


def played(stopping: Stopping, end_s: float) -> tuple[Stopping, float]:
    """Step until it is done, or a time is over; return when that was [s]."""
    period = 0
    while not stopping.done and period * DT_S < end_s:
        period += 1
        moment = Tick(T_START, period * PERIOD_NS, DT_S)
        stopping = step(stopping, BOUNDS, moment)
    return stopping, period * DT_S


def test_a_retreat_lowers_both_ceilings_and_no_retreat_neither() -> None:
    """Four fifths: the robot's own check of the whole one would cut it off."""
    lower = Retreat(0.001, 0.005).ceilings(BOUNDS.limits)
    assert lower.force_N == pytest.approx(0.8 * LIMITS.force_N)
    assert lower.torque_Nm == pytest.approx(0.8 * LIMITS.torque_Nm)
    assert Retreat(0.0, 0.005).ceilings(BOUNDS.limits) is BOUNDS.limits


def test_a_retreat_says_how_far_it_went() -> None:
    """All of its way when it arrives, in less than its time."""
    begun = retreat(0.002, 0.01)
    assert begun is not None
    done, took_s = played(begun, 1.0)
    assert done.done
    assert 0.2 <= took_s < 0.5
    assert done.trip.text == "65 N pressed; the tool went back 2.0 mm"
    assert done.pace.is_there, "it ends at rest, where it was to go, and not a step before"


def test_a_retreat_that_does_not_arrive_ends_after_two_seconds() -> None:
    """Two seconds are allowed, one period more is not; it says how far it came."""
    begun = retreat(0.01, 0.001)
    assert begun is not None
    assert not played(begun, RETREAT_WITHIN_S)[0].done
    done, took_s = played(begun, 10.0)
    assert done.done
    assert took_s == pytest.approx(RETREAT_WITHIN_S + DT_S)
    went_mm = float(done.trip.text.removesuffix(" mm").rsplit(" ", 1)[1])
    assert 1.5 < went_mm <= 2.0


@pytest.mark.parametrize("press_N", [0.0, -1.0])
def test_without_a_press_nothing_goes_back(press_N: float) -> None:
    """Exactly none is none: there is no way out of nothing."""
    assert retreat(0.002, 0.01, press_N) is None
