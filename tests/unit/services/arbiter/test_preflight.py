"""Conditions for arming, for all purposes or for jog only."""

from math import nextafter
from typing import Any

import pytest

from forcemesh.clock import NS_PER_S
from forcemesh.messages import WrenchAtTcp
from forcemesh.version import __version__
from services.arbiter.preflight import (
    CHECKS,
    LastLease,
    PreflightContext,
    PreflightSettings,
    failed_checks,
    load_text,
)
from tests.fakes.arbiter_world import (
    CELL,
    DEADLINE_S,
    FIT,
    PERIOD_NS,
    World,
    shifted,
)
from tests.fakes.bench import cell_with

IDLE_MAX_N = CELL.force.idle_max_N
# The value of the documentation, not that of the code.
RESIDUAL_S = 0.5


def set_force(world: World, force_N: float) -> None:
    """Let the wrench report a force."""
    world.change("wrench", force_N=(0.0, 0.0, force_N))


def refused_with(world: World) -> tuple[str, bool]:
    """Return the code of the refusal for all, and whether jog is possible."""
    everything = world.core.arm(world.inputs())
    assert not everything.accepted
    return everything.code, world.core.arm(world.inputs(), "jog").accepted


# --- conditions of every motion ------------------------------------------------------------------


def test_a_process_of_another_version_prevents_arming() -> None:
    """For every purpose; the refusal names the role and both versions."""
    world = World().make_ready()
    world.change("wrench/health", version="0.0.1")
    world.tick()
    assert refused_with(world) == ("version", False)
    text = world.core.arm(world.inputs()).text
    assert f"wrench runs version 0.0.1, here {__version__}" in text


def test_commanded_motion_is_no_fault() -> None:
    """The status of an arm that moves under a goal does not require rest."""
    world = World().make_active("operator")
    world.change("robot", status=FIT.replaced(moving=True))
    world.tick()
    assert world.core.status().not_ready == ()


def test_a_robot_without_a_challenge_is_not_armed() -> None:
    """One of another author, or an older one: the remedy says what it must publish."""
    world = World().make_ready()
    world.change("robot", challenge=0)
    assert refused_with(world) == ("no_challenge", False)
    (check,) = (check for check in CHECKS if "challenge" in check.what)
    assert [trip and trip.code for trip in check.failures(context_of(world))] == ["no_challenge"]
    world.silent = {"robot"}  # a fault of its own
    assert check.failures(context_of(world)) == []


def context_of(world: World) -> PreflightContext:
    """Return the arguments of a check."""
    return PreflightContext(world.inputs(), PreflightSettings.of(world.cell), 9.0, blind=False)


def test_a_lease_never_begins_with_the_challenge_of_the_one_before() -> None:
    """The robot reports another one, or the same one after the last permission has expired."""
    world = World().make_ready()
    world.change("robot", challenge=7)
    assert world.core.arm(world.inputs()).accepted
    assert permitted_challenge(world) == 7
    assert world.core.status().not_ready == ()
    world.core.hold("enough")
    world.tick()
    assert refused_with(world) == ("wait", False)
    world.change("robot", challenge=8)
    assert world.core.arm(world.inputs()).accepted
    assert permitted_challenge(world) == 8
    world.core.hold("enough")
    for _ in range(round(DEADLINE_S * NS_PER_S / PERIOD_NS)):
        world.tick()
        assert refused_with(world) == ("wait", False)
    world.tick()
    assert world.core.arm(world.inputs()).accepted


@pytest.mark.parametrize(("age_s", "codes"), [(0.009, []), (0.011, ["wait"])])
def test_a_report_from_before_the_end_of_a_lease_does_not_confirm_it(
    age_s: float, codes: list[str]
) -> None:
    """Its age counts: the last permission expired 10 ms ago."""
    context = context_of(World().make_ready())
    inputs, robot = context.inputs, context.inputs.robot
    assert robot.fresh is not None
    inputs.robot = robot._replace(age_s=age_s)
    last = LastLease(robot.fresh.challenge, inputs.now_ns - 10_000_000)
    (check,) = (check for check in CHECKS if "challenge" in check.what)
    assert [trip and trip.code for trip in check.failures(context._replace(last=last))] == codes


