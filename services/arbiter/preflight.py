"""Preflight: list of the checks before `arm` is accepted. Pure.

Each check names its purposes. Checks of force control are skipped when the arm is armed for jog, so
that it can leave a contact without calibration. Backing off skips the checks of force and
workspace, because it serves to leave them.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from math import hypot
from typing import NamedTuple

import pinocchio as pin

from common.config.cell import CellConfig
from common.config.load import cell_hash
from common.motion.convert import pose_of
from common.motion.limits import Limits, check_workspace, check_wrench
from control.measured_range import ROUNDING_MOST_N, SEGMENTS, segment_range
from control.monitors import unchecked_axes
from forcemesh import topics
from forcemesh.clock import NS_PER_S
from forcemesh.faults import tripped
from forcemesh.messages import Purpose, Trip
from forcemesh.version import __version__
from services.arbiter.inputs import Inputs, missing, robot_faults
from services.arbiter.monitors import slow_start_trip
from tuning.forecast_text import arming_text

PREFLIGHT_S = 1.0  # time for which the inputs must have been good
REST_POSE_S = 0.2  # least time of the flange at one pose
LEAST_REPORTS = 3.0  # robot reports over which the arm must be at rest


@dataclass(frozen=True, slots=True)
class PreflightSettings:
    """Reference values of the preflight, from this process and its cell file."""

    cell: CellConfig
    config_hash: str
    limits: Limits
    T_flange_tcp: pin.SE3
    rest_s: float  # least time at rest
    contact: tuple[Trip, ...]  # why the contact of this cell is too stiff, or its approach too fast
    forecast: str  # note for the reply to `arm`: the limit that the cell's own press would break

    @classmethod
    def of(cls, cell: CellConfig) -> "PreflightSettings":
        """Return the reference values of a cell."""
        return cls(
            cell,
            cell_hash(cell),
            Limits.of(cell),
            cell.tool.T_flange_tcp.pose,
            max(REST_POSE_S, LEAST_REPORTS / cell.rates.robot_hz),
            tuple(contact_trips(cell)),
            arming_text(cell),
        )


EVERY: tuple[Purpose, ...] = ("all", "jog", "back_off")
MOVES: tuple[Purpose, ...] = ("all", "jog")
FORCE: tuple[Purpose, ...] = ("all",)


class LastLease(NamedTuple):
    """The last lease of this arbiter, which may live on in the robot for a moment."""

    challenge: int = 0  # of the robot, repeated in its permissions; 0: no lease yet
    expires_ns: int = 0  # deadline of its last permission


NO_LEASE = LastLease()


class PreflightContext(NamedTuple):
    """Arguments of a check."""

    inputs: Inputs
    settings: PreflightSettings
    good_s: float  # time since all inputs are received and valid
    blind: bool  # to back off without a measured force
    last: LastLease = NO_LEASE


class Check(NamedTuple):
    """One row of the preflight."""

    what: str
    failures: Callable[[PreflightContext], Iterable[Trip | None]]
    purposes: tuple[Purpose, ...]


def _steady(context: PreflightContext) -> list[Trip]:
    if context.good_s >= PREFLIGHT_S:
        return []
    text = f"inputs have been good for {context.good_s:.1f} s, {PREFLIGHT_S:g} s are required"
    return [tripped("not_ready", text, value=context.good_s, limit=PREFLIGHT_S)]


def _at_rest(context: PreflightContext) -> list[Trip]:
    """Check the time at one pose, which while holding is the commanded one."""
    rest_s, needed_s = context.inputs.monitored.rest_s, context.settings.rest_s
    if rest_s >= needed_s:
        return []
    text = f"the arm has been at rest for {rest_s:.2f} s, {needed_s:.2f} s are required"
    return [tripped("moving", text, value=rest_s, limit=needed_s, unit="s")]


def _challenge(context: PreflightContext) -> list[Trip]:
    """Check that the robot has a challenge, and that no lease of this arbiter has used it up.

    Another one than of the last lease was drawn after the end of that lease. The same one counts
    once the robot has published it after the last permission has expired: it was never accepted.
    """
    inputs, last = context.inputs, context.last
    robot = inputs.robot.fresh
    if robot is None:
        return []
    if not robot.challenge:
        return [tripped("no_challenge", "robot/state has no challenge, so no lease can begin")]
    published_ns = inputs.now_ns - inputs.robot.age_s * NS_PER_S
    if robot.challenge == last.challenge and published_ns <= last.expires_ns:
        return [tripped("wait", "the robot has not yet reported the end of the last lease")]
    return []


def _mismatched_roles(context: PreflightContext) -> list[Trip]:
    """Return the roles with another cell file or version than the arbiter's."""
    trips, own_hash = [], context.settings.config_hash
    for role, reading in context.inputs.health.items():
        health = reading.fresh
        if health is not None and health.config_hash != own_hash:
            text = f"{role} runs with another cell file ({health.config_hash}, here {own_hash})"
            trips.append(tripped("config", text))
        if health is not None and health.version != __version__:
            text = f"{role} runs version {health.version}, here {__version__}"
            trips.append(tripped("version", text))
    return trips


