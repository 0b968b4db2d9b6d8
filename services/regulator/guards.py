"""Run-time monitors of force feedback, each of which ends it with a fault code. Pure.

A wrong sign, axis or unit of the sensor turns the loop into positive feedback. The monitors check
- the first touch: the force must push back along the tool axis;
- passivity (as a passivity observer does): the environment cannot do more work on the tool than
  the tool did on it; with a wrong sensor the tool seems to be driven by its contact;
- the force while the tool turns: it must stay near its set point, because a wrong torque turns the
  tool's edge into the contact and the force then grows by itself;
- travel without contact, travel along unverified axes, and oscillation.

Oscillation: consecutive half waves of the control error that do not decay. Half waves are separated
by zero crossings. A loop whose gain is too high for its contact oscillates with a period of about
four loop delays. Half waves that are much shorter or longer are not caused by the loop and are not
counted.
"""

from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin

from common.config.cell import CellConfig
from common.motion.frames import Array, length
from forcemesh.faults import tripped
from forcemesh.messages import Trip, WrenchAtTcp
from services.regulator import unverified_axes
from services.regulator.law import Contact, LawInput, LawMotion, masked, motion_between
from services.regulator.unverified_axes import Flags, YieldTravel

WORK_STEP_M, WORK_STEP_RAD = 2e-5, 2e-4  # smaller steps are pose noise
SWUNG_PART = 0.5  # of the work done by the tool: a delayed force seems to return that much
MAIN_PART = 0.7  # share of the first force along the tool axis: within 45 degrees of it
RISE_PART = 0.5  # of the set point, plus touch_N: no correct rotation raises the force as much
HALF_WAVES = 10  # five periods
HALF_WAVE_KEPT = 0.9  # a half wave smaller than this share of the last one of its sign decays
DEADBANDS = 10.0  # smaller half waves, in deadbands, are noise or harmless
SHORTEST_HALF_TAU, LONGEST_HALF_TAU = 0.5, 8.0

TARED = ", tared"  # suffix of a calibration's name after a tare, which changes no axis


@dataclass(frozen=True, slots=True)
class GuardSettings:
    """Limits of the monitors."""

    touch_N: float
    search_m: float
    lost_m: float
    environment_work_J: float
    idle_N: float  # below this force and this torque the tool is idle
    idle_Nm: float
    half_wave: Array  # least height in N, N, N, N m, N m, N m. Shape (6,)
    half_wave_shortest_s: float
    half_wave_longest_s: float

    @classmethod
    def of(cls, cell: CellConfig) -> "GuardSettings":
        """Return the limits of a cell."""
        force, tau_s = cell.force, cell.loop_delay_s
        deadbands = np.repeat([force.deadband_N, force.deadband_Nm], 3)
        return cls(
            force.touch_N,
            force.search_m,
            force.lost_m,
            force.environment_work_J,
            idle_N=unverified_axes.IDLE_BANDS * force.deadband_N,
            idle_Nm=unverified_axes.IDLE_BANDS * force.deadband_Nm,
            half_wave=DEADBANDS * deadbands,
            half_wave_shortest_s=SHORTEST_HALF_TAU * tau_s,
            half_wave_longest_s=LONGEST_HALF_TAU * tau_s,
        )


def _zeros() -> Array:
    return np.zeros(6)


@dataclass(frozen=True, slots=True)
class HalfWaves:
    """Half waves of six errors, each detected separately. All of shape (6,)."""

    side: Array = field(default_factory=_zeros)  # sign of the error, 0 before the first half wave
    height: Array = field(default_factory=_zeros)  # of the present half wave so far
    age_s: Array = field(default_factory=_zeros)
    last: Array = field(default_factory=_zeros)  # height of the previous half wave
    before_last: Array = field(default_factory=_zeros)  # of the one before it, with this sign
    count: Array = field(default_factory=_zeros)  # consecutive half waves that did not decay

    def after(self, error: Array, dt_s: float, settings: GuardSettings) -> "HalfWaves":
        """Return the half waves after one more sample.

        Args:
            error: Errors of force [N] and torque [N m] beyond their deadbands. Shape (6,).
            dt_s: Time since the last sample.
            settings: Limits of a half wave.
        """
        size, side = np.abs(error), np.sign(error)
        crossed = (side != 0.0) & (side != self.side)
        height, age_s = np.maximum(self.height, size), self.age_s + dt_s
        if not any(crossed.tolist()):
            return replace(self, height=height, age_s=age_s)
        ended = crossed & (self.side != 0.0)
        in_time = (self.age_s >= settings.half_wave_shortest_s) & (
            self.age_s <= settings.half_wave_longest_s
        )
        persists = (
            in_time
            & (self.height >= settings.half_wave)
            & (self.height >= HALF_WAVE_KEPT * self.before_last)
        )
        return HalfWaves(
            side=np.where(crossed, side, self.side),
            height=np.where(crossed, size, height),
            age_s=np.where(crossed, 0.0, age_s),
            last=np.where(ended, self.height, self.last),
            before_last=np.where(ended, self.last, self.before_last),
            count=np.where(ended, np.where(persists, self.count + 1.0, 0.0), self.count),
        )


