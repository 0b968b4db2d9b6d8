"""Streamed set points: the reactions that end them, and the time base that they follow."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.motion.convert import pose_of
from common.motion.joint_space import JointStream
from common.motion.limits import ArmBounds, Limits
from common.motion.rate_limiter import CommandedMotion, at_rest
from forcemesh.faults import tripped
from forcemesh.messages import Trip, WrenchAtTcp
from services.arbiter.stream import (
    REACTIONS,
    SampleClock,
    Stopping,
    Tick,
    begin_stop,
    follow,
    step_stop,
)
from tests.fakes.arbiter_robot import RobotWorld
from tests.fakes.arbiter_world import CELL, PERIOD_NS, T_START, distance_m, shifted

DT_S = PERIOD_NS * 1e-9
LIMITS = CELL.limits
CHANGE_M = LIMITS.accel_m_s2 * DT_S * DT_S * (1.0 + 1e-6)  # of one period's travel
TIP_M = CELL.tool.T_flange_tcp.position_m[2]
RETREAT_M = 0.001
RETREAT_FROM, RETREAT_WITHIN_S = 0.8, 2.0  # values of the arbitration page
SOFT_N = RETREAT_FROM * LIMITS.force_N + 1.0


def world_with(**force: float) -> RobotWorld:
    """Return a world whose robot follows at once; fields of the section `force` may differ."""
    section = CELL.force.model_copy(update=force)
    return RobotWorld(CELL.model_copy(update={"force": section}), lag_periods=1)


def run(world: RobotWorld, velocity_m_s: tuple[float, float, float], periods: int) -> None:
    """Let the regulator stream set points at a speed from the start, until a hold."""
    if world.core.state == "BOOT":
        world.make_armed()
    for period in range(1, periods + 1):
        x_m, y_m, z_m = (v * period * DT_S for v in velocity_m_s)
        world.propose(shifted(x_m=x_m, y_m=y_m, z_m=z_m))
        world.tick()
        world.stop_the_regulator()
        if world.core.state == "HOLDING":
            return


# --- the table ------------------------------------------------------------------------------------


def test_the_table_has_exactly_these_soft_reactions() -> None:
    """A missing row would be an immediate hold without notice."""
    fades = {"workspace", "tether", "joint_speed", "regulator", "travel"}
    assert dict.fromkeys(fades, "fade") | {"force": "retreat", "torque": "retreat"} == REACTIONS


# --- fade -----------------------------------------------------------------------------------------


def test_during_a_fade_the_state_is_stopping_with_its_cause() -> None:
    """The regulator receives its end; moves are refused; arming changes nothing."""
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
    assert world.commands[-1].limited
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


def test_a_regulator_that_fails_in_motion_fades() -> None:
    """The trip has the regulator's code, if any; the set points do not stop abruptly."""
    for code, expected in (("travel", "travel"), ("", "regulator"), ("nonsense", "regulator")):
        world = world_with()
        run(world, (0.0, 0.0, -0.05), 40)
        world.propose(None, valid=False, reason="no contact", code=code)
        kinds = [world.tick().kind for _ in range(20)]
        assert kinds[0] == "setpoint"
        assert kinds[-1] == "hold"
        trip = world.core.status().trips[0]
        assert (trip.code, "no contact" in trip.text) == (expected, True)
        assert max(abs(b - a) for a, b in pairwise(world.travels_m)) <= CHANGE_M


@pytest.mark.parametrize("event", ["hold", "silence", "force"])
def test_urgent_causes_end_a_fade(event: str) -> None:
    """A hold, a lost input or too much force ends the set points; both causes are reported."""
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


# --- retreat --------------------------------------------------------------------------------------


def pressing(retreat_m: float = RETREAT_M, **force: float) -> RobotWorld:
    """Return a world in which the tool presses down at 20 mm/s, and then too hard."""
    world = world_with(retreat_m=retreat_m, **force)
    run(world, (0.0, 0.0, -0.02), 40)
    world.change("wrench", force_N=(0.0, 0.0, SOFT_N))
    return world


