"""Corners of the pure modules that no other test comes to: nothing known yet, nothing finite."""

from dataclasses import replace
from math import radians

import numpy as np
import pinocchio as pin
import pytest

from common.bus.memory_bus import MemoryCall, MemoryTransport
from common.motion.last_check import LastCheck
from common.motion.limits import JointTrack, Limits
from common.motion.setpoint_monitor import SetpointMonitor
from forcemesh import topics
from forcemesh.codec import encode_record
from forcemesh.messages import ZERO3, Goal, RobotState, RobotStatus, Speed, Trip
from forcemesh.requests import HoldRequest
from services.arbiter.inputs import robot_faults
from services.arbiter.preflight import CHECKS, PreflightContext, Terms
from services.regulator.guards import GuardSample, GuardSettings, GuardState, watch
from tests.fakes.arbiter_world import CELL, T_START, World, with_fault
from tests.unit.forcemesh.conftest import Line
from tests.unit.forcemesh.test_inbox import bus_of

LIMITS = Limits.of(CELL)
JOINTS = (0.0, 0.0, -1.5, 0.0, -1.5, 0.0)


# --- the arbiter's inputs -------------------------------------------------------------------------


def limit_check(world: World) -> list[Trip]:
    """Return the findings of the preflight about force and workspace alone."""
    (check,) = [check for check in CHECKS if check.what.startswith("force below its ceiling")]
    context = PreflightContext(world.inputs(), Terms.of(CELL), 9.0, blind=False)
    return list(filter(None, check.failures(context)))


@pytest.mark.parametrize("name", ["robot", "wrench"])
def test_a_message_that_is_not_received_is_not_judged_otherwise(name: str) -> None:
    """Neither lights nor limits are judged by an old message; its age is reported elsewhere."""
    world = World()
    world.change("robot", status=with_fault("robot_error"))
    world.change("wrench", force_N=(0.0, 0.0, 2.0 * CELL.limits.force_N))
    assert limit_check(world) != []
    world.silent.add(name)
    assert limit_check(world) == []
    assert bool(robot_faults(world.inputs())) == (name != "robot")


# --- the last check -------------------------------------------------------------------------------


def test_before_a_lease_no_move_of_joints_is_let_through_and_no_tether_pulls() -> None:
    """An arm far from nowhere in particular breaks no rule; to move it needs a lease."""
    guard = LastCheck(CELL)
    assert guard.arm(T_START, JOINTS, 0) is None
    for kind in ("joints", "by"):
        goal = Goal.from_dict({"id": 1, "kind": kind, "joint_rad": JOINTS})
        trip = guard.goal(goal, Speed(), T_START, JOINTS)
        assert trip is not None
        assert trip.code == "no_lease"


def test_from_an_unknown_place_the_end_of_a_move_counts() -> None:
    """No path can be sampled from nowhere; a good end is let through, a bad one is not."""
    guard = LastCheck(CELL)
    guard.start(T_START)
    nowhere = pin.SE3(np.eye(3), np.full(3, np.nan))
    here = World().messages["robot"]
    assert isinstance(here, RobotState)
    pose = {"position_m": here.position_m, "orientation_xyzw": here.orientation_xyzw}
    goal = Goal.from_dict({"id": 1, "kind": "pose", "pose": pose})
    assert guard.goal(goal, Speed(), nowhere, JOINTS) is None
    far = Goal.from_dict({"id": 1, "kind": "pose", "pose": pose | {"position_m": (9.0,) * 3}})
    trip = guard.goal(far, Speed(), nowhere, JOINTS)
    assert trip is not None
    assert trip.code == "workspace"


def test_without_samples_no_speed_is_known() -> None:
    """Unknown is not zero."""
    assert JointTrack().speed_rad_s is None


def turned(turn_rad: float) -> pin.SE3:
    """Return the start, turned about the base's z axis."""
    return pin.SE3(pin.utils.rotate("z", turn_rad) @ T_START.rotation, T_START.translation)


