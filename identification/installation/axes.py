"""Findings on the installation from the axis permutations of force and torque: texts, remedies."""

import math

import numpy as np

from common.motion.frames import (
    Array,
    Oat,
    R_from_oat,
    oat_from_R,
    rotation_from_vector,
    vector_from_rotation,
)
from identification.installation.axis_fit import (
    EYE,
    ForceFit,
    TorqueFit,
    TorqueFits,
    nearest_wiring,
    turn_angle,
)
from identification.installation.payload import COM_M
from identification.installation.terms import ExpectedInstallation, InstallationFinding

LEVER_LEAST_M, TOOL_LEAST_M = 0.005, 0.03
SIDE_COSINE = 0.3
AXIS_NAMES = "xyz"
LARGEST_RAD, RESEMBLES_RAD = math.tau + 0.01, math.radians(5.0)  # angles in radians
NEARLY_UPRIGHT = math.sin(math.radians(2.0))
PUSH = "`forcemesh check axes --push` shows it"


def same(A: Array, B: Array) -> bool:
    """Return whether two permutations are the same."""
    return bool(np.array_equal(A, B))


def com_side(com_m: Array, expected: ExpectedInstallation) -> int:
    """Return 1 for a centre of mass on the side of the tool, -1 if opposite, 0 if unknown.

    Both the known payload and the TCP count. Either may be that of another tool, so one that
    agrees is enough.
    """
    lever_m = math.hypot(*com_m)
    if lever_m <= LEVER_LEAST_M:
        return 0
    cosines = [
        float(com_m @ known) / (lever_m * math.hypot(*known))
        for known, least_m in (
            (expected.com_m, LEVER_LEAST_M),
            (expected.p_sensor_tcp_m, TOOL_LEAST_M),
        )
        if known is not None and math.hypot(*known) >= least_m
    ]
    sides = {int(np.sign(cosine)) for cosine in cosines if abs(cosine) > SIDE_COSINE}
    return 1 if 1 in sides else min(sides, default=0)


def plausible_fits(torque: TorqueFits, expected: ExpectedInstallation) -> tuple[TorqueFit, ...]:
    """Return the torque fits whose centre of mass is not on the wrong side."""
    return tuple(fit for fit in torque.fits if com_side(fit.com_m, expected) >= 0)


def axis_findings(
    force: ForceFit, torque: TorqueFits, expected: ExpectedInstallation
) -> list[InstallationFinding]:
    """Return the findings on axes and signs, given a force fit that is explained and unique."""
    fits = plausible_fits(torque, expected) or torque.fits
    torque_findings = []
    if not torque.explained:
        text = (
            f"the moments ({torque.spread_Nm:.3g} N m rms) fit a weight in no "
            f"axis map, the residual is {torque.fits[0].rms_Nm:.2g} N m"
        )
        remedy = "check for a dead channel, a cable that pulls, or a wrong calibration matrix"
        torque_findings = [InstallationFinding("torque_axes", text, remedy)]
    if same(force.wiring, EYE) and not force.turned:
        return torque_findings or _of_torque(torque, expected)
    # Moments that exclude nothing agree with any force permutation.
    if torque.shown and not any(same(fit.wiring, force.wiring) for fit in fits):
        return [_channel_finding(force, fits, expected)]
    if np.linalg.det(force.wiring) < 0.0:
        return [_mirrored(force), *torque_findings]
    torques_match = any(same(fit.wiring, EYE) for fit in fits) and not same(force.wiring, EYE)
    # A rotation of a few degrees from a permutation is play; the calibration identifies it.
    Q = force.wiring @ force.rotation if force.turned else force.wiring
    return [turned_finding(Q, expected, shown=torque.shown and not torques_match), *torque_findings]


def _of_torque(torque: TorqueFits, expected: ExpectedInstallation) -> list[InstallationFinding]:
    """Return the findings on the torques when the forces are right."""
    fits = plausible_fits(torque, expected)
    if not torque.shown or any(same(fit.wiring, EYE) for fit in fits):
        return []
    best = next((fit for fit in torque.fits if same(fit.wiring, -EYE)), None)
    if best is not None:
        text = (
            "the forces are right, the torques are all reversed: as they are, the centre of mass "
            f"would be {1e3 * np.linalg.norm(best.com_m):.0f} mm on the other side of the sensor"
        )
    else:
        best = _most_likely(fits or torque.fits, expected)
        text = f"the forces are right, but of the torques {wrong_channels(best.wiring, 'M')}"
    return [InstallationFinding("torque_axes", text, driver_remedy(best.wiring, "M"))]


