"""What must be so before the arm is armed, for all or for jog alone."""

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from common.config.cell import CellConfig
from common.config.load import cell_from_tree
from forcemesh.messages import ArmPurpose, RegulatorTarget, WrenchAtTcp
from services.arbiter.preflight import CHECKS, PreflightContext, Terms, failed_checks, load_text
from tests.fakes.arbiter_world import CELL, FIT, MOVE_DOWN, T_START, World, shifted

IDLE_MAX_N = CELL.force.idle_max_N
# As the documentation says them, not as the code does.
RESIDUAL_S, REST_S, REST_POSITION_M = 0.5, 0.2, 2e-4


def ready(**changes: object) -> World:
    """Return an arbiter whose inputs have been good, in a cell with other values by dotted name."""
    return World(cell_with(**changes)).make_ready()


def cell_with(**changes: object) -> CellConfig:
    """Return the demo's cell with values put in by section__name."""
    tree = CELL.model_dump()
    for name, value in changes.items():
        section, key = name.split("__")
        tree[section][key] = value
    return cell_from_tree(tree, "test")


def beside(z_m: float) -> pin.SE3:
    """Return a pose a little beside the start."""
    return T_START * pin.SE3(np.eye(3), np.array([0.0, 0.0, z_m]))


def feel(world: World, force_N: float) -> None:
    """Let the wrench say a force."""
    world.change("wrench", force_N=(0.0, 0.0, force_N))


def refused_with(world: World) -> tuple[str, bool]:
    """Return the code with which arming for all is refused, and whether jog is possible."""
    everything = world.core.arm(world.inputs())
    assert not everything.accepted
    return everything.code, world.core.arm(world.inputs(), "jog").accepted


# --- what concerns every motion -------------------------------------------------------------------


def test_an_arm_that_was_just_moving_is_not_armed() -> None:
    """Not for jog either: where it is commanded and where it is must be the same; then it is."""
    world = World().make_ready()
    world.place(beside(2 * REST_POSITION_M))
    world.tick()
    assert refused_with(world) == ("moving", False)
    world.pass_s(REST_S - 0.02)
    assert refused_with(world) == ("moving", False)
    world.pass_s(0.04)
    assert world.core.arm(world.inputs()).accepted


def test_an_arm_whose_controller_says_that_it_moves_is_not_armed() -> None:
    """Also where its pose does not show it."""
    world = World().make_ready()
    world.change("robot", status=FIT.model_copy(update={"moving": True}))
    world.pass_s(1.0)
    assert refused_with(world) == ("moving", False)
    assert any("at rest" in line for line in world.core.status().not_ready)


def test_noise_of_the_pose_is_rest() -> None:
    """A tenth of a millimetre to and fro, as a coarse scale of the packet makes it."""
    world = World().make_ready()
    for number in range(50):
        world.place(beside(1e-4 * (number % 2)))
        world.tick()
    assert world.core.arm(world.inputs()).accepted


def test_motion_is_no_complaint_while_it_is_wanted() -> None:
    """The status of an arm that moves under a goal does not say that it should rest."""
    world = World().make_active("operator")
    world.change("robot", status=FIT.model_copy(update={"moving": True}))
    world.tick()
    assert world.core.status().not_ready == ()


@pytest.mark.parametrize("purpose", ["all", "jog"])
def test_the_ceiling_and_the_workspace_hold_for_every_purpose(purpose: ArmPurpose) -> None:
    """Jog is no way around a limit."""
    world = World().make_ready()
    feel(world, CELL.limits.force_N + 1.0)
    assert world.core.arm(world.inputs(), purpose).code == "force"


# --- free space, calibration, approach ------------------------------------------------------------


def test_what_is_left_in_free_space_prevents_force_feedback_not_jog() -> None:
    """Half a second of it; with both numbers, and told in the status before anybody asks (H28)."""
    world = World().make_ready()
    feel(world, IDLE_MAX_N + 0.5)
    world.pass_s(RESIDUAL_S - 0.02)
    assert world.core.status().not_ready == ()
    world.pass_s(0.06)
    (line,) = world.core.status().not_ready
    assert "2.5 N are left" in line
    reply = world.core.arm(world.inputs())
    assert (reply.code, reply.value, reply.limit) == ("payload", IDLE_MAX_N + 0.5, IDLE_MAX_N)
    assert world.core.arm(world.inputs(), "jog").accepted


def test_a_drift_of_a_tenth_of_a_newton_per_second_is_found() -> None:
    """Within half a second of leaving what is allowed, also while the arm is armed."""
    world = World().make_armed()
    for tenths in range(40):
        feel(world, 0.1 * tenths)
        world.pass_s(1.0)
        said = [line for line in world.core.status().not_ready if "left" in line]
        assert bool(said) == (0.1 * tenths > IDLE_MAX_N)
    assert world.core.state == "ARMED"


