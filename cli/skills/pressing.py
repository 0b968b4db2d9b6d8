"""Force skills touch, press and align. They are clients of the cell like any other."""

from dataclasses import dataclass
from math import degrees

import numpy as np
import pinocchio as pin

from cli.skills.contact_monitor import (
    ContactMonitor,
    ContactSample,
    Debounce,
    ReportProgress,
    force_ends,
    no_progress,
)
from common.bus.configured_cell import ConfiguredCell
from common.motion.frames import rotation_between
from forcemesh.errors import NotReachedError
from forcemesh.messages import Mode, Preset, StartLaw, Vec3
from forcemesh.requests import ForceStartRequest

BAND_N, BAND_NM = 1.0, 0.1
STOPPED_WITHIN_S = 0.2  # an approach continues, and presses, for the delay of its loop
STEADY_S = 0.3
TOUCH_S = 120.0
BACK_M_S = 0.02


@dataclass(frozen=True, slots=True)
class ForceSettings:
    """Law and gain preset of force feedback."""

    law: StartLaw | None = None  # None: the cell file's
    preset: Preset | None = None


@dataclass(frozen=True, slots=True)
class TouchResult:
    """Result: position and peak force of the first contact."""

    tcp_mm: Vec3  # base axes
    way_mm: float  # travel until contact
    peak_N: float


@dataclass(frozen=True, slots=True)
class Held:
    """Result: press force held for a period."""

    setpoint_N: float
    reached_s: float  # from the first contact until it stayed within 1 N
    mean_N: float
    ripple_N: float  # standard deviation
    peak_N: float  # of all samples


@dataclass(frozen=True, slots=True)
class Aligned:
    """Result: alignment of the tool's face with a surface."""

    turned_deg: float
    reached_s: float  # from the first contact
    force_N: float
    torque_Nm: float


def touch(
    cell: ConfiguredCell,
    *,
    force_N: float,
    within_m: float | None,
    back_m: float,
    tell: ReportProgress = no_progress,
) -> TouchResult:
    """Approach along the tool's axis until contact, stop there, or retract.

    Args:
        cell: An armed cell.
        force_N: Target press force of the approach.
        within_m: Longest travel; default: the cell's force.search_m.
        back_m: Distance to retract after contact; 0: stay.
        tell: Receives the progress.

    Raises:
        NotReachedError: No contact within the travel.
        RefusedError, ArmStoppedError, LostError: As raised by the client.
    """
    feeler = ContactMonitor(cell)
    start = feeler.here()
    most_m = cell.config.force.search_m if within_m is None else within_m

    def is_there(felt: ContactSample) -> bool:
        way_m = _along(start, felt)
        if way_m > most_m:
            raise NotReachedError(f"no contact within {1e3 * most_m:g} mm")
        return felt.contact == "contact"

    with force_ends(cell):
        cell.force.begin(ForceStartRequest(mode="position", setpoint_N=force_N))
        felt = feeler.until(is_there, within_s=TOUCH_S, what="approaching", tell=tell)
    last = felt[-1]
    peak_N = max(*(f.press_N for f in felt), feeler.peak_N(STOPPED_WITHIN_S))
    if back_m > 0.0:
        cell.jog(shift_m=(0.0, 0.0, -back_m), axes="tool", speed_m_s=_back_m_s(cell))
    x, y, z = (1e3 * float(part) for part in last.T_base_tcp.translation)
    return TouchResult((x, y, z), max(0.0, 1e3 * _along(start, last)), peak_N)


def press(
    cell: ConfiguredCell,
    *,
    force_N: float,
    hold_s: float,
    within_s: float,
    how: ForceSettings,
    tell: ReportProgress = no_progress,
) -> Held:
    """Press along the tool's axis until the force is reached, and hold it for a period.

    Raises NotReachedError when it is not reached within `within_s`, or not held until the end;
    else as `touch`.
    """
    feeler = ContactMonitor(cell)
    with force_ends(cell):
        cell.force.begin(_start(force_N, "position", how))
        there = Debounce(lambda felt: _presses_with(felt, force_N), STEADY_S)
        felt = feeler.until(there, within_s=within_s, what="pressing", tell=tell)
        since_s = there.since_s or 0.0
        kept = feeler.until(
            Debounce(lambda _: True, hold_s), within_s=hold_s + 1.0, what="holding", tell=tell
        )
    forces = np.array([sample.press_N for sample in kept])
    last_N = float(forces[[sample.t_s >= kept[-1].t_s - STEADY_S for sample in kept]].mean())
    if abs(last_N - force_N) > BAND_N:
        text = f"{force_N:g} N were reached, but {last_N:.1f} N are measured after {hold_s:g} s"
        raise NotReachedError(f"{text}: the set point or the contact has changed")
    return Held(
        setpoint_N=force_N,
        reached_s=max(0.0, since_s - _first_contact_s(felt)),
        mean_N=float(forces.mean()),
        ripple_N=float(forces.std()),
        peak_N=max(sample.press_N for sample in felt + kept),
    )


def align(
    cell: ConfiguredCell,
    *,
    force_N: float,
    within_s: float,
    how: ForceSettings,
    tell: ReportProgress = no_progress,
) -> Aligned:
    """Press and rotate about the TCP until no torque is left, so that the face lies flat.

    Raises as `press`.
    """
    feeler = ContactMonitor(cell)
    start = feeler.here()

    def is_flat(felt: ContactSample) -> bool:
        rests = float(np.linalg.norm(felt.torque_Nm)) <= BAND_NM
        return rests and _presses_with(felt, force_N)

    with force_ends(cell):
        cell.force.begin(_start(force_N, "both", how))
        there = Debounce(is_flat, STEADY_S)
        felt = feeler.until(there, within_s=within_s, what="laying flat", tell=tell)
    turned = rotation_between(start.rotation, felt[-1].T_base_tcp.rotation)
    return Aligned(
        turned_deg=degrees(float(np.linalg.norm(turned))),
        reached_s=max(0.0, (there.since_s or 0.0) - _first_contact_s(felt)),
        force_N=felt[-1].press_N,
        torque_Nm=float(np.linalg.norm(felt[-1].torque_Nm)),
    )


def _start(force_N: float, mode: Mode, how: ForceSettings) -> ForceStartRequest:
    return ForceStartRequest(mode=mode, setpoint_N=force_N, law=how.law, preset=how.preset)


def _presses_with(felt: ContactSample, force_N: float) -> bool:
    """Return whether the tool is in contact and presses with a force; noise alone is no contact."""
    return felt.contact == "contact" and abs(felt.press_N - force_N) <= BAND_N


def _first_contact_s(felt: list[ContactSample]) -> float:
    return next((sample.t_s for sample in felt if sample.contact == "contact"), felt[0].t_s)


def _along(start: pin.SE3, felt: ContactSample) -> float:
    """Return the travel of the TCP along the tool's axis since the start [m]."""
    way_m = felt.T_base_tcp.translation - start.translation
    return float(way_m @ start.rotation[:, 2])


def _back_m_s(cell: ConfiguredCell) -> float:
    return min(BACK_M_S, cell.config.limits.speed_m_s)
