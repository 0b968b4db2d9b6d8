"""Permission and limits of motion: the arbiter's decisions, period by period."""

import numpy as np
import pinocchio as pin
import pytest

from common.motion.convert import pose_of, record_of
from common.motion.frames import rotation_from_vector
from common.motion.limits import Limits
from forcemesh.faults import FAULTS, tripped
from forcemesh.messages import MAY_MOVE, RobotCommand
from tests.fakes.arbiter_world import (
    CELL,
    MOVE_JOINTS,
    ROBOT_FAULTS,
    SPOILED,
    STOPPED,
    T_START,
    World,
    shifted,
    with_fault,
    with_limits,
)

LIMITS = CELL.limits
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


def test_the_first_command_is_hold() -> None:
    """An arbiter that has just started permits nothing for any input."""
    world = World()
    world.propose(shifted(z_m=-0.001))
    assert world.tick().permission is None


def test_an_arbiter_without_inputs_reports_its_start() -> None:
    """Its status is available before its first period."""
    status = World().core.status()
    assert (status.state, status.not_ready) == ("BOOT", ("starting",))


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


@each_input
def test_arming_names_the_faulty_input(name: str) -> None:
    """Swept: each input in turn; the refusal has nothing else."""
    world = World().make_ready()
    world.silent.add(name)
    world.tick()
    reply = world.core.arm(world.inputs())

    assert (reply.accepted, reply.text) == (False, f"{name} {SPOILED}")
    assert world.core.status().not_ready == (f"{name} {SPOILED}",)


@pytest.mark.parametrize("code", ROBOT_FAULTS)
def test_arming_names_the_fault_of_the_controller(code: str) -> None:
    """Swept: each fault of the robot, with the remedy."""
    world = World().make_ready()
    world.change("robot", status=with_fault(code))
    world.tick()

    reply = world.core.arm(world.inputs())
    assert (reply.code, reply.text) == (code, FAULTS[code].remedy)


def test_a_process_with_another_cell_file_prevents_arming() -> None:
    """Two cell files in one cell: the refusal names the role."""
    world = World().make_ready()
    world.change("wrench/health", config_hash="0123456789ab")
    world.tick()

    assert "wrench runs with another cell file" in world.core.arm(world.inputs()).text


def test_a_regulator_that_is_stopped_does_not_prevent_arming() -> None:
    """Its target may be invalid for any reason, but must be received."""
    world = World().make_ready()
    world.change("target", reason="arbiter/status stale: 600 ms old, limit 500 ms")
    world.tick()

    assert world.core.arm(world.inputs()).accepted


def test_each_arming_has_a_new_lease() -> None:
    """Numbers only grow, and the command has the announced one."""
    world = World().make_ready()
    leases = []
    for _ in range(3):
        assert world.core.arm(world.inputs()).accepted
        command = world.tick()
        assert command.permission is not None
        assert command.permission.deadline_s == 0.04
        leases.append(command.permission.lease)
        assert world.core.status().lease == leases[-1]
        assert world.core.arm(world.inputs()).code == "already"
        world.core.hold("enough")
        world.tick()
    assert leases == [1, 2, 3]


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


@each_motion
@pytest.mark.parametrize("name", ["robot", "sensor", "wrench"])
def test_an_invalid_input_in_motion_is_a_fault(name: str, motion: str) -> None:
    """The trip has the reason of the input."""
    world = moving(motion)
    world.change(name, valid=False, reason="no cable")
    assert_stopped(world, world.tick(), "FAULT", f"{name} invalid: no cable")


def codes_of_invalid(sensor: str, wrench: str) -> list[str]:
    """Return the trips when sensor and wrench are not valid, with these codes."""
    world = World().make_armed()
    world.change("sensor", valid=False, code=sensor, reason="broken gage")
    world.change("wrench", valid=False, code=wrench, reason="the sensor says fault: broken gage")
    world.tick()
    return [trip.text for trip in world.core.trips]