def _limits(context: PreflightContext) -> list[Trip | None]:
    """Check the force against its ceiling, and the tool against the workspace."""
    wrench, robot = context.inputs.wrench.fresh, context.inputs.robot.fresh
    if wrench is None or robot is None:
        return []
    limits, T_flange_tcp = context.settings.limits, context.settings.T_flange_tcp
    trip = check_wrench(limits, wrench.force_N, wrench.torque_Nm)
    return [trip or check_workspace(limits, pose_of(robot) * T_flange_tcp)]


def _calibration(context: PreflightContext) -> list[Trip]:
    wrench = context.inputs.wrench.fresh
    if wrench is None or wrench.calibrated:
        return []
    return [tripped("payload", wrench.calibration_fault or "the wrench is not calibrated")]


def _axes(context: PreflightContext) -> list[Trip | None]:
    wrench = context.inputs.wrench.fresh
    return [] if wrench is None else [unchecked_axes(wrench)]


def contact_trips(cell: CellConfig) -> Iterator[Trip]:
    """Yield why force control of the cell's stiffest contact would not settle."""
    plant, value = cell.plant, cell.force.approach_m_s
    k, limit = plant.stiffness_N_m, plant.approach_limit_m_s
    if value > limit:
        text = (
            f"force.approach_m_s is {value * 1e3:.2f} mm/s: force.approach_budget_N / (stiffness x "
            f"loop delay) allows {limit * 1e3:.2f} mm/s"
        )
        yield tripped("approach_speed", text, value=value, limit=limit)
    # Whatever a regulator does, the arbiter stops it when readings are late.
    deadline_s = max(cell.stale_after_s(each) for each in (topics.SENSOR_WRENCH, topics.WRENCH))
    most_m_s = cell.limits.force_N / (k * (deadline_s + plant.tau_s))
    if plant.approach_m_s > most_m_s:
        unseen_N = cell.limits.force_N * plant.approach_m_s / most_m_s
        text = (
            f"readings are stale after {deadline_s:g} s (deadlines.sensor_s, or three periods): a "
            f"contact at force.approach_m_s reaches {unseen_N:.0f} N until they stop the arm; "
            f"limits.force_N allows {cell.limits.force_N:g} N: shorten that, or approach at "
            f"{most_m_s * 1e3:.2f} mm/s"
        )
        yield tripped("approach_speed", text, value=plant.approach_m_s, limit=most_m_s)
    if cell.gateway is None or cell.gateway.protocol == "plain":
        return
    rounding_N = k * plant.rounding_m
    if "pc" in cell.robot.hosts and rounding_N > ROUNDING_MOST_N:
        text = (
            f"contact.stiffness_N_m is {k:.3g}: the packet rounds a set point by up to "
            f"{1e3 * plant.rounding_m:.3f} mm, {rounding_N:.1f} N there; "
            f"{ROUNDING_MOST_N:g} N is allowed: raise gateway.position_per_mm, or choose "
            "robot.hosts [controller]"
        )
        yield tripped("stiffness", text, value=rounding_N, limit=ROUNDING_MOST_N, unit="N")
    yield from _segment_trips(cell, cell.gateway.least_segment_s)


