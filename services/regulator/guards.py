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
from common.motion.frames import Array, length, rotation_between
from forcemesh.faults import tripped
from forcemesh.messages import Trip
from services.regulator import unverified_axes
from services.regulator.law import Contact, LawInput, LawMotion, masked
from services.regulator.unverified_axes import Flags, ToolMotion, YieldSettings, YieldTravel

WORK_STEP_M, WORK_STEP_RAD = 2e-5, 2e-4  # smaller steps are pose noise
SWUNG_PART = 0.5  # of the work done by the tool: a delayed force seems to return that much
MAIN_PART = 0.7  # share of the first force along the tool axis: within 45 degrees of it
RISE_PART = 0.5  # of the set point, plus touch_N: no correct rotation raises the force as much
HALF_WAVES = 10  # five periods
HALF_WAVE_KEPT = 0.9  # a half wave smaller than this share of the last one of its sign decays
DEADBANDS = 10.0  # smaller half waves, in deadbands, are noise or harmless
SHORTEST_HALF_TAU, LONGEST_HALF_TAU = 0.5, 8.0

STILL = ToolMotion(np.zeros(3), np.zeros(3))
NONE_LIMITED: Flags = np.zeros(3, dtype=bool)


@dataclass(frozen=True, slots=True)
class OscillationSettings:
    """Least height and range of durations of a half wave."""

    least: Array  # height in N, N, N, N m, N m, N m. Shape (6,)
    shortest_s: float
    longest_s: float

    @classmethod
    def of(cls, cell: CellConfig) -> "OscillationSettings":
        """Return the settings of a cell."""
        deadbands = np.repeat([cell.force.deadband_N, cell.force.deadband_Nm], 3)
        tau_s = cell.loop_delay_s
        return cls(DEADBANDS * deadbands, SHORTEST_HALF_TAU * tau_s, LONGEST_HALF_TAU * tau_s)


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

    @property
    def swings(self) -> bool:
        """Whether one of the errors has oscillated for five periods."""
        return bool(max(self.count.tolist()) >= HALF_WAVES)

    def after(self, error: Array, dt_s: float, settings: OscillationSettings) -> "HalfWaves":
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
        in_time = (self.age_s >= settings.shortest_s) & (self.age_s <= settings.longest_s)
        persists = (
            in_time
            & (self.height >= settings.least)
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
class GuardSettings:
    """Limits of the monitors."""

    touch_N: float
    search_m: float
    lost_m: float
    environment_work_J: float
    swing: OscillationSettings
    yielding: YieldSettings

    @classmethod
    def of(cls, cell: CellConfig) -> "GuardSettings":
        """Return the limits of a cell."""
        force = cell.force
        return cls(
            force.touch_N,
            force.search_m,
            force.lost_m,
            force.environment_work_J,
            OscillationSettings.of(cell),
            YieldSettings.of(cell),
        )


@dataclass(frozen=True, slots=True)
class GuardSample:
    """One sample for the monitors: wrench in base axes about the TCP, pose and mode."""

    force_N: Array
    torque_Nm: Array
    T_base_tcp: pin.SE3  # measured
    contact: Contact  # contact state of the law
    error: Array  # of force and torque beyond their deadbands. Shape (6,)
    rotates: bool  # the mode controls torques
    dt_s: float
    follows: bool = False  # tracks a moving surface, whose work along the tool axis is its own
    presses: bool = True  # the set point is not zero: the environment must not move the tool
    motion: ToolMotion = STILL  # by force feedback only
    limited: Flags = field(
        default_factory=lambda: NONE_LIMITED
    )  # unverified axes of the tool. Shape (3,)
    setpoint_N: float = 0.0

    @classmethod
    def of(
        cls, sample: LawInput, law: LawMotion, motion: ToolMotion, limited: Flags
    ) -> "GuardSample":
        """Return the monitors' view of one sample; mode orientation has no approach.

        The errors are those along the free axes, the only ones that the loop controls.
        """
        moves, rotates = sample.mode != "orientation", sample.mode != "position"
        error = np.zeros(6)
        if moves and law.error_force_N is not None:
            error[:3] = masked(law.error_force_N, sample, 0)
        if rotates and law.error_torque_Nm is not None:
            error[3:] = masked(law.error_torque_Nm, sample, 3)
        return cls(
            force_N=sample.force_N,
            torque_Nm=sample.torque_Nm,
            T_base_tcp=sample.T_measured,
            contact=law.contact if moves else "free",
            error=error,
            rotates=rotates,
            dt_s=sample.dt_s,
            follows=law.follows,
            presses=moves and sample.setpoint_N > 0.0,
            motion=motion,
            limited=limited,
            setpoint_N=sample.setpoint_N,
        )

    @property
    def pushed_back_N(self) -> float:
        """Contact force along the tool axis, positive when it pushes the tool back."""
        return -float(self.force_N @ self.T_base_tcp.rotation[:, 2])


@dataclass(frozen=True, slots=True)
class GuardState:
    """State of the monitors from the start of force feedback on."""

    first: GuardSample | None = None
    worked: GuardSample | None = None  # last sample whose work is counted
    touched: bool = False
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
    now = replace(before, p_search_m=None, swing=HalfWaves(), found=False)
    if before.touched and not (is_free and not _began_free(before)):
        return now
    return replace(
        now, first=None, worked=None, touched=False, environment_work_J=0.0, tool_work_J=0.0
    )


def verifies_press_axis(now: GuardState, sample: GuardSample, settings: GuardSettings) -> bool:
    """Return whether a touch from free space has pushed back along the tool."""
    if not _began_free(now) or now.first is None or not sample.presses:
        return False
    grown_N = sample.force_N - now.first.force_N
    back_N = -float(grown_N @ sample.T_base_tcp.rotation[:, 2])
    return back_N > max(settings.touch_N, MAIN_PART * length(grown_N))


def watch(
    before: GuardState, sample: GuardSample, settings: GuardSettings
) -> tuple[GuardState, Trip | None]:
    """Return the state after one sample, and the trip of the first monitor that fired."""
    touched = before.touched or sample.contact == "contact"
    p_search_m = before.p_search_m
    if sample.contact != "approach":
        p_search_m = None
    elif p_search_m is None:
        p_search_m = np.array(sample.T_base_tcp.translation)
    now = replace(
        _count_work(before, sample),
        first=before.first or sample,
        touched=touched,
        found=before.found or sample.pushed_back_N <= sample.setpoint_N,
        p_search_m=p_search_m,
        swing=before.swing.after(sample.error, sample.dt_s, settings.swing),
        yielding=unverified_axes.update(
            before.yielding,
            sample.motion,
            sample.T_base_tcp.rotation,
            force_N=sample.force_N,
            torque_Nm=sample.torque_Nm,
            limited=sample.limited,
            settings=settings.yielding,
        ),
    )
    rules = (_sign_trip, _work_trip, _rise_trip, _yield_trip, _travel_trip, _swing_trip)
    return now, next((trip for rule in rules if (trip := rule(now, sample, settings))), None)


def _began_free(now: GuardState) -> bool:
    return now.first is not None and now.first.contact == "approach"


def _count_work(before: GuardState, sample: GuardSample) -> GuardState:
    """Add the work between tool and environment since the last counted sample."""
    last = before.worked
    if last is None or not before.touched:
        return replace(before, worked=sample)
    travel_m = sample.T_base_tcp.translation - last.T_base_tcp.translation
    if sample.follows:  # the press verified the sign along this axis, not along the other two
        press_axis = sample.T_base_tcp.rotation[:, 2]
        travel_m = travel_m - (travel_m @ press_axis) * press_axis
    turn_rad = rotation_between(last.T_base_tcp.rotation, sample.T_base_tcp.rotation)
    if length(travel_m) < WORK_STEP_M and length(turn_rad) < WORK_STEP_RAD:
        return before
    work_J = 0.5 * float((sample.force_N + last.force_N) @ travel_m)
    if sample.rotates:
        work_J += 0.5 * float((sample.torque_Nm + last.torque_Nm) @ turn_rad)
    environment_work_J, tool_work_J = max(work_J, 0.0), before.tool_work_J + max(-work_J, 0.0)
    if not sample.presses:  # at set point 0 anything may move the tool; stored work is returned
        return replace(
            before, worked=sample, tool_work_J=max(tool_work_J - environment_work_J, 0.0)
        )
    return replace(
        before,
        worked=sample,
        environment_work_J=before.environment_work_J + environment_work_J,
        tool_work_J=tool_work_J,
    )


def _sign_trip(now: GuardState, sample: GuardSample, settings: GuardSettings) -> Trip | None:
    """Check that the force of the first touch pushes back along the tool axis."""
    if now.touched or now.first is None or not _began_free(now):
        return None
    grown_N = sample.force_N - now.first.force_N
    length_N = length(grown_N)
    back_N = -float(grown_N @ sample.T_base_tcp.rotation[:, 2])
    if length_N <= settings.touch_N or back_N >= MAIN_PART * length_N:
        return None
    text = (
        f"the first touch reads {back_N:.1f} N back along the tool axis, of {length_N:.1f} N: "
        "a sign, an axis or a frame of the sensor is wrong, or the tool touches with its side"
    )
    return tripped("sensor_sign", text, value=back_N, limit=MAIN_PART * length_N, unit="N")


def _work_trip(now: GuardState, sample: GuardSample, settings: GuardSettings) -> Trip | None:
    """Check passivity: the environment cannot return more work than it received."""
    more_J = now.environment_work_J - (1.0 + SWUNG_PART) * now.tool_work_J
    if not _began_free(now) or not sample.presses or more_J <= settings.environment_work_J:
        return None
    text = (
        f"the contact did {now.environment_work_J * 1e3:.0f} mJ of work on the tool and received "
        f"{now.tool_work_J * 1e3:.0f} mJ: a sign or an axis of the sensor is wrong, or a person "
        "pushes"
    )
    return tripped("sensor_sign", text, value=more_J, limit=settings.environment_work_J, unit="J")


def _rise_trip(now: GuardState, sample: GuardSample, settings: GuardSettings) -> Trip | None:
    """Check the force while the tool turns on unverified torques: it must not keep rising."""
    limit_N = (1.0 + RISE_PART) * sample.setpoint_N + settings.touch_N
    unverified_rotation = sample.rotates and sample.presses and bool(sample.limited.any())
    if not unverified_rotation or not now.found or sample.pushed_back_N <= limit_N:
        return None
    text = (
        f"the force rose to {sample.pushed_back_N:.1f} N while the tool turned, limit "
        f"{limit_N:.1f} N: a sign or an axis of the torque is wrong, or a person "
        "pushes; run `forcemesh check axes`, once for each calibration"
    )
    return tripped("sensor_sign", text, value=sample.pushed_back_N, limit=limit_N, unit="N")


def _yield_trip(now: GuardState, sample: GuardSample, _: GuardSettings) -> Trip | None:
    """Check the travel along unverified axes."""
    force_tool_N = sample.T_base_tcp.rotation.T @ sample.force_N
    return unverified_axes.trip_of(
        now.yielding, force_tool_N, sample.limited, rotates=sample.rotates
    )


def _travel_trip(now: GuardState, sample: GuardSample, settings: GuardSettings) -> Trip | None:
    """Check the travel of a search for contact."""
    if now.p_search_m is None:
        return None
    press_axis = sample.T_base_tcp.rotation[:, 2]
    travel_m = float((sample.T_base_tcp.translation - now.p_search_m) @ press_axis)
    limit_m = settings.lost_m if now.touched else settings.search_m
    if now.touched and sample.limited[2] and not _began_free(now):
        # A wrong axis may look like a lost contact.
        limit_m = min(limit_m, unverified_axes.LIMIT_M)
    if travel_m <= limit_m:
        return None
    cause = "contact was lost and not found again" if now.touched else "no contact"
    text = f"{cause} within {limit_m * 1e3:g} mm"
    return tripped("travel", text, value=travel_m, limit=limit_m, unit="m")


def _swing_trip(now: GuardState, sample: GuardSample, _: GuardSettings) -> Trip | None:
    if not now.swing.swings:
        return None
    height_N = length(sample.error[:3])
    text = f"the force oscillates and does not settle, the force error is {height_N:.1f} N now"
    return tripped("oscillation", text, value=height_N, unit="N")