@dataclass(frozen=True, slots=True)
class GuardSample:
    """One sample for the monitors: wrench in base axes about the TCP, pose and mode."""

    force_N: Array
    torque_Nm: Array
    T_base_tcp: pin.SE3  # measured
    moved_m: Array  # travel of the contact point since the last sample, base axes. Shape (3,)
    turned_rad: Array  # rotation since the last sample, base axes. Shape (3,)
    contact: Contact  # contact state of the law
    error: Array  # of force and torque beyond their deadbands. Shape (6,)
    limited: Flags  # unverified axes of the tool. Shape (3,)
    setpoint_N: float
    presses: bool  # the set point is not zero: the environment must not move the tool
    rotates: bool  # the mode controls torques
    follows: bool  # tracks a moving surface, whose work along the tool axis is its own
    dt_s: float

    @classmethod
    def of(
        cls,
        sample: LawInput,
        law: LawMotion,
        *,
        T_before: pin.SE3,
        wrench: WrenchAtTcp,
        touched: str,
    ) -> "GuardSample":
        """Return the monitors' view of one sample; mode orientation has no approach.

        The errors are those along the free axes, the only ones that the loop controls. The motion
        is the measured one: a command in flight has changed no force yet.

        Args:
            sample: Input of the law.
            law: Motion that the law has returned.
            T_before: Pose measured at the last sample.
            wrench: With its calibration, and whether `forcemesh check axes` passed with it.
            touched: Calibration verified along the tool by a touch from free space.
        """
        moves, rotates = sample.mode != "orientation", sample.mode != "position"
        error = np.zeros(6)
        if moves and law.error_force_N is not None:
            error[:3] = masked(law.error_force_N, sample, 0)
        if rotates and law.error_torque_Nm is not None:
            error[3:] = masked(law.error_torque_Nm, sample, 3)
        moved_m, turned_rad = motion_between(T_before, sample.T_measured, law.lever_m)
        # A wrong torque turns the tool into its contact, and the force then pushes it back along
        # every axis: while the tool may turn, a touch alone exempts no axis.
        is_touched = touched == wrench.calibration.removesuffix(TARED) and not rotates
        return cls(
            sample.force_N,
            sample.torque_Nm,
            sample.T_measured,
            moved_m,
            turned_rad,
            contact=law.contact if moves else "free",
            error=error,
            limited=np.array([True, True, not is_touched]) & (not wrench.axes_checked),
            setpoint_N=sample.setpoint_N,
            presses=moves and sample.setpoint_N > 0.0,
            rotates=rotates,
            follows=law.follows,
            dt_s=sample.dt_s,
        )


@dataclass(frozen=True, slots=True)
class GuardState:
    """State of the monitors from the start of force feedback on."""

    first: GuardSample | None = None
    began_free: bool = False  # with an approach
    worked: GuardSample | None = None  # last sample whose work is counted
    touched: bool = False
    verified: bool = False  # a touch from free space has pushed back along the tool
    found: bool = False  # the force has been at its set point or below
    environment_work_J: float = 0.0  # work done on the tool by the environment
    tool_work_J: float = 0.0  # work done by the tool
    p_search_m: Array | None = None  # where the present search for contact began
    swing: HalfWaves = field(default_factory=HalfWaves)
    yielding: YieldTravel = field(default_factory=YieldTravel)


def kept_over_restart(before: GuardState) -> GuardState:
    """Return the state kept over a change of set point or mode: the work budgets continue.

    A tool without contact may begin its approach now, with the present readings as reference.
    """
    is_free = before.worked is not None and before.worked.contact != "contact"
    if not before.touched or (is_free and not before.began_free):
        return GuardState(yielding=before.yielding)
    return replace(before, p_search_m=None, swing=HalfWaves(), found=False)


def watch(
    before: GuardState, sample: GuardSample, settings: GuardSettings
) -> tuple[GuardState, Trip | None]:
    """Return the state after one sample, and the trip of the first monitor that fired."""
    R, p_search_m = sample.T_base_tcp.rotation, before.p_search_m
    if sample.contact != "approach":
        p_search_m = None
    elif p_search_m is None:
        p_search_m = np.array(sample.T_base_tcp.translation)
    first, touched = before.first or sample, before.touched or sample.contact == "contact"
    verified, touch_trip = _first_touch(first, sample, settings)
    pushed_back_N = -float(sample.force_N @ R[:, 2])
    now = replace(
        _count_work(before, sample),
        first=first,
        began_free=first.contact == "approach",
        touched=touched,
        verified=verified,
        found=before.found or pushed_back_N <= sample.setpoint_N,
        p_search_m=p_search_m,
        swing=before.swing.after(sample.error, sample.dt_s, settings),
        yielding=unverified_axes.update(
            before.yielding,
            R,
            moved_m=sample.moved_m,
            turned_rad=sample.turned_rad,
            force_N=sample.force_N,
            torque_Nm=sample.torque_Nm,
            limited=sample.limited,
            idle_N=settings.idle_N,
            idle_Nm=settings.idle_Nm,
        ),
    )
    trip = (
        (None if touched else touch_trip)
        or _force_trip(now, sample, settings, pushed_back_N=pushed_back_N)
        or unverified_axes.trip_of(
            now.yielding, R.T @ sample.force_N, sample.limited, rotates=sample.rotates
        )
        or _motion_trip(now, sample, settings)
    )
    return now, trip


