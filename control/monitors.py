"""Run-time monitors of force feedback, each of which ends it with a fault code. Pure.

A wrong sign, axis or unit of the sensor turns the loop into positive feedback. The monitors check
- the first touch: the force must push back along the tool axis;
- passivity (as a passivity observer does): the environment cannot do more work on the tool than
  the tool did on it; with a wrong sensor the tool seems to be driven by its contact;
- travel without contact, and oscillation.

Axes and signs of the sensor were checked before force control was armed (`forcemesh check axes`).

Oscillation: consecutive half waves of the control error that do not decay. Half waves are separated
by zero crossings. A loop whose gain is too high for its contact oscillates with a period of about
four loop delays. Half waves that are much shorter or longer are not caused by the loop and are not
counted.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import copysign, hypot
from typing import NamedTuple

import pinocchio as pin

from common.config.cell import CellConfig
from common.motion.frames import Vector, dot, plus, rotated, rotated_back
from control.axis_task import masked
from control.law import Contact, LawInput, LawMotion, motion_between
from forcemesh.faults import tripped
from forcemesh.messages import ZERO3, Trip, Vec3, WrenchAtTcp

WORK_STEP_M, WORK_STEP_RAD = 2e-5, 2e-4  # smaller steps are pose noise
RETURNED_PART = 0.5  # of the work done by the tool: a delayed force seems to return that much
ALONG_TOOL = 0.99  # cosine of the angle up to which a press is along the tool
MAIN_PART = 0.7  # share of the first force along the tool axis: within 45 degrees of it
HALF_WAVES = 10  # five periods
HALF_WAVE_KEPT = 0.9  # a half wave smaller than this share of the last one of its sign decays
DEADBANDS = 10.0  # smaller half waves, in deadbands, are noise or harmless
SHORTEST_HALF_TAU, LONGEST_HALF_TAU = 0.5, 8.0


@dataclass(frozen=True, slots=True)
class MonitorSettings:
    """Limits of the monitors."""

    touch_N: float
    search_m: float
    lost_m: float
    environment_work_J: float
    half_wave: Vector  # least height in N, N, N, N m, N m, N m. Shape (6,)
    half_wave_shortest_s: float
    half_wave_longest_s: float

    @classmethod
    def of(cls, cell: CellConfig) -> "MonitorSettings":
        """Return the limits of a cell."""
        force, tau_s = cell.force, cell.plant.tau_s
        deadbands = [force.deadband_N] * 3 + [force.deadband_Nm] * 3
        return cls(
            force.touch_N,
            force.search_m,
            force.lost_m,
            force.environment_work_J,
            half_wave=[DEADBANDS * band for band in deadbands],
            half_wave_shortest_s=SHORTEST_HALF_TAU * tau_s,
            half_wave_longest_s=LONGEST_HALF_TAU * tau_s,
        )


@dataclass(slots=True)
class HalfWaves:
    """Half waves of one error; advanced in place."""

    side: float = 0.0  # sign of the error, 0 before the first half wave
    height: float = 0.0  # of the present half wave so far
    age_s: float = 0.0
    last: float = 0.0  # height of the previous half wave
    before_last: float = 0.0  # of the one before it, with this sign
    count: int = 0  # consecutive half waves that did not decay

    def update(self, error: float, dt_s: float, least: float, settings: MonitorSettings) -> int:
        """Add one more sample; return the number of half waves that did not decay.

        Args:
            error: Error of force [N] or torque [N m] beyond its deadband.
            dt_s: Time since the last sample.
            least: Least height of a half wave.
            settings: Limits of its duration.
        """
        if error == 0.0 or error * self.side > 0.0:
            self.height, self.age_s = max(self.height, abs(error)), self.age_s + dt_s
            return self.count
        if self.side != 0.0:
            in_time = settings.half_wave_shortest_s <= self.age_s <= settings.half_wave_longest_s
            persists = self.height >= max(least, HALF_WAVE_KEPT * self.before_last)
            self.count = self.count + 1 if in_time and persists else 0
            self.before_last, self.last = self.last, self.height
        self.side, self.height, self.age_s = copysign(1.0, error), abs(error), 0.0
        return self.count


def no_waves() -> list[HalfWaves]:
    """Return the initial state of the six errors."""
    return [HalfWaves() for _ in range(6)]


@dataclass(slots=True)
class MonitorSample:
    """One sample for the monitors: wrench in base axes about the TCP, pose and task."""

    force_N: Vec3
    torque_Nm: Vec3
    T_base_tcp: pin.SE3  # measured
    contact: Contact  # contact state of the law
    error: Vector  # of force and torque beyond their deadbands. Shape (6,)
    press_axis: Vec3  # direction of the set point, base axes
    along_tool: bool  # it is the tool's z axis
    side_trips: bool  # a first touch across the press axis is a fault
    presses: bool  # the set point is not zero: the environment must not move the tool
    rotates: bool  # torques are controlled
    follows: bool  # tracks a moving surface, whose work along the tool axis is its own
    dt_s: float

    @classmethod
    def of(cls, sample: LawInput, law: LawMotion) -> "MonitorSample":
        """Return the monitors' view of one sample; only a press has an approach.

        The errors are those of axes that are not held, the only ones that the loop moves. The pose
        is the measured one: a command in flight has changed no force yet.

        Args:
            sample: Input of the law.
            law: Motion that the law has returned.
        """
        task = sample.task
        along, about = task.moving
        error_N = masked(law.error_force_N or ZERO3, along, sample.R_base_task)
        error_Nm = masked(law.error_torque_Nm or ZERO3, about, sample.R_base_task)
        contact, presses = law.contact if sample.moves else "free", task.press_N > 0.0
        R_base_tcp = sample.T_measured.rotation.tolist()
        press_axis = rotated(task.R_base_task(R_base_tcp), task.press_axis)
        along_tool = rotated_back(R_base_tcp, press_axis)[2] > ALONG_TOOL
        # A tool that only presses must not meet its contact sideways.
        side_trips = along_tool and not (task.complies or task.turns_freely)
        return cls(
            sample.force_N, sample.torque_Nm, sample.T_measured, contact,
            (*error_N, *error_Nm), press_axis, along_tool, side_trips,
            presses, sample.rotates, law.follows, sample.dt_s,
        )  # fmt: skip


@dataclass(slots=True)
class MonitorState:
    """State of the monitors from the start of force feedback on; advanced in place."""

    first: MonitorSample | None = None
    began_free: bool = False  # with an approach
    worked: MonitorSample | None = None  # last sample whose work is counted
    touched: bool = False
    environment_work_J: float = 0.0  # work done on the tool by the environment
    tool_work_J: float = 0.0  # work done by the tool
    p_search_m: Vec3 | None = None  # where the present search for contact began
    # Of the force and of the torque along each axis.
    waves: list[HalfWaves] = field(default_factory=no_waves)
    half_waves: int = 0  # that did not decay, of the worst axis


def kept_over_restart(before: MonitorState) -> MonitorState:
    """Return the state kept over a change of set point or mode: the work budgets continue.

    A tool without contact may begin its approach now, with the present readings as reference.
    """
    is_free = before.worked is not None and before.worked.contact != "contact"
    if not before.touched or (is_free and not before.began_free):
        return MonitorState()
    return replace(before, p_search_m=None, waves=no_waves())


def unchecked_axes(wrench: WrenchAtTcp, *, torques: bool = False) -> Trip | None:
    """Return why force control may not use a sensor whose axes and signs are not checked."""
    if wrench.axes_checked and (wrench.torques_checked or not torques):
        return None
    what, name = "torques" if wrench.axes_checked else "sensor", wrench.calibration or "none"
    text = f"axes and signs of the {what} are not checked with calibration {name} and this arm"
    return tripped("axes_unproved", text)


def monitor(now: MonitorState, sample: MonitorSample, settings: MonitorSettings) -> Trip | None:
    """Advance the state by one sample; return the trip of the first monitor that fired."""
    _count_work(now, sample)
    now.first = first = now.first or sample
    now.began_free = first.contact == "approach"
    now.touched = now.touched or sample.contact == "contact"
    if sample.contact != "approach":
        now.p_search_m = None
    elif now.p_search_m is None:
        now.p_search_m = sample.T_base_tcp.translation.tolist()
    now.half_waves = max(
        wave.update(error, sample.dt_s, least, settings)
        for wave, error, least in zip(now.waves, sample.error, settings.half_wave, strict=True)
    )
    for code, unit, judge in MONITORS:
        if (found := judge(now, sample, settings)) is not None:
            return tripped(code, found.text, value=found.value, limit=found.limit, unit=unit)
    return None


def _count_work(now: MonitorState, sample: MonitorSample) -> None:
    """Add the work between tool and environment since the last counted sample."""
    last = now.worked
    if last is None or not now.touched:
        now.worked = sample
        return
    travel_m, turn_rad = motion_between(last.T_base_tcp, sample.T_base_tcp)
    if sample.follows:  # what the surface does along the press is no fault
        travel_m = plus(travel_m, sample.press_axis, -dot(travel_m, sample.press_axis))
    if hypot(*travel_m) < WORK_STEP_M and hypot(*turn_rad) < WORK_STEP_RAD:
        return
    work_J = 0.5 * dot(plus(sample.force_N, last.force_N), travel_m)
    if sample.rotates:
        work_J += 0.5 * dot(plus(sample.torque_Nm, last.torque_Nm), turn_rad)
    now.worked = sample
    now.tool_work_J += max(-work_J, 0.0)
    if sample.presses:
        now.environment_work_J += max(work_J, 0.0)
    else:  # at set point 0 anything may move the tool; stored work is returned
        now.tool_work_J = max(now.tool_work_J - max(work_J, 0.0), 0.0)


# --- monitors -------------------------------------------------------------------------------------


class Exceeded(NamedTuple):
    """Value beyond its limit, in words."""

    value: float
    limit: float | None
    text: str


def first_touch(
    now: MonitorState, sample: MonitorSample, settings: MonitorSettings
) -> Exceeded | None:
    """Judge the increase of the force at a touch from free space: back along the press axis."""
    first = now.first or sample
    if now.touched or first.contact != "approach":
        return None
    grown_N = plus(sample.force_N, first.force_N, -1.0)
    length_N = hypot(*grown_N)
    back_N, least_N = -dot(grown_N, sample.press_axis), MAIN_PART * length_N
    if length_N <= settings.touch_N or back_N >= least_N or not sample.side_trips:
        return None
    axis = "tool axis" if sample.along_tool else "axis of the set point"
    text = (
        f"the first touch reads {back_N:.1f} N back along the {axis}, of {length_N:.1f} N: "
        "a sign, an axis or a frame of the sensor is wrong, or the tool touches with its side"
    )
    return Exceeded(back_N, least_N, text)


def passivity(
    now: MonitorState, sample: MonitorSample, settings: MonitorSettings
) -> Exceeded | None:
    """Judge the work of the environment: a press cannot return more than it received.

    Along compliant axes anything may push the tool.
    """
    more_J = now.environment_work_J - (1.0 + RETURNED_PART) * now.tool_work_J
    is_passive = sample.presses and now.began_free and sample.side_trips
    if not is_passive or more_J <= settings.environment_work_J:
        return None
    text = (
        f"the contact did {now.environment_work_J * 1e3:.0f} mJ of work on the tool and "
        f"received {now.tool_work_J * 1e3:.0f} mJ: a sign or an axis of the sensor is wrong, "
        "or a person pushes"
    )
    return Exceeded(more_J, settings.environment_work_J, text)


def search(now: MonitorState, sample: MonitorSample, settings: MonitorSettings) -> Exceeded | None:
    """Judge the travel in a search for contact."""
    if now.p_search_m is None:
        return None
    searched_m = plus(sample.T_base_tcp.translation.tolist(), now.p_search_m, -1.0)
    travel_m = dot(searched_m, sample.press_axis)
    limit_m = settings.lost_m if now.touched else settings.search_m
    if travel_m <= limit_m:
        return None
    cause = "contact was lost and not found again" if now.touched else "no contact"
    return Exceeded(travel_m, limit_m, f"{cause} within {limit_m * 1e3:g} mm")


def oscillation(now: MonitorState, sample: MonitorSample, _: MonitorSettings) -> Exceeded | None:
    """Judge the half waves of the error that did not decay."""
    if now.half_waves < HALF_WAVES:
        return None
    height_N = hypot(*sample.error[:3])
    text = f"the force oscillates and does not settle, the force error is {height_N:.1f} N now"
    return Exceeded(height_N, None, text)


class Monitor(NamedTuple):
    """Row of the table of monitors."""

    code: str
    unit: str
    judge: Callable[[MonitorState, MonitorSample, MonitorSettings], Exceeded | None]


MONITORS = (
    Monitor("sensor_sign", "N", first_touch),
    Monitor("sensor_sign", "J", passivity),
    Monitor("travel", "m", search),
    Monitor("oscillation", "N", oscillation),
)
