"""Force skills touch, press, align and guide. They are clients of the cell like any other."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import degrees, hypot

import numpy as np
import pinocchio as pin

from cli.skills.contact_monitor import (
    ContactMonitor,
    ContactSample,
    Debounce,
    ReportProgress,
    no_progress,
    stop_force_at_end,
)
from cli.skills.path_file import thinned
from common.bus.configured_cell import ConfiguredCell
from common.motion.convert import record_of, vec3
from common.motion.frames import Array, rotation_between
from forcemesh.errors import NotReachedError
from forcemesh.messages import TOUCHING, Mode, Vec3
from forcemesh.requests import ForceStartRequest

BAND_N, BAND_NM = 1.0, 0.1
STOP_DELAY_S = 0.2  # an approach continues, and presses, for the delay of its loop
STEADY_S = 0.3
TOUCH_S = 120.0
EVENT_S = 0.5  # until the contact event of a touch is received
RETRACT_M_S = 0.02
RECORD_S = 0.02  # between two poses of a guided path


@dataclass(frozen=True, slots=True)
class TouchResult:
    """Result: position and peak force of the first contact."""

    tcp_mm: Vec3  # base axes
    travel_mm: float  # travel until contact
    peak_N: float


@dataclass(frozen=True, slots=True)
class PressHoldResult:
    """Result: press force held for a period."""

    setpoint_N: float
    reached_s: float  # from the first contact until it stayed within 1 N
    mean_N: float
    ripple_N: float  # standard deviation
    peak_N: float  # of all samples


@dataclass(frozen=True, slots=True)
class AlignResult:
    """Result: alignment of the tool's face with a surface."""

    turned_deg: float
    reached_s: float  # from the first contact
    force_N: float
    torque_Nm: float


def touch(
    cell: ConfiguredCell,
    *,
    force_N: float,
    search_m: float | None,
    retract_m: float,
    progress: ReportProgress = no_progress,
) -> TouchResult:
    """Approach along the tool's axis until contact, stop there, or retract.

    Args:
        cell: An armed cell.
        force_N: Target press force of the approach.
        search_m: Longest travel; default: the cell's force.search_m.
        retract_m: Distance to retract after contact; 0: stay.
        progress: Receives the progress.

    Raises:
        NotReachedError: No contact within the travel.
        RefusedError, ArmStoppedError, LostError: As raised by the client.
    """
    monitor = ContactMonitor(cell, progress)
    start, before = monitor.tcp_pose(), cell.contact()
    limit_m = cell.config.force.search_m if search_m is None else search_m

    def is_touching(sample: ContactSample) -> bool:
        travel_m = _axial_travel_m(start, sample.T_base_tcp.translation)
        if travel_m > limit_m:
            raise NotReachedError(f"no contact within {1e3 * limit_m:g} mm")
        return sample.contact == "contact"

    with stop_force_at_end(cell):
        cell.force.begin(ForceStartRequest(mode="position", setpoint_N=force_N))
        samples = monitor.until(is_touching, within_s=TOUCH_S, label="approaching")
    p_tcp_m = samples[-1].T_base_tcp.translation
    if before.state not in TOUCHING:  # the place of the touch itself, not of its report
        p_tcp_m = np.array(cell.contact.wait("impact", within_s=EVENT_S, after=before).position_m)
    peak_N = max(*(f.press_N for f in samples), monitor.peak_N(STOP_DELAY_S))
    if retract_m > 0.0:
        speed_m_s = min(RETRACT_M_S, cell.config.limits.speed_m_s)
        cell.jog(shift_m=(0.0, 0.0, -retract_m), axes="tool", speed_m_s=speed_m_s)
    travel_m = _axial_travel_m(start, p_tcp_m)
    return TouchResult(vec3(1e3 * p_tcp_m), max(0.0, 1e3 * travel_m), peak_N)


def press(
    cell: ConfiguredCell,
    request: ForceStartRequest,
    *,
    hold_s: float,
    within_s: float,
    progress: ReportProgress = no_progress,
) -> PressHoldResult:
    """Press along the tool's axis until the requested force is reached, and hold it for a period.

    Raises NotReachedError when it is not reached within `within_s`, or not held until the end;
    else as `touch`.
    """
    monitor, force_N = ContactMonitor(cell, progress), request.setpoint_N
    with stop_force_at_end(cell):
        cell.force.begin(request)
        condition = Debounce(lambda samples: _presses_with(samples, force_N), STEADY_S)
        samples = monitor.until(condition, within_s=within_s, label="pressing")
        since_s = condition.since_s or 0.0
        held = monitor.until(
            Debounce(lambda _: True, hold_s),
            within_s=hold_s + 1.0,
            label="holding",
        )
    forces = np.array([sample.press_N for sample in held])
    last_N = float(forces[[sample.t_s >= held[-1].t_s - STEADY_S for sample in held]].mean())
    if abs(last_N - force_N) > BAND_N:
        text = f"{force_N:g} N were reached, but {last_N:.1f} N are measured after {hold_s:g} s"
        raise NotReachedError(f"{text}: the set point or the contact has changed")
    return PressHoldResult(
        setpoint_N=force_N,
        reached_s=max(0.0, since_s - _first_contact_s(samples)),
        mean_N=float(forces.mean()),
        ripple_N=float(forces.std()),
        peak_N=max(sample.press_N for sample in samples + held),
    )


