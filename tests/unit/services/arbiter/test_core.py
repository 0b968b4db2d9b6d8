"""Permission and limits of motion: the arbiter's decisions, period by period."""

import pytest

from common.motion.convert import pose_of
from forcemesh.codec import MAX_BYTES, Header, encode
from forcemesh.faults import FAULTS, tripped
from forcemesh.messages import Accepted, RobotCommand, RobotStatus, Trip
from services.arbiter.core import Arbiter
from services.arbiter.inputs import robot_faults
from tests.fakes.arbiter_world import (
    DEADLINE_S,
    ROBOT_FAULTS,
    SPOILED,
    World,
    shifted,
    with_fault,
)

HEADER = Header(seq=1, epoch=2**62, boot="b" * 60, stamp_ns=10**15)
INPUTS = ["robot", "sensor", "wrench", "target"] + [
    f"{role}/health" for role in ("hub", "robot", "sensor", "wrench", "regulator")
]

each_input = pytest.mark.parametrize("name", INPUTS)
each_motion = pytest.mark.parametrize("motion", ["none", "operator", "regulator"])


def moving(motion: str, force_N: float = 0.0) -> World:
    """Return an arbiter that is ARMED, or ACTIVE under a commander, with a load on the tool."""
    world = World().make_armed()
    world.change("wrench", force_N=(0.0, 0.0, force_N))
    return world if motion == "none" else world.activate(motion)


def assert_stopped(world: World, command: RobotCommand, state: str, text: str) -> None:
    """Assert a hold without permission, with the reason in the status."""
    status = world.core.status()
    assert (command.kind, command.permission) == ("hold", None)
    assert (status.state, status.commander) == (state, "none")
    assert text in "; ".join(trip.text for trip in status.trips)
    assert text[:20] in command.reason
    assert status.clears


# --- arming ---------------------------------------------------------------------------------------


def test_an_arbiter_without_inputs_reports_its_start() -> None:
    """Its status is available before its first period."""
    status = World().core.status()
    assert (status.state, status.not_ready) == ("BOOT", ("starting",))
    assert (status.lease, status.ownership, status.goal_id) == (0, 0, 0)


def test_arming_needs_a_second_of_good_inputs() -> None:
    """The refusal has the time that they have been good; a gap restarts the second."""
    world = World()
    world.pass_s(0.9)
    reply = world.core.arm(world.inputs())
    assert (reply.accepted, reply.code) == (False, "not_ready")
    assert "inputs have been good for 0.9 s" in reply.text

    world.silent.add("sensor")
    world.tick()
    world.silent.clear()
    world.pass_s(0.9)
    assert not world.core.arm(world.inputs()).accepted
    world.pass_s(0.2)
    assert world.core.arm(world.inputs()).accepted


def test_a_process_with_another_cell_file_prevents_arming() -> None:
    """Two cell files in one cell: the refusal names the role."""
    world = World().make_ready()
    world.change("wrench/health", config_hash="0123456789ab")
    world.tick()

    assert "wrench runs with another cell file" in world.core.arm(world.inputs()).text


# --- inputs that fail in motion -------------------------------------------------------------------


@each_motion
@each_input
def test_an_input_that_fails_in_motion_is_a_fault_with_its_name(name: str, motion: str) -> None:
    """Swept: each input in turn, armed, under a goal and under force feedback."""
    world = moving(motion)
    world.silent.add(name)
    assert_stopped(world, world.tick(), "FAULT", f"{name} {SPOILED}")

    world.silent.clear()
    assert world.pass_s(2.0).permission is None
    assert world.core.state == "FAULT"
    assert world.core.arm(world.inputs()).code == "state"
    assert world.core.clear(world.inputs()).accepted
    assert world.core.arm(world.inputs()).accepted


@pytest.mark.parametrize(
    ("sensor", "wrench", "codes"),
    [
        ("sensor_fault", "sensor_fault", ["sensor_fault"]),
        ("", "sensor_fault", ["invalid"]),
        ("", "", ["invalid"]),
        ("sensor_fault", "unpaired", ["sensor_fault", "invalid"]),
        ("silent", "sensor_silent", ["sensor_silent"]),
        ("silent", "silent", ["sensor_silent", "stale"]),
    ],
)
def test_a_fault_of_the_sensor_is_reported_once(sensor: str, wrench: str, codes: list[str]) -> None:
    """The wrench repeats it: the same cause is no second one."""
    world = World().make_armed()
    for name, code in (("sensor", sensor), ("wrench", wrench)):
        if code == "silent":
            world.silent.add(name)
        else:
            world.change(name, valid=False, code=code, reason="broken gage")
    world.tick()
    assert [trip.code for trip in world.core.trips] == codes