def test_a_turn_is_limited_as_a_travel_is() -> None:
    """One set point by the step; a stream that speeds up gently, by the speed, in any window."""
    limits, period_s = CELL.limits, 4e-3
    budget, speed = SetpointMonitor(Limits.of(CELL)), radians(limits.speed_deg_s)
    assert budget.begin(T_START, 0) is None
    trip = budget.check(turned(radians(1.1 * limits.step_deg)), 0)
    assert trip is not None
    assert (trip.code, trip.limit) == ("speed", speed)

    turn_rad, speed_rad_s, trip, now_ns = 0.0, 0.0, None, 1_000_000_000
    assert budget.begin(T_START, now_ns) is None
    while trip is None and now_ns < 3_000_000_000:
        now_ns += round(period_s * 1e9)
        faster = speed_rad_s + 0.5 * radians(limits.accel_deg_s2) * period_s
        speed_rad_s = min(faster, 1.5 * speed)
        turn_rad += speed_rad_s * period_s
        trip = budget.check(turned(turn_rad), now_ns)
    assert trip is not None
    assert (trip.code, trip.limit) == ("rate", pytest.approx(1.25 * 0.25 * speed))
    assert speed_rad_s > speed


# --- the regulator's guards -----------------------------------------------------------------------


@pytest.mark.parametrize("turns", [False, True])
def test_turning_does_work_only_where_the_mode_turns_the_tool(turns: bool) -> None:
    """2 N m over a tenth of a radian are 0.2 J; in mode position the tool turns for others."""
    settings = GuardSettings.of(CELL)
    sample = GuardSample(
        ZERO3, (0.0, 0.0, 2.0), T_START, ZERO3, ZERO3, contact="contact", error=(0.0,) * 6,
        limited=(False,) * 3, setpoint_N=0.0, press_axis=(0.0, 0.0, -1.0), along_tool=True,
        side_trips=True, presses=True, rotates=turns, follows=False, dt_s=0.004,
    )  # fmt: skip
    remembered = GuardState(touched=True)
    watch(remembered, sample, settings)
    turned = pin.SE3(pin.utils.rotate("z", 0.1) @ T_START.rotation, T_START.translation)
    watch(remembered, replace(sample, T_base_tcp=turned), settings)
    assert remembered.environment_work_J == pytest.approx(0.2 if turns else 0.0)


# --- readers and inboxes --------------------------------------------------------------------------


def test_many_requests_at_once_wait_their_turn() -> None:
    """So many in one step and no more; the rest is served next, in the order they came."""
    transport = MemoryTransport()
    inbox = bus_of("arbiter", transport).inbox(topics.HOLD)
    reasons = [f"reason {number}" for number in range(6)]
    calls = [MemoryCall(encode_record(HoldRequest(reason=reason))) for reason in reasons]
    transport.serve("demo/request/hold").waiting.extend(calls)
    first = [incoming.request.reason for incoming in inbox.take_all()]
    then = [incoming.request.reason for incoming in inbox.take_all()]
    assert (first, then) == (reasons[:4], reasons[4:])


def test_to_wait_for_a_message_is_to_wait_at_its_source(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the time that is given; nothing is taken by it."""
    line, waits = Line(), list[float]()
    monkeypatch.setattr(type(line.source), "wait", lambda source, s: waits.append(s))
    line.reader.wait(0.25)
    assert waits == [0.25]
    assert line.read().code == "missing"


def test_a_robot_that_is_not_ready_is_named_whatever_it_reports() -> None:
    """Without a cause, and with a code of another version: both end in the robot's own fault."""
    world = World()
    world.change("robot", status=RobotStatus())
    assert [trip.code for trip in robot_faults(world.inputs())] == ["robot_error"]
    unknown = Trip(code="of_a_later_version", rule=999, text="the coolant is low")
    world.change("robot", status=RobotStatus(faults=(unknown,)))
    (trip,) = robot_faults(world.inputs())
    assert (trip.code, trip.text) == ("robot_error", "the coolant is low")


def test_the_last_check_refuses_a_goal_for_another_number_of_joints() -> None:
    """It is neither broadcast nor cut."""
    goal = Goal(id=1, kind="joints", joint_rad=(0.0,) * 7)
    guard = LastCheck(CELL)
    guard.start(T_START)
    trip = guard.goal(goal, Speed(), T_START, JOINTS)
    assert trip is not None
    assert (trip.code, trip.value, trip.limit) == ("joint_count", 7, 6)