def permitted_challenge(world: World) -> int:
    """Return the challenge of the next command's permission."""
    permission = world.tick().permission
    assert permission is not None
    return permission.challenge


# --- free space, calibration, approach ------------------------------------------------------------


def test_force_feedback_needs_a_check_of_the_axes_but_jog_does_not() -> None:
    """A wrong sign or axis would push where it must give way; the refusal names the calibration."""
    world = World().make_ready()
    world.change("wrench", calibration="5eed", axes_checked=False)
    world.tick()
    assert "5eed" in world.core.arm(world.inputs()).text
    assert refused_with(world) == ("axes_unproved", True)


def test_a_residual_force_prevents_force_feedback_but_not_jog() -> None:
    """Half a second of it is reported with both numbers, also in the status before arming (H28)."""
    world = World().make_ready()
    set_force(world, IDLE_MAX_N + 0.5)
    world.pass_s(RESIDUAL_S - 0.02)
    assert world.core.status().not_ready == ()
    world.pass_s(0.06)
    (line,) = world.core.status().not_ready
    assert "2.5 N are left" in line
    reply = world.core.arm(world.inputs())
    assert (reply.code, reply.value, reply.limit) == ("payload", IDLE_MAX_N + 0.5, IDLE_MAX_N)
    residual = world.inputs().monitored.residual
    assert residual is not None
    assert residual.unit == "N"
    assert world.core.arm(world.inputs(), "jog").accepted


def test_a_drift_of_a_tenth_of_a_newton_per_second_is_detected() -> None:
    """It is reported within half a second beyond the limit, also while the arm is armed."""
    world = World().make_armed()
    for tenths in range(40):
        set_force(world, 0.1 * tenths)
        world.pass_s(1.0)
        reported = [line for line in world.core.status().not_ready if "left" in line]
        assert bool(reported) == (0.1 * tenths > IDLE_MAX_N)
    assert world.core.state == "ARMED"


def test_an_invalid_calibration_is_reported_and_jog_is_possible() -> None:
    """The wrench itself reports it with the reason (H45)."""
    world = World().make_ready()
    world.change("wrench", calibrated=False, calibration_fault="another sensor")
    assert refused_with(world) == ("payload", True)
    world.tick()
    assert "another sensor" in " ".join(world.core.status().not_ready)


@pytest.mark.parametrize(
    "changes",
    [{"calibration": "another"}, {"calibrated": False, "calibration_fault": "another sensor"}],
)
def test_force_feedback_ends_with_its_calibration(changes: dict[str, Any]) -> None:
    """The regulator would respond to the step of the force with motion."""
    world = World().make_active("regulator")
    world.propose(shifted())
    world.tick(3)
    world.change("wrench", **changes)
    assert world.tick().kind == "hold"
    assert [trip.code for trip in world.core.status().trips] == ["calibration"]


# --- jog ------------------------------------------------------------------------------------------


def test_a_change_from_jog_to_all_requires_a_hold() -> None:
    """Arming for less changes nothing; arming for more is refused with the remedy."""
    world = World().make_ready()
    assert world.core.arm(world.inputs(), "jog").accepted
    again = world.core.arm(world.inputs(), "jog")
    assert (again.accepted, again.code) == (True, "already")
    reply = world.core.arm(world.inputs(), "all")
    assert (reply.accepted, reply.code) == (False, "state")
    assert "armed for jog alone: hold" in reply.text
    world.core.hold("now force")
    assert world.core.arm(world.inputs(), "all").accepted
    assert world.core.arm(world.inputs(), "jog").code == "already"
    assert world.core.status().armed_for == "all"


def test_a_lost_input_is_reported_alone() -> None:
    """The other checks have no result without it."""
    world = World(cell_with(force__approach_m_s=0.25)).make_ready()
    set_force(world, 30.0)
    world.pass_s(1.0)
    assert len(world.core.status().not_ready) == 2
    world.messages["wrench"] = WrenchAtTcp(valid=False, reason="no cable")
    world.tick()
    assert world.core.status().not_ready == ("wrench invalid: no cable",)


# --- exact limits ---------------------------------------------------------------------------------