def test_a_robot_that_is_not_ready_is_named_whatever_it_reports() -> None:
    """Without a cause, and with a code of another version; a silent one by its age alone."""
    world = World()
    world.change("robot", status=RobotStatus())
    assert [trip.code for trip in robot_faults(world.inputs())] == ["robot_error"]
    unknown = Trip(code="of_a_later_version", rule=999, text="the coolant is low")
    world.change("robot", status=RobotStatus(faults=(unknown,)))
    (trip,) = robot_faults(world.inputs())
    assert (trip.code, trip.text) == ("robot_error", "the coolant is low")
    world.silent.add("robot")
    assert robot_faults(world.inputs()) == []


@each_motion
@pytest.mark.parametrize("code", ROBOT_FAULTS)
def test_a_controller_that_is_no_longer_ready_is_a_fault(code: str, motion: str) -> None:
    """Swept: motors off, TEACH, an error, ... while the arm may move."""
    world = moving(motion)
    world.change("robot", status=with_fault(code))
    assert_stopped(world, world.tick(), "FAULT", FAULTS[code].remedy)
    assert world.core.trips[0].code == code


@pytest.mark.parametrize("name", ["robot", "sensor", "wrench", "target"])
def test_another_writer_in_motion_is_a_fault(name: str) -> None:
    """A second process on the topic, or a quick restart, requires an operator."""
    world = World().make_active("regulator")
    world.epochs[name] = 2
    command = world.tick()
    assert world.core.state == "FAULT"
    assert command.permission is None
    assert "has changed since arming" in world.core.status().trips[0].text
    assert world.core.clear(world.inputs()).accepted
    assert world.core.arm(world.inputs()).accepted
    assert world.tick(10).permission is not None


def test_a_fault_is_not_cleared_while_its_cause_is_present() -> None:
    """Clear is refused with the cause, and accepted after its end."""
    world = World().make_armed()
    world.silent.add("wrench")
    world.tick()
    refusal = world.core.clear(world.inputs())
    assert (refusal.accepted, world.core.state) == (False, "FAULT")
    assert "wrench spoiled" in refusal.text

    world.silent.clear()
    assert world.core.clear(world.inputs()).accepted
    assert world.core.state == "IDLE"
    assert world.core.status().trips == ()


# --- limits in motion -----------------------------------------------------------------------------


@each_motion
def test_a_robot_that_keeps_holding_ends_the_lease(motion: str) -> None:
    """It has a cause that the arbiter does not know; shortly after arming it may still hold."""
    world = moving(motion)
    world.change("robot", hold=tripped("robot_holds", "target out of reach"))
    assert_stopped(world, world.tick(), "HOLDING", "the robot holds: target out of reach")

    assert world.core.arm(world.inputs()).accepted
    assert world.tick(74).permission is not None
    assert world.tick().permission is None  # after 0.3 s
    assert world.core.arm(world.inputs()).accepted
    world.change("robot", hold=None)
    assert world.pass_s(1.0).permission is not None


# --- motion that no command explains --------------------------------------------------------------


@pytest.mark.parametrize(
    ("before", "is_found"),
    [("armed", True), ("held", True), ("cleared", False), ("regulated", False), ("locked", False),
     ("restarted", False)],
)  # fmt: skip
def test_an_arm_that_moves_though_nothing_moves_it_is_a_fault(before: str, is_found: bool) -> None:
    """By the reports alone; not where a commander, a person or another process moves it."""
    world = World().make_armed()
    if before == "regulated":
        world.activate("regulator")
    elif before != "armed":
        world.core.hold("enough")
    if before == "cleared":
        world.core.clear(world.inputs())
    if before == "locked":
        world.change("robot", status=with_fault("robot_lock"))
    world.pass_s(1.0)
    if before == "restarted":
        world.epochs["robot"] = 2
    world.place(pose_of(shifted(x_m=0.004)))
    world.tick(4)
    assert ("unexplained_motion" in [trip.code for trip in world.core.trips]) == is_found
    assert (world.core.state == "FAULT") == is_found


# --- hold -----------------------------------------------------------------------------------------