def _segment_trips(cell: CellConfig, segment_s: float) -> Iterator[Trip]:
    """Yield what is beyond the measured range of segments as long as the cell's."""
    k, row = cell.contact.stiffness_N_m, segment_range(segment_s)
    segments = f"with segments of {segment_s * 1e3:g} ms (gateway.least_segment_s)"
    if row is None:
        longest_s = max(SEGMENTS).longest_s
        text = f"no contact was measured {segments}: at most {longest_s * 1e3:g} ms"
        yield tripped("stiffness", text, value=segment_s, limit=longest_s, unit="s")
    elif k > row.stiffest_N_m:
        text = f"contact.stiffness_N_m is {k:.3g}: {segments} {row.stiffest_N_m:g} N/m settle"
        yield tripped("stiffness", text, value=k, limit=row.stiffest_N_m, unit="N/m")
    elif (rate := k * cell.force.approach_m_s) > row.force_rate_N_s:
        text = (
            f"force.approach_m_s is {cell.force.approach_m_s * 1e3:.2f} mm/s, at which the force "
            f"rises by {rate:.0f} N/s: {segments} {row.force_rate_N_s:.0f} N/s were measured"
        )
        limit_m_s = row.force_rate_N_s / k
        yield tripped("approach_speed", text, value=cell.force.approach_m_s, limit=limit_m_s)


def _tare(context: PreflightContext) -> list[Trip]:
    """Check the age of the tare; the text contains the present reading."""
    wrench = context.inputs.wrench.fresh
    age_h = context.inputs.numbers("wrench").get("tare_age_h", 0.0)
    limit_h = context.settings.cell.force.tare_age_max_s / 3600.0
    if age_h <= limit_h or wrench is None:
        return []
    text = (
        f"the last tare is {age_h:.1f} h old, force.tare_age_max_s allows {limit_h:.1f} h; "
        f"the reading is {hypot(*wrench.force_N):.2f} N now"
    )
    return [tripped("tare", text, value=3600.0 * age_h, limit=3600.0 * limit_h)]


# fmt: off
CHECKS: tuple[Check, ...] = (
    Check("every input is received, valid and in time",
          lambda context: missing(context.inputs, blind=context.blind), EVERY),
    Check("all inputs have been valid for a second", _steady, EVERY),
    Check("the controller is ready to move",
          lambda context: robot_faults(context.inputs), EVERY),
    Check("the robot has a challenge that no lease has used", _challenge, EVERY),
    Check("every process has this cell file and version", _mismatched_roles, EVERY),
    Check("force below its ceiling, tool in the workspace", _limits, MOVES),
    Check("the arm is at rest where it was commanded", _at_rest, EVERY),
    Check("the calibration is valid for tool and sensor", _calibration, FORCE),
    Check("axes and signs of the sensor were checked with it", _axes, FORCE),
    Check("the residual force in free space is small",
          lambda context: [context.inputs.monitored.residual], FORCE),
    Check("the stiffness suits the controller, the approach is slow enough for it",
          lambda context: context.settings.contact, FORCE),
    Check("the controller is as fast as in the cell file",
          lambda context: [slow_start_trip(context.inputs, context.settings.cell)], FORCE),
    Check("the last tare is not too old", _tare, FORCE),
)
# fmt: on


def failed_checks(
    inputs: Inputs,
    settings: PreflightSettings,
    good_since_ns: int | None,
    purpose: Purpose,
    *,
    last: LastLease = NO_LEASE,
    blind: bool = False,
) -> list[Trip]:
    """Return why the arm must not be armed; faults of the inputs exclude all other checks.

    Args:
        inputs: Present snapshot.
        settings: Reference values.
        good_since_ns: Time since which the inputs are good [ns]; None: they are not.
        purpose: Purpose of arming.
        last: The last lease of this arbiter.
        blind: To back off without a measured force.
    """
    good_s = 0.0 if good_since_ns is None else (inputs.now_ns - good_since_ns) / NS_PER_S
    context, found = PreflightContext(inputs, settings, good_s, blind, last), list[Trip]()
    for row in CHECKS:
        if purpose in row.purposes:
            found.extend(filter(None, row.failures(context)))
        if found and row is CHECKS[0]:
            break
    return found


def load_text(inputs: Inputs, settings: PreflightSettings) -> str:
    """Return a note for the reply to `arm` that the tool is loaded, empty when it is free."""
    wrench = inputs.wrench.fresh
    if wrench is None or (force_N := hypot(*wrench.force_N)) <= settings.cell.force.touch_N:
        return ""
    return f"; the tool is loaded with {force_N:.1f} N: `forcemesh retract` leaves a contact"