@pytest.mark.parametrize(
    "codes", [("sensor_fault", "sensor_fault"), ("", "sensor_fault"), ("", "")]
)
def test_a_fault_of_the_sensor_is_reported_once(codes: tuple[str, str]) -> None:
    """The wrench repeats it: the same cause is no second one."""
    assert codes_of_invalid(*codes) == ["sensor invalid: broken gage"]


def test_a_wrench_fault_is_reported_in_addition_to_the_sensors() -> None:
    """Two faults at once are two trips."""
    assert len(codes_of_invalid("sensor_fault", "unpaired")) == 2


def test_a_silent_sensor_is_reported_once_and_a_silent_wrench_in_addition() -> None:
    """The wrench's report of the sensor is left out; its own silence is not."""
    world = World().make_armed()
    world.silent.add("sensor")
    world.change("wrench", valid=False, code="sensor_silent", reason="sensor/wrench stale")
    world.tick()
    assert [trip.code for trip in world.core.trips] == ["sensor_silent"]
    world = World().make_armed()
    world.silent |= {"sensor", "wrench"}
    world.tick()
    assert [trip.code for trip in world.core.trips] == ["sensor_silent", "stale"]


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
def test_the_force_ceiling_holds(motion: str) -> None:
    """The ceiling itself is allowed; a newton more is a hold with both numbers."""
    world = moving(
        motion, LIMITS.force_N - 10.0
    )  # from this load limits.move_rise_N does not trip first
    world.change("wrench", force_N=(0.0, 0.0, LIMITS.force_N))
    assert world.tick().permission is not None
    world.change("wrench", force_N=(0.0, 0.0, LIMITS.force_N + 1.0))
    assert_stopped(world, world.tick(), "HOLDING", "force 61.0 N is above the ceiling")
    assert world.core.status().trips[0].limit == LIMITS.force_N

    assert world.core.arm(world.inputs()).code == "force"


def test_the_torque_ceiling_holds() -> None:
    """The same holds about the TCP."""
    world = World().make_armed()
    world.change("wrench", torque_Nm=(0.0, LIMITS.torque_Nm + 0.1, 0.0))
    assert_stopped(world, world.tick(), "HOLDING", "torque 10.10 N m is above the ceiling")


@each_motion
@pytest.mark.parametrize(
    ("axis", "to_m"), [(0, -0.41), (0, 0.41), (1, 0.19), (1, 0.81), (2, -0.05), (2, 0.77)]
)
def test_a_tcp_that_leaves_the_workspace_holds(motion: str, axis: int, to_m: float) -> None:
    """Swept: each wall, checked at the measured TCP, 160 mm below the flange."""
    world = moving(motion)
    p = T_START.translation.copy()
    p[axis] = to_m
    world.place(pin.SE3(T_START.rotation, p))
    assert_stopped(world, world.tick(), "HOLDING", f"TCP {'xyz'[axis]} = ")


@each_motion
def test_the_tether_holds_for_every_kind_of_motion(motion: str) -> None:
    """The travel since arming is measured: a joint move has no end pose to check before."""
    world = with_limits(tether_m=0.2).make_armed()
    if motion == "operator":
        assert world.core.move(MOVE_JOINTS, world.inputs()).accepted
    elif motion == "regulator":
        world.propose(record_of(T_START))
    world.tick()
    world.place(pose_of(shifted(y_m=-0.1999)))
    world.messages["target"] = STOPPED
    assert world.tick().permission is not None
    world.place(pose_of(shifted(y_m=-0.201)))
    assert_stopped(world, world.tick(), "HOLDING", "201 mm away from the pose at arming")