SETTINGS = PreflightSettings.of(CELL)


def test_one_second_of_good_inputs_is_sufficient() -> None:
    """One nanosecond less is refused, with the duration."""
    inputs = World().make_ready().inputs()
    assert failed_checks(inputs, SETTINGS, inputs.now_ns - NS_PER_S, "all") == []
    (trip,) = failed_checks(inputs, SETTINGS, inputs.now_ns - NS_PER_S + 1, "all")
    assert (trip.code, trip.limit) == ("not_ready", 1.0)
    (trip,) = failed_checks(inputs, SETTINGS, None, "all")
    assert (trip.code, trip.value) == ("not_ready", 0.0)


@pytest.mark.parametrize(("robot_hz", "needed_s"), [(250.0, 0.2), (10.0, 0.3)])
def test_an_arm_rests_after_a_fifth_of_a_second_or_three_reports(
    robot_hz: float, needed_s: float
) -> None:
    """Exactly this time is sufficient; a robot on a slow link is checked for longer."""
    world = World(cell_with(rates__robot_hz=robot_hz)).make_ready()
    settings = PreflightSettings.of(world.cell)
    for rest_s in (needed_s, nextafter(needed_s, 0.0)):
        inputs = world.inputs()
        inputs.monitored = inputs.monitored._replace(rest_s=rest_s)
        found = failed_checks(inputs, settings, inputs.now_ns - NS_PER_S, "back_off")
        values = [(trip.code, trip.value, trip.limit, trip.unit) for trip in found]
        assert values == ([] if rest_s == needed_s else [("moving", rest_s, needed_s, "s")])


@pytest.mark.parametrize(("age_h", "reports"), [(8.0, 0), (8.001, 1)])
def test_a_tare_may_have_the_age_of_the_cell_file(age_h: float, reports: int) -> None:
    """Age and limit are in seconds."""
    world = World(cell_with(force__tare_age_max_s=28800.0)).make_ready()
    world.change("wrench/health", numbers={"tare_age_h": age_h})
    inputs = world.inputs()
    since_ns = inputs.now_ns - 9 * NS_PER_S
    found = failed_checks(inputs, PreflightSettings.of(world.cell), since_ns, "all")
    assert [(trip.code, trip.limit) for trip in found] == [("tare", 28800.0)] * reports
    assert [trip.value for trip in found] == [pytest.approx(3600.0 * age_h)] * reports


@pytest.mark.parametrize("silent", [set(), {"wrench"}, {"wrench/health"}])
def test_an_unknown_age_of_the_tare_is_no_fault(silent: set[str]) -> None:
    """A silent process has its own fault; a wrench service without a number has just started."""
    world = World(cell_with(force__tare_age_max_s=1800.0)).make_ready()
    if silent == {"wrench"}:
        world.change("wrench/health", numbers={"tare_age_h": 9.0})
    world.silent = silent
    context = context_of(world)
    assert list(CHECKS[-1].failures(context)) == []


@pytest.mark.parametrize(("over_N", "reports"), [(0.0, False), (0.1, True)])
def test_the_reply_to_arm_reports_a_load_beyond_a_touch(over_N: float, reports: bool) -> None:
    """The cell's touch force itself is not reported; without a wrench no load is known."""
    world = World().make_ready()
    load_N = SETTINGS.cell.force.touch_N + over_N
    set_force(world, load_N)
    text = load_text(world.inputs(), SETTINGS)
    assert text.startswith(f"; the tool is loaded with {load_N:.1f} N") == reports
    assert bool(text) == reports
    world.silent = {"wrench"}
    assert load_text(world.inputs(), SETTINGS) == ""


@pytest.mark.parametrize("name", ["robot", "wrench"])
def test_force_and_workspace_are_not_checked_by_an_old_message(name: str) -> None:
    """Its age is reported by another check."""
    world = World().make_ready()
    (check,) = (check for check in CHECKS if check.what.startswith("force below its ceiling"))
    set_force(world, 2.0 * CELL.limits.force_N)
    for purpose in ("all", "jog"):
        assert world.core.arm(world.inputs(), purpose).code == "force"
    world.silent.add(name)
    assert list(check.failures(context_of(world))) == []