@settings(max_examples=6)
@given(retreat_m=st.floats(0.0002, 0.002), speed_m_s=st.floats(0.002, 0.01))
def test_the_tool_retreats_along_its_axis_and_holds(retreat_m: float, speed_m_s: float) -> None:
    """Distance and speed are those of the cell; both causes are latched."""
    world = pressing(retreat_m, retreat_m_s=speed_m_s)
    before = world.set_points[-1]
    world.tick()
    assert world.core.state == "STOPPING"
    while world.tick().kind == "setpoint":
        assert len(world.commands) < 2000
    back = world.set_points[-1]

    assert world.core.state == "HOLDING"
    travel = pose_of(back).translation - pose_of(before).translation
    assert travel == pytest.approx([0.0, 0.0, retreat_m], abs=2e-5)
    fastest_m = speed_m_s * DT_S * (1.0 + 1e-6)
    upward = [w for a, b, w in zip(world.set_points, world.set_points[1:], world.travels_m,
                                   strict=False) if b.position_m[2] > a.position_m[2]]  # fmt: skip
    assert max(upward) <= fastest_m
    (trip,) = world.core.status().trips
    assert trip.code == "force"
    assert f"{SOFT_N:.1f} N" in trip.text
    assert "the tool went back" in trip.text
    assert trip.limit == pytest.approx(RETREAT_FROM * LIMITS.force_N)


def test_a_retreat_does_not_leave_the_workspace() -> None:
    """With a wall behind the tool, half way, it ends at the wall."""
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
    highest_m = max(pose.position_m[2] for pose in world.set_points) - TIP_M
    assert wall_m - 1e-4 < highest_m <= wall_m + 1e-12


def test_the_force_ceiling_of_a_goal_is_the_whole_one() -> None:
    """The lower one is for set points that can retreat; a move is held at the ceiling."""
    world = world_with(retreat_m=RETREAT_M)
    world.make_armed()
    world.change(
        "wrench", force_N=(0.0, 0.0, SOFT_N)
    )  # from this load limits.move_rise_N does not trip first
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


def retreat(travel_m: float, speed_m_s: float, press_N: float = SOFT_N) -> Stopping | None:
    """Return the start of a retreat from this press force on a tool at rest."""
    press_axis = (T_START * BOUNDS.T_flange_tcp).rotation[:, 2]
    x_N, y_N, z_N = (-press_N * press_axis).tolist()
    wrench = WrenchAtTcp(force_N=(x_N, y_N, z_N))
    allowed = CELL.force.model_copy(update={"retreat_m": travel_m, "retreat_m_s": speed_m_s})
    return begin_stop(Stopping(TRIP, at_rest(T_START), 0), BOUNDS, allowed, wrench)


def run_stop(stopping: Stopping, end_s: float) -> tuple[Stopping, float]:
    """Step until it is done, or a time is over; return the time [s]."""
    period = 0
    while not stopping.done and period * DT_S < end_s:
        period += 1
        moment = Tick(T_START, period * PERIOD_NS, DT_S, DT_S, 0)
        stopping = step_stop(stopping, BOUNDS, moment)
    return stopping, period * DT_S


def test_a_retreat_reports_its_travel() -> None:
    """All of the travel when it arrives, in less than its time."""
    begun = retreat(0.002, 0.01)
    assert begun is not None
    done, took_s = run_stop(begun, 1.0)
    assert done.done
    assert 0.2 <= took_s < 0.5
    assert done.trip.text == "65 N pressed; the tool went back 2.0 mm"
    is_at_target = done.motion.T_base_flange is done.motion.T_target
    assert is_at_target, "it ends at rest at its target, and not before"


def test_a_retreat_that_does_not_arrive_ends_after_two_seconds() -> None:
    """Two seconds are allowed, one period more is not; it reports its travel."""
    begun = retreat(0.01, 0.001)
    assert begun is not None
    assert not run_stop(begun, RETREAT_WITHIN_S)[0].done
    done, took_s = run_stop(begun, 10.0)
    assert done.done
    assert took_s == pytest.approx(RETREAT_WITHIN_S + DT_S)
    went_mm = float(done.trip.text.removesuffix(" mm").rsplit(" ", 1)[1])
    assert 1.5 < went_mm <= 2.0