def align(
    cell: ConfiguredCell,
    request: ForceStartRequest,
    *,
    within_s: float,
    progress: ReportProgress = no_progress,
) -> AlignResult:
    """Press and rotate about the TCP until no torque is left, so that the face lies flat.

    The request is of mode `both`. Raises as `press`.
    """
    monitor = ContactMonitor(cell, progress)
    start = monitor.tcp_pose()

    def is_flat(sample: ContactSample) -> bool:
        is_torque_free = hypot(*sample.torque_Nm) <= BAND_NM
        return is_torque_free and _presses_with(sample, request.setpoint_N)

    with stop_force_at_end(cell):
        cell.force.begin(request)
        condition = Debounce(is_flat, STEADY_S)
        samples = monitor.until(condition, within_s=within_s, label="laying flat")
    turned = rotation_between(start.rotation, samples[-1].T_base_tcp.rotation)
    return AlignResult(
        turned_deg=degrees(hypot(*turned)),
        reached_s=max(0.0, (condition.since_s or 0.0) - _first_contact_s(samples)),
        force_N=samples[-1].press_N,
        torque_Nm=hypot(*samples[-1].torque_Nm),
    )


def _presses_with(sample: ContactSample, force_N: float) -> bool:
    """Return whether the tool is in contact and presses with a force; noise alone is no contact."""
    return sample.contact == "contact" and abs(sample.press_N - force_N) <= BAND_N


def _first_contact_s(samples: list[ContactSample]) -> float:
    return next((sample.t_s for sample in samples if sample.contact == "contact"), samples[0].t_s)


def _axial_travel_m(start: pin.SE3, p_tcp_m: Array) -> float:
    """Return the travel of the TCP along the tool's axis since the start [m]."""
    return float((p_tcp_m - start.translation) @ start.rotation[:, 2])


# --- hand guiding ---------------------------------------------------------------------------------


@dataclass(slots=True)
class GuidedPath:
    """Recorded path of the flange in base; it grows while the arm is guided."""

    times_s: list[float] = field(default_factory=list)
    poses: list[pin.SE3] = field(default_factory=list)
    peak_N: float = 0.0

    @property
    def length_mm(self) -> float:
        """Length of the flange path."""
        places = np.array([T.translation for T in self.poses]).reshape(-1, 3)
        return 1e3 * float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())


def guide(
    cell: ConfiguredCell,
    recording: GuidedPath,
    *,
    mode: Mode,
    seconds: float,
    is_finished: Callable[[], bool],
    progress: ReportProgress = no_progress,
) -> None:
    """Let a hand guide the tool for a period, or until `is_finished` returns true.

    Args:
        cell: An armed cell; the tool is free of contact at the start.
        recording: Receives the samples, also when an error ends the guiding.
        mode: Guided motion: `position`, `orientation` or both.
        seconds: Longest time [s].
        is_finished: Called at each sample.
        progress: Receives the progress.

    Raises:
        RefusedError, ArmStoppedError, LostError: As raised by the client.
    """
    monitor = ContactMonitor(cell, progress)
    T_tcp_flange = cell.config.tool.T_flange_tcp.pose.inverse()

    def add_sample(sample: ContactSample) -> bool:
        if not recording.times_s or sample.t_s - recording.times_s[-1] >= RECORD_S:
            recording.times_s.append(sample.t_s)
            recording.poses.append(sample.T_base_tcp * T_tcp_flange)
        recording.peak_N = max(recording.peak_N, hypot(*sample.force_N))
        return sample.t_s >= seconds or is_finished()

    with stop_force_at_end(cell):
        cell.force.guide(mode)
        monitor.until(add_sample, within_s=seconds + 1.0, label="guided")


def play_back(
    cell: ConfiguredCell,
    recorded: Sequence[pin.SE3],
    progress: ReportProgress = no_progress,
    *,
    tolerance_m: float,
    speed_m_s: float | None,
) -> int:
    """Move along recorded poses of the flange with a stop at each; return their number.

    These are ordinary moves without force feedback; only the arbiter's limits stop them.

    Raises RefusedError, ArmStoppedError, NotReachedError, LostError as a move does.
    """
    poses = thinned(recorded, tolerance_m)
    for number, T in enumerate(poses):
        progress(float(number), float(len(poses)), f"pose {number + 1} of {len(poses)}")
        pose = record_of(T)
        cell.move.to(pose.position_m, pose.orientation_xyzw, speed_m_s=speed_m_s)
    return len(poses)