def test_hold_is_accepted_in_every_state() -> None:
    """This includes states at rest; a hold never leads to a state that may move."""
    world = World()
    for prepare, state in (
        (lambda: None, "BOOT"),
        (world.make_ready, "HOLDING"),
        (lambda: None, "HOLDING"),
        (lambda: world.core.arm(world.inputs()), "HOLDING"),
    ):
        prepare()
        assert world.core.hold("again").accepted
        assert world.core.state == state
    assert world.core.arm(world.inputs()).accepted
    world.silent.add("robot")
    world.tick()
    assert world.core.hold("again").accepted
    assert world.core.state == "FAULT"


@pytest.mark.parametrize("letter", ["x", "ж", "\U0001f916"])
def test_status_and_command_fit_for_any_length_of_reasons(letter: str) -> None:
    """Status and command can always be sent: a text must not silence the arbiter."""
    world = World().make_ready()
    for name in list(world.messages):
        world.change(name, valid=False, reason=letter * 370)
    for _ in range(12):
        world.core.hold(letter * 500)
        command = world.tick()
        assert len(encode(HEADER, command)) < MAX_BYTES / 2
        assert len(encode(HEADER, world.core.status())) < MAX_BYTES
    assert letter in world.core.status().trips[-1].text
    assert world.core.status().not_ready


# --- restarts ------------------------------------------------------------------------------------


def test_a_new_arbiter_reports_that_another_one_commanded_before():
    """After kill and restart the status names the restart until the next arming."""
    world = World()
    world.change(
        "robot",
        accepted=Accepted(epoch=7, seq=90, at_ns=1),
        hold=tripped("robot_holds", "not armed"),
    )
    world.make_ready()
    assert [trip.code for trip in world.core.status().trips] == ["writer"]
    world.change("robot", hold=None)
    assert world.core.arm(world.inputs()).accepted
    assert world.core.status().trips == ()


def test_an_arbiter_that_continues_earlier_leases_is_no_restart():
    """In a replay: the next lease and ownership number follow those of before."""
    world = World()
    world.core = Arbiter(world.cell, command_deadline_s=DEADLINE_S, numbers=(3, 8))
    world.change("robot", accepted=Accepted(epoch=7, seq=90, at_ns=1, ownership=8))
    status = world.make_ready().core.status()
    assert (status.trips, status.lease, status.ownership) == ((), 3, 8)
    assert world.core.arm(world.inputs()).accepted
    status = world.core.status()
    assert (status.lease, status.ownership) == (4, 9)


def test_a_process_begins_without_a_lease():
    """Only a replay gives other numbers."""
    status = World().core.status()
    assert (status.lease, status.ownership, status.goal_id) == (0, 0, 0)


@pytest.mark.parametrize(
    ("hold", "code"),
    [
        (None, "robot_holds"),
        (tripped("tracking", "HOLD on the pendant"), "tracking"),
        (tripped("no_lease", "of another start"), "robot_holds"),
    ],
)
def test_a_robot_with_another_challenge_has_ended_the_lease(hold: Trip | None, code: str):
    """At once, while one that still holds has time to answer; the robot's own cause is named."""
    world = World().make_ready()
    assert world.core.arm(world.inputs()).accepted
    world.change("robot", hold=hold)
    assert world.tick().permission is not None
    world.change("robot", challenge=1)
    assert world.tick().permission is None
    assert (world.core.state, world.core.status().trips[-1].code) == ("HOLDING", code)


def test_a_finding_of_the_robot_ends_a_hold_in_fault() -> None:
    """Its own monitor may see what no report shows."""
    world = World().make_armed()
    world.core.hold("enough")
    world.tick()
    world.change("robot", hold=tripped("unexplained_motion", "3 mm"))
    world.tick()
    assert world.core.state == "FAULT"
    assert [trip.code for trip in world.core.trips] == ["hold", "unexplained_motion"]
    world.change("robot", hold=None)
    assert world.core.clear(world.inputs()).accepted


def test_an_error_of_the_robot_that_comes_after_the_stop_is_added_once() -> None:
    """It may be the cause; the same one is no second cause."""
    world = World().make_armed()
    world.silent.add("sensor")
    world.tick()
    error = tripped("robot_error", "error 1203", value=1203.0)
    world.change("robot", status=RobotStatus(faults=(error,)))
    world.tick(3)
    assert [trip.code for trip in world.core.trips] == ["sensor_silent", "robot_error"]