@pytest.mark.parametrize("press_N", [0.0, -1.0])
def test_without_a_press_there_is_no_retreat(press_N: float) -> None:
    """Exactly zero is no press: it has no direction."""
    assert retreat(0.002, 0.01, press_N) is None


class Refusing(JointStream):
    """Joints that cannot follow."""

    def __init__(self) -> None:
        """Start without an arm."""

    def follow(self, before: CommandedMotion, after: CommandedMotion, dt_s: float) -> Trip:
        """Refuse every set point."""
        return tripped("acceleration", "set by the test")


def test_a_fade_that_the_joints_cannot_follow_ends_at_once() -> None:
    """The arm is held with the first cause; no set point is released."""
    moving = at_rest(T_START)._replace(speeds=((0.1, 0.0, 0.0), (0.0, 0.0, 0.0)))
    cause = tripped("workspace", "set by the test")
    bounds = ArmBounds(Limits.of(CELL), CELL.tool.T_flange_tcp.pose, T_START)
    tick = Tick(T_START, 0, DT_S, 3.0 * DT_S, 0)
    stopping = step_stop(Stopping(cause, moving, 0, joints=Refusing()), bounds, tick)
    assert stopping.done
    assert stopping.trip is cause
    assert stopping.motion is moving


WIDE = ArmBounds(replace(Limits.of(CELL), step_m=10.0), CELL.tool.T_flange_tcp.pose, T_START)
LONGEST_NS = 3 * PERIOD_NS
MS = 1_000_000
USED = 0.95  # of the acceleration, by the regulator

gaps = st.lists(st.integers(1 * MS, LONGEST_NS), min_size=1, max_size=40)


class Follower:
    """The arbiter's stream, stepped at any times."""

    def __init__(self) -> None:
        """Rest at the start."""
        self.motion: CommandedMotion = at_rest(T_START)
        self.clock = SampleClock(0, 0)
        self.now_ns = 0

    def step(self, wake_ns: int, stamp_ns: int, height_m: float) -> float:
        """Follow a target above the start; return the height of the set point [m]."""
        self.now_ns += wake_ns
        longest_s = LONGEST_NS / 1e9
        self.clock, dt_s = self.clock.next(stamp_ns, self.now_ns, longest_s)
        tick = Tick(T_START, self.now_ns, wake_ns / 1e9, longest_s, 0)
        followed = follow(self.motion, above(height_m), WIDE, tick, dt_s=dt_s)
        assert isinstance(followed, CommandedMotion), followed
        self.motion = followed
        return float(followed.T_base_flange.translation[2] - T_START.translation[2])


def above(height_m: float) -> pin.SE3:
    """Return a pose above the start."""
    return pin.SE3(T_START.rotation, T_START.translation + np.array([0.0, 0.0, height_m]))


def ramp(gaps_ns: list[int]) -> list[tuple[int, float]]:
    """Return stamps and heights of a motion that accelerates, then brakes, within the limits."""
    height_m, speed_m_s, stamp_ns, path = 0.0, 0.0, 0, [(0, 0.0)]
    for number, gap_ns in enumerate(gaps_ns):
        dt_s = gap_ns / 1e9
        change_m_s = USED * LIMITS.accel_m_s2 * dt_s
        is_up = number < len(gaps_ns) // 2
        next_m_s = speed_m_s + change_m_s if is_up else max(speed_m_s - change_m_s, 0.0)
        speed_m_s = min(next_m_s, 0.9 * LIMITS.speed_m_s)
        height_m, stamp_ns = height_m + speed_m_s * dt_s, stamp_ns + gap_ns
        path.append((stamp_ns, height_m))
    return path


@given(gaps, st.lists(st.integers(0, 6 * MS), min_size=41, max_size=41))
def test_a_motion_within_the_limits_is_followed_whenever_the_arbiter_wakes(
    gaps_ns: list[int], delays_ns: list[int]
) -> None:
    """Found: wake-ups of 3.3 and 5 ms in turn made 25 % of overshoot out of a smooth release."""
    follower = Follower()
    for (stamp_ns, height_m), delay_ns in zip(ramp(gaps_ns), delays_ns, strict=False):
        wake_ns = max(stamp_ns + delay_ns - follower.now_ns, 1)
        assert abs(follower.step(wake_ns, stamp_ns, height_m) - height_m) < 1e-9
        assert not follower.motion.lags
        assert abs(follower.step(1, stamp_ns, height_m) - height_m) < 1e-9  # the same target again