@pytest.mark.parametrize("motion", ["operator", "regulator"])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_tether_holds_a_tool_that_keeps_turning(motion: str, axis: int) -> None:
    """The rotation since arming is measured: steps within the other limits end within one turn.

    A tool that keeps turning tears its cables.
    """
    world = moving(motion)
    limit_deg = np.degrees(Limits.of(CELL).tether_rad)
    turned_deg = 0.0
    while world.core.state in MAY_MOVE and turned_deg < 360.0:
        turned_deg += 0.5
        turn = np.radians(turned_deg) * np.eye(3)[axis]
        world.place(pin.SE3(rotation_from_vector(turn) @ T_START.rotation, T_START.translation))
        world.messages["target"] = STOPPED
        world.tick()
    assert turned_deg == pytest.approx(limit_deg, abs=0.6)
    assert world.core.status().trips[0].code == "tether"


@each_motion
def test_a_robot_that_keeps_holding_ends_the_lease(motion: str) -> None:
    """It has a cause that the arbiter does not know; shortly after arming it may still hold."""
    world = moving(motion)
    world.change("robot", hold=tripped("robot_holds", "target out of reach"))
    assert_stopped(world, world.tick(), "HOLDING", "the robot holds: target out of reach")

    assert world.core.arm(world.inputs()).accepted
    assert world.tick(50).permission is not None
    world.change("robot", hold=None)
    assert world.pass_s(1.0).permission is not None


@pytest.mark.parametrize("motion", ["none", "operator"])
def test_a_failed_regulator_stops_no_other_commander(motion: str) -> None:
    """It did not command: the goal continues, the arm stays armed."""
    world = moving(motion)
    world.propose(None, valid=False, reason="wrench stale")
    kind = {"none": "idle", "operator": "goal"}[motion]
    assert {world.tick().kind for _ in range(10)} == {kind}


def test_a_failed_regulator_holds() -> None:
    """Invalid with a mode: it runs and cannot continue. Invalid without one: it was stopped."""
    world = World().make_active("regulator")
    world.change("target", valid=False, reason="wrench stale")
    assert_stopped(world, world.tick(), "HOLDING", "the regulator gave up: wrench stale")

    world = World().make_active("regulator")
    world.messages["target"] = STOPPED
    command = world.tick()
    assert (command.kind, world.core.state) == ("idle", "ARMED")
    assert command.permission is not None


# --- motion that no command explains --------------------------------------------------------------


def goes_on(world: World) -> None:
    """Leave everything as it is."""


def holds(world: World) -> None:
    """Request a hold."""
    world.core.hold("enough")


def clears(world: World) -> None:
    """Hold, then return to IDLE."""
    world.core.hold("enough")
    world.core.clear(world.inputs())


def regulates(world: World) -> None:
    """Let the regulator command the arm."""
    world.activate("regulator")


def locks(world: World) -> None:
    """Hold, and switch TEACH LOCK on: a person may guide the arm."""
    world.core.hold("enough")
    world.change("robot", status=with_fault("robot_lock"))


def restarts(world: World) -> None:
    """Hold, and restart the robot's process when the arm is about to move."""
    world.core.hold("enough")
    world.pass_s(1.0)
    world.epochs["robot"] = 2


@pytest.mark.parametrize(
    ("prepare", "is_found"),
    [(goes_on, True), (holds, True), (clears, False), (regulates, False), (locks, False),
     (restarts, False)],
)  # fmt: skip
def test_an_arm_that_moves_though_nothing_moves_it_is_a_fault(prepare, is_found: bool) -> None:
    """In ARMED and HOLDING, by the reports alone: the robot's process does not notice."""
    world = World().make_armed()
    prepare(world)
    if prepare is not restarts:
        world.pass_s(1.0)
    world.place(pose_of(shifted(x_m=0.004)))
    world.tick(4)
    assert ("unexplained_motion" in [trip.code for trip in world.core.trips]) == is_found
    assert (world.core.state == "FAULT") == is_found


def test_a_finding_of_the_robot_ends_a_hold_in_fault() -> None:
    """Its own monitor may see what no report shows."""
    world = World().make_armed()
    holds(world)
    world.tick()
    world.change("robot", hold=tripped("unexplained_motion", "3 mm"))
    world.tick()
    assert world.core.state == "FAULT"
    world.change("robot", hold=None)
    assert world.core.clear(world.inputs()).accepted