def _most_likely(fits: tuple[TorqueFit, ...], expected: ExpectedInstallation) -> TorqueFit:
    """Return the fit with the expected centre of mass, else that with the fewest mistakes."""

    def likelihood(fit: TorqueFit) -> tuple[bool, float, float]:
        known = expected.com_m
        agrees = known is not None and math.hypot(*fit.com_m - known) <= COM_M
        return agrees, float(np.trace(fit.wiring)), -fit.rms_Nm

    return max(fits, key=likelihood)


def _channel_finding(
    force: ForceFit, fits: tuple[TorqueFit, ...], expected: ExpectedInstallation
) -> InstallationFinding:
    """Return the finding for forces and torques that differ: an error of channels, not mounting."""
    torque = _most_likely(fits, expected).wiring
    of = "of the torques " + wrong_channels(torque, "M")
    torques = "the torques are right" if same(torque, EYE) else of
    if same(force.wiring, EYE):
        text = f"the forces are rotated by {rotation_text(force.rotation.T)}, but {torques}"
        remedy = "check for a rotation that the driver applies to the forces but not to the torques"
        return InstallationFinding("force_axes", f"{text}: no mounting does that", remedy)
    text = f"of the forces {wrong_channels(force.wiring, 'F')}, but {torques}"
    remedies = [driver_remedy(force.wiring, "F")]
    remedies += [] if same(torque, EYE) else [driver_remedy(torque, "M")]
    return InstallationFinding("force_axes", f"{text}: no mounting does that", "; ".join(remedies))


def _mirrored(force: ForceFit) -> InstallationFinding:
    """Return the finding for mirrored axes, which no mounting has; a hanging arm reads the same."""
    if same(force.wiring, -EYE):
        text = (
            "all six readings are reversed: the sensor reports the tool's reaction, not the load "
            "on it, or the arm hangs from the ceiling"
        )
        remedy = (
            f"push the tool by hand ({PUSH}): if the force reads against the push, reverse all six "
            "signs in the driver; if along it, write gravity_direction_in_base: [0, 0, 1]"
        )
        return InstallationFinding("reaction", text, remedy)
    text = f"the axes are mirrored: {wrong_channels(force.wiring, 'F')}, and the torques alike"
    remedy = (
        f"{driver_remedy(force.wiring, 'FM')}; only if the arm hangs from the ceiling: "
        "gravity_direction_in_base: [0, 0, 1], "
        f"and a sensor turned by {rotation_text(-force.wiring.T)}"
    )
    return InstallationFinding("force_axes", f"{text}: no mounting does that", remedy)


def turned_finding(Q: Array, expected: ExpectedInstallation, *, shown: bool) -> InstallationFinding:
    """Return the finding for a sensor whose mounting differs from the cell file.

    Args:
        Q: Rotation that all channels show: reading = Q times the expected one. Shape (3, 3).
        expected: Expected installation, from the cell file.
        shown: Whether the torques are known to be rotated by Q too.
    """
    channels = wrong_channels(nearest_wiring(Q), "F")
    source = "the recorded attitudes say" if expected.oat_deg is None else "the cell file says"
    text = f"the sensor is turned by {rotation_text(Q.T)} from what {source}"
    if channels:
        text += f" ({channels}{', and the torques alike' if shown else ''})"
    if expected.R_flange_sensor is None:
        remedy = "rotate the recorded attitudes of the sensor by it"
        return InstallationFinding("mounting", text, remedy)
    R = expected.R_flange_sensor @ Q.T
    if expected.oat_deg is not None and max(map(abs, expected.oat_deg)) <= LARGEST_RAD:
        R_as_radians = R_from_oat(Oat(*expected.oat_deg))
        if turn_angle(R_as_radians.T @ R) < RESEMBLES_RAD:
            text += f": oat_deg {list(expected.oat_deg)} is in radians, it must be in degrees"
            R = R_as_radians
    remedy = f"write {oat_text(R)}"
    if not shown:
        remedy += (
            f", if the torques are rotated too, which this tool's moment does not show; {PUSH}"
        )
    return InstallationFinding("mounting", text, remedy)