def passed_ms(clock: SampleClock, steps: int, *, stamp_ms: int, now_ms: int) -> float:
    """Return the time that a clock gives for steps of these lengths [ms]."""
    total_s = 0.0
    for _ in range(steps):
        stamp_ns, now_ns = clock.stamp_ns + stamp_ms * MS, clock.now_ns + now_ms * MS
        clock, dt_s = clock.next(stamp_ns, now_ns, LONGEST_NS / 1e9)
        total_s += dt_s
    return 1e3 * total_s


def test_fast_stamps_gain_the_lead_and_no_more() -> None:
    """Twice as fast as the arbiter's clock, twenty steps of it; after a silence as much again."""
    longest_ms = LONGEST_NS / MS
    clock = SampleClock(5_000 * MS, 3_000 * MS)
    assert passed_ms(clock, 20, stamp_ms=8, now_ms=4) == pytest.approx(80.0 + longest_ms)
    silent, _ = clock.next(clock.stamp_ns, clock.now_ns + 500 * MS, LONGEST_NS / 1e9)
    assert passed_ms(silent, 20, stamp_ms=8, now_ms=4) == pytest.approx(80.0 + 2.0 * longest_ms)
    assert passed_ms(clock, 20, stamp_ms=4, now_ms=4) == pytest.approx(80.0)
    assert passed_ms(clock, 20, stamp_ms=3, now_ms=4) == pytest.approx(60.0)


def test_a_target_that_stood_for_long_has_brought_the_arm_to_rest() -> None:
    """The motion does not go on from the speed of long ago."""
    follower = Follower()
    for stamp_ns, height_m in ramp([PERIOD_NS] * 12)[:7]:
        follower.step(PERIOD_NS, stamp_ns, height_m)
    assert not follower.motion.is_at_rest
    height_m = follower.step(50 * MS, follower.clock.stamp_ns + 50 * MS, height_m)
    assert follower.motion.is_at_rest
    assert abs(height_m - ramp([PERIOD_NS] * 12)[6][1]) < 1e-9


def test_a_regulator_failure_that_is_a_fault_stops_at_once() -> None:
    """The table of faults requires this for a wrong sign: nothing fades."""
    world = world_with()
    run(world, (0.0, 0.0, -0.05), 40)
    world.propose(None, valid=False, reason="pushed sideways", code="sensor_sign")
    assert world.tick().kind == "hold"
    assert world.core.state == "FAULT"
    assert world.core.status().trips[0].code == "sensor_sign"


def test_a_target_for_the_controller_without_content_holds() -> None:
    """It may begin, but then it has no content."""
    world = world_with().make_armed()
    world.propose(None, host="controller")
    assert world.tick().permission is None
    assert world.core.status().trips[0].code == "regulator"


def test_a_set_point_that_the_joints_cannot_follow_is_the_joints_refusal() -> None:
    """The limit that it violates, before any limit of the flange behind it."""
    bounds = ArmBounds(Limits.of(CELL), CELL.tool.T_flange_tcp.pose, T_START)
    tick = Tick(T_START, 0, DT_S, 3.0 * DT_S, 0)
    found = follow(at_rest(T_START), T_START, bounds, tick, dt_s=DT_S, joints=Refusing())
    assert isinstance(found, Trip)
    assert found.code == "acceleration"


def test_the_time_of_set_points_is_that_of_the_wrenches() -> None:
    """Without a newer one the set point stands, however often the arbiter wakes."""
    world = world_with().make_active("regulator")
    places = []
    for periods in (0, 0, 0, 1, 2):
        world.propose(shifted(z_m=-0.01), wrench_stamp_ns=MS + periods * PERIOD_NS)
        places.append(distance_m(world.tick().pose, shifted()))
    assert 0.0 < places[0] == places[1] == places[2] < places[3] < places[4]