def _count_work(before: GuardState, sample: GuardSample) -> GuardState:
    """Add the work between tool and environment since the last counted sample."""
    last = before.worked
    if last is None or not before.touched:
        return replace(before, worked=sample)
    travel_m, turn_rad = motion_between(last.T_base_tcp, sample.T_base_tcp)
    if sample.follows:  # the press verified the sign along this axis, not along the other two
        press_axis = sample.T_base_tcp.rotation[:, 2]
        travel_m = travel_m - (travel_m @ press_axis) * press_axis
    if length(travel_m) < WORK_STEP_M and length(turn_rad) < WORK_STEP_RAD:
        return before
    work_J = 0.5 * float((sample.force_N + last.force_N) @ travel_m)
    if sample.rotates:
        work_J += 0.5 * float((sample.torque_Nm + last.torque_Nm) @ turn_rad)
    environment_work_J = before.environment_work_J
    tool_work_J = before.tool_work_J + max(-work_J, 0.0)
    if sample.presses:
        environment_work_J += max(work_J, 0.0)
    else:  # at set point 0 anything may move the tool; stored work is returned
        tool_work_J = max(tool_work_J - max(work_J, 0.0), 0.0)
    return replace(
        before, worked=sample, environment_work_J=environment_work_J, tool_work_J=tool_work_J
    )


def _first_touch(
    first: GuardSample, sample: GuardSample, settings: GuardSettings
) -> tuple[bool, Trip | None]:
    """Return whether a touch from free space verifies the tool's axis, and the trip otherwise.

    The force must push back along the tool axis: only its increase since the first sample counts.
    """
    if first.contact != "approach":
        return False, None
    grown_N = sample.force_N - first.force_N
    length_N = length(grown_N)
    back_N, least_N = -float(grown_N @ sample.T_base_tcp.rotation[:, 2]), MAIN_PART * length_N
    if length_N <= settings.touch_N or back_N >= least_N:
        return sample.presses and back_N > max(settings.touch_N, least_N), None
    text = (
        f"the first touch reads {back_N:.1f} N back along the tool axis, of {length_N:.1f} N: "
        "a sign, an axis or a frame of the sensor is wrong, or the tool touches with its side"
    )
    return False, tripped("sensor_sign", text, value=back_N, limit=least_N, unit="N")


def _force_trip(
    now: GuardState, sample: GuardSample, settings: GuardSettings, *, pushed_back_N: float
) -> Trip | None:
    """Check a press: passivity, and the force while the tool turns on unverified torques.

    The environment cannot return more work than it received, and the force must not keep rising.
    """
    if not sample.presses:
        return None
    more_J = now.environment_work_J - (1.0 + SWUNG_PART) * now.tool_work_J
    if now.began_free and more_J > settings.environment_work_J:
        text = (
            f"the contact did {now.environment_work_J * 1e3:.0f} mJ of work on the tool and "
            f"received {now.tool_work_J * 1e3:.0f} mJ: a sign or an axis of the sensor is wrong, "
            "or a person pushes"
        )
        limit_J = settings.environment_work_J
        return tripped("sensor_sign", text, value=more_J, limit=limit_J, unit="J")
    limit_N = (1.0 + RISE_PART) * sample.setpoint_N + settings.touch_N
    if sample.rotates and sample.limited.any() and now.found and pushed_back_N > limit_N:
        text = (
            f"the force rose to {pushed_back_N:.1f} N while the tool turned, limit {limit_N:.1f} N:"
            " a sign or an axis of the torque is wrong, or a person pushes; run `forcemesh check "
            "axes`, once for each calibration"
        )
        return tripped("sensor_sign", text, value=pushed_back_N, limit=limit_N, unit="N")
    return None


def _motion_trip(now: GuardState, sample: GuardSample, settings: GuardSettings) -> Trip | None:
    """Check the travel of a search for contact, and that the force does not oscillate."""
    if now.p_search_m is not None:
        press_axis = sample.T_base_tcp.rotation[:, 2]
        travel_m = float((sample.T_base_tcp.translation - now.p_search_m) @ press_axis)
        limit_m = settings.lost_m if now.touched else settings.search_m
        if now.touched and sample.limited[2] and not now.began_free:
            # A wrong axis may look like a lost contact.
            limit_m = min(limit_m, unverified_axes.LIMIT_M)
        if travel_m > limit_m:
            cause = "contact was lost and not found again" if now.touched else "no contact"
            text = f"{cause} within {limit_m * 1e3:g} mm"
            return tripped("travel", text, value=travel_m, limit=limit_m, unit="m")
    if max(now.swing.count.tolist()) < HALF_WAVES:
        return None
    height_N = length(sample.error[:3])
    text = f"the force oscillates and does not settle, the force error is {height_N:.1f} N now"
    return tripped("oscillation", text, value=height_N, unit="N")