def test_a_touch_that_ends_is_not_remembered() -> None:
    """Shorter than half a second, again and again: nothing is left."""
    world = World().make_ready()
    for _ in range(5):
        feel(world, 20.0)
        world.pass_s(RESIDUAL_S - 0.04)
        feel(world, 0.1)
        world.tick()
    assert world.core.arm(world.inputs()).accepted


def test_contact_that_the_regulator_found_is_expected() -> None:
    """Held while it presses, armed again right there: the last free space counts."""
    world = World().make_active("regulator")
    world.messages["target"] = RegulatorTarget(mode="position", pose=shifted(), contact="contact")
    feel(world, 20.0)
    world.pass_s(2.0)
    world.core.hold("coffee")
    world.messages["target"] = RegulatorTarget(valid=False, reason="stopped")
    world.pass_s(5.0)
    assert world.core.status().not_ready == ()
    assert world.core.arm(world.inputs()).accepted


@pytest.mark.parametrize("cause", ["tared", "restarted"])
def test_with_another_bias_contact_is_not_expected_any_more(cause: str) -> None:
    """Nobody knows then which part of the force is contact: jog away, tare."""
    world = World().make_active("regulator")
    world.messages["target"] = RegulatorTarget(mode="position", pose=shifted(), contact="contact")
    feel(world, 20.0)
    world.tick(2)
    world.core.hold("coffee")
    world.messages["target"] = RegulatorTarget(valid=False, reason="stopped")
    if cause == "tared":
        world.change("wrench", calibration="another")
    else:
        world.epochs["wrench"] = 7
    world.pass_s(1.2)
    assert refused_with(world) == ("payload", True)


def test_after_contact_has_ended_the_free_space_is_judged_again() -> None:
    """Moved away, then something is left: that is not the contact of before."""
    world = World().make_active("regulator")
    world.messages["target"] = RegulatorTarget(mode="position", pose=shifted(), contact="contact")
    feel(world, 20.0)
    world.tick(2)
    world.core.hold("coffee")
    world.messages["target"] = RegulatorTarget(valid=False, reason="stopped")
    feel(world, 0.0)
    world.tick()
    feel(world, 5.0)
    world.pass_s(1.0)
    assert refused_with(world) == ("payload", True)


def test_a_calibration_that_does_not_hold_is_told_and_jog_is_possible() -> None:
    """The wrench says so itself, and why (H45)."""
    world = World().make_ready()
    world.change("wrench", calibrated=False, calibration_fault="another sensor")
    assert refused_with(world) == ("payload", True)
    world.tick()
    assert "another sensor" in " ".join(world.core.status().not_ready)


def test_a_torque_that_is_left_in_free_space_is_told_like_a_force() -> None:
    """A wrong centre of mass shows nowhere else."""
    world = World().make_ready()
    over_Nm = 1.1 * CELL.force.idle_max_Nm
    world.change("wrench", torque_Nm=(0.0, over_Nm, 0.0))
    world.pass_s(1.0)
    reply = world.core.arm(world.inputs())
    assert (reply.code, reply.limit) == ("payload", CELL.force.idle_max_Nm)
    assert reply.value == pytest.approx(over_Nm)
    assert "N m" in reply.text


def running() -> World:
    """Return a world in which the regulator moves the arm."""
    world = World().make_active("regulator")
    world.propose(shifted())
    world.tick(3)
    return world


@pytest.mark.parametrize(
    "changes",
    [{"calibration": "another"}, {"calibrated": False, "calibration_fault": "another sensor"}],
)
def test_force_feedback_ends_when_its_calibration_does(changes: dict[str, Any]) -> None:
    """It would answer the step of the force with motion."""
    world = running()
    world.change("wrench", **changes)
    assert world.tick().kind == "hold"
    assert [trip.code for trip in world.core.status().trips] == ["calibration"]


def test_a_calibration_may_change_while_a_person_moves_the_arm() -> None:
    """Jog does not look at the force but for its ceiling."""
    world = World().make_active("operator")
    world.change("wrench", calibration="another")
    assert world.tick().kind == "goal"
    assert world.core.status().trips == ()


def test_an_approach_that_is_too_fast_for_the_stiffness_is_refused_with_the_numbers() -> None:
    """The boundary itself is allowed: force budget over stiffness times tau."""
    limit_m_s = CELL.approach_limit_m_s
    world = ready(force__approach_m_s=limit_m_s)
    assert world.core.arm(world.inputs()).accepted
    world = ready(force__approach_m_s=limit_m_s * 1.01)
    reply = world.core.arm(world.inputs())
    assert (reply.code, reply.limit) == ("approach_speed", limit_m_s)
    assert reply.value == pytest.approx(1.01 * limit_m_s)
    assert f"{limit_m_s * 1e3:.2f} mm/s" in reply.text
    assert world.core.arm(world.inputs(), "jog").accepted


# --- jog ------------------------------------------------------------------------------------------