def unidentified(torque: TorqueFits, expected: ExpectedInstallation) -> list[str]:
    """Return the properties that the tool's moment could not identify."""
    if not torque.shown:
        return [f"the torques, for the tool's moment is only {torque.spread_Nm:.2g} N m: {PUSH}"]
    wirings = [fit.wiring for fit in plausible_fits(torque, expected)]
    if any(same(wiring, -EYE) for wiring in wirings):
        return [f"whether the torques are all reversed: {PUSH}"]
    rows = " and ".join(uncertain_torques(wirings))
    return [f"the sign of {rows}, which this tool's moment does not show: {PUSH}"] if rows else []


def uncertain_torques(wirings: list[Array]) -> list[str]:
    """Return the channels of torque that not all of the possible permutations leave in place."""
    return [f"M{AXIS_NAMES[k]}" for k in range(3) if any(W[k, k] < 1.0 for W in wirings)]


def mounting_remarks(force: ForceFit) -> list[str]:
    """Return a remark on a sensor that is a few degrees off."""
    degrees = math.degrees(force.turn_rad)
    if degrees < 3.0:
        return []
    return [f"why the sensor is {degrees:.1f} degrees off: `forcemesh calibrate` corrects that"]


# --- texts ----------------------------------------------------------------------------------------


def wrong_channels(wiring: Array, of: str) -> str:
    """Return the axis that each wrong channel shows, as "Fx shows -y"; `of` is F or M."""
    wrong = _wrong_rows(wiring)
    return ", ".join(f"{of}{channel} shows {sign or '+'}{axis}" for channel, sign, axis in wrong)


def _wrong_rows(wiring: Array) -> list[tuple[str, str, str]]:
    """Return name, sign and axis of each row that is not that of the identity."""
    rows = zip(AXIS_NAMES, wiring, EYE, strict=True)
    return [
        (name, "-" if row.sum() < 0.0 else "", AXIS_NAMES[int(np.argmax(np.abs(row)))])
        for name, row, right in rows
        if not same(row, right)
    ]


def rotation_text(R: Array) -> str:
    """Return a rotation as "90 degrees about z"."""
    angle, axis = math.degrees(turn_angle(R)), vector_from_rotation(R)
    axis = axis / math.hypot(*axis)
    largest = int(np.argmax(np.abs(axis)))
    if abs(axis[largest]) > 0.99:
        sign = "" if axis[largest] > 0.0 else "-"
        return f"{angle:.0f} degrees about {sign}{AXIS_NAMES[largest]}"
    return f"{angle:.0f} degrees about ({', '.join(f'{part:.2f}' for part in axis)})"


def oat_text(R_flange_sensor: Array) -> str:
    """Return an orientation in the format of the cell file, to a tenth of a degree."""
    R = R_flange_sensor
    tilt = math.hypot(R[0, 2], R[1, 2])
    if 0.0 < tilt < NEARLY_UPRIGHT:  # O and T are degenerate here: only their sum is known
        axis = np.cross(R[:, 2], [0.0, 0.0, math.copysign(1.0, R[2, 2])])
        R = rotation_from_vector(axis * (math.asin(tilt) / tilt)) @ R
    oat = [math.degrees(angle) for angle in oat_from_R(R)]
    rounded = [f"{round(angle, 1) + 0.0:g}" for angle in oat]
    return f"sensor.T_flange_sensor.oat_deg: [{', '.join(rounded)}]"


def driver_remedy(wiring: Array, of: str) -> str:
    """Return the remedy in the driver or the adapter as text.

    Args:
        wiring: Signed permutation: axis that each channel shows. Shape (3, 3).
        of: "F" or "M" for three channels, "FM" for all six.
    """
    parts = (
        f"{letter}{axis} = {sign}{letter}{channel}"
        for letter in of
        for axis, sign, channel in _wrong_rows(wiring.T)
    )
    return f"in the driver or the adapter: remap {', '.join(parts)}"