def test_jog_is_possible_in_contact_and_moves_away() -> None:
    """Just below the ceiling, nothing known of free space: armed, and a move begins."""
    world = World()
    feel(world, CELL.limits.force_N - 1.0)
    world.pass_s(1.2)
    assert refused_with(world) == ("payload", True)
    world.pass_s(0.5)
    status = world.core.status()
    assert (status.state, status.armed_for) == ("ARMED", "jog")
    assert world.core.move(MOVE_DOWN, world.inputs()).accepted
    assert world.tick().kind == "goal"


def test_under_jog_the_regulator_is_not_followed() -> None:
    """Whatever it proposes: the arm is idle, and stays armed."""
    world = World().make_ready()
    assert world.core.arm(world.inputs(), "jog").accepted
    world.pass_s(0.5)
    world.propose(shifted())
    assert {world.tick().kind for _ in range(20)} == {"idle"}


def test_from_jog_to_all_leads_through_hold() -> None:
    """Arming for less than it is armed for changes nothing, for more is refused with the way."""
    world = World().make_ready()
    assert world.core.arm(world.inputs(), "jog").accepted
    assert world.core.arm(world.inputs(), "jog").code == "already"
    reply = world.core.arm(world.inputs(), "all")
    assert (reply.accepted, reply.code) == (False, "state")
    assert "hold" in reply.text
    world.core.hold("now force")
    assert world.core.arm(world.inputs(), "all").accepted
    assert world.core.arm(world.inputs(), "jog").code == "already"
    assert world.core.status().armed_for == "all"


def test_the_list_says_what_each_check_is_and_only_force_is_left_out() -> None:
    """One row per rule of the preflight, in words."""
    words = [check.what for check in CHECKS]
    assert len(set(words)) == len(words) == 11
    assert [check.purposes for check in CHECKS[-5:]] == [("all",)] * 5
    assert [check.what for check in CHECKS if check.purposes == ("all", "jog")] == [words[4]]


def test_an_input_that_is_lost_is_told_alone() -> None:
    """What the others say cannot be known then."""
    world = ready(force__approach_m_s=0.25)
    feel(world, 30.0)
    world.pass_s(1.0)
    assert len(world.core.status().not_ready) == 2
    world.messages["wrench"] = WrenchAtTcp(valid=False, reason="no cable")
    world.tick()
    assert world.core.status().not_ready == ("wrench invalid: no cable",)


# --- the last digit -------------------------------------------------------------------------------

TERMS = Terms.of(CELL)


def test_inputs_that_were_good_for_just_a_second_are_enough() -> None:
    """One nanosecond less is not, and says how long it was."""
    inputs = World().make_ready().inputs()
    assert failed_checks(inputs, TERMS, 1.0, "all") == []
    (trip,) = failed_checks(inputs, TERMS, 1.0 - 1e-9, "all")
    assert (trip.code, trip.limit) == ("not_ready", 1.0)


@pytest.mark.parametrize(("age_h", "told"), [(8.0, 0), (8.001, 1)])
def test_a_tare_may_be_as_old_as_the_cell_says(age_h: float, told: int) -> None:
    """Age and limit are told in seconds."""
    world = World(cell_with(force__tare_age_max_s=28800.0)).make_ready()
    world.change("wrench/health", numbers={"tare_age_h": age_h})
    found = failed_checks(world.inputs(), Terms.of(world.cell), 9.0, "all")
    assert [(trip.code, trip.limit) for trip in found] == [("tare", 28800.0)] * told
    assert [trip.value for trip in found] == [pytest.approx(3600.0 * age_h)] * told


@pytest.mark.parametrize("silent", [set(), {"wrench"}, {"wrench/health"}])
def test_the_age_of_a_tare_that_nobody_tells_is_no_complaint(silent: set[str]) -> None:
    """Who is not heard is told elsewhere; a wrench service without a number has just begun."""
    world = World(cell_with(force__tare_age_max_s=1800.0)).make_ready()
    if silent == {"wrench"}:
        world.change("wrench/health", numbers={"tare_age_h": 9.0})
    world.silent = silent
    look = PreflightContext(world.inputs(), Terms.of(world.cell), 9.0, blind=False)
    assert CHECKS[-1].complaints(look) == []


@pytest.mark.parametrize(("over_N", "told"), [(0.0, False), (0.1, True)])
def test_who_arms_is_told_of_a_load_beyond_a_touch(over_N: float, told: bool) -> None:
    """What the cell calls a touch is none yet; without a wrench nothing is known."""
    world = World().make_ready()
    feel(world, TERMS.touch_N + over_N)
    text = load_text(world.inputs(), TERMS)
    assert text.startswith(f"; the tool is loaded with {TERMS.touch_N + over_N:.1f} N") == told
    assert bool(text) == told
    world.silent = {"wrench"}
    assert load_text(world.inputs(), TERMS) == ""
