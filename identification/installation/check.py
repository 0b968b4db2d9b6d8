"""Sensor installation check: axes, signs and units against the cell file. Pure.

The weight of the tool is a known force in many directions. Static readings of it identify the axis
and the unit of each channel. Three things cannot be identified from them and are reported as such:
a hanging arm or a sensor that reports the reaction, the common sign of the torques when the side
of the centre of mass is unknown, and torque channels about which the tool has no moment.

Readings that no signed axis permutation explains are transformed by one hypothesis after another.
The first one after which they fit a correctly installed sensor is reported.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from common.motion.frames import GRAVITY_M_S2, Array, R_from_quaternion, quaternion_from_R
from identification.installation.axes import (
    axis_findings,
    mounting_remarks,
    plausible_fits,
    same,
    unidentified,
)
from identification.installation.axis_fit import (
    EYE,
    MISFIT_SHARE,
    ForceFit,
    TorqueFits,
    fit_force,
    fit_force_drifting,
    fit_torque,
    free_gain,
    free_gravity,
    gravity_turns,
)
from identification.installation.payload import length_findings, lever_finding, mass_finding
from identification.installation.terms import (
    ExpectedInstallation,
    Installation,
    InstallationFinding,
)
from identification.recording import BOTH_AXES, Poses, Samples, WrenchAxes, WrenchRecording
from identification.static_poses import angle, sort_into_poses

LEAST_POSES_TO_OMIT, MOST_POSES_TO_OMIT = 5, 60  # for which leaving one out is tried
SIMILAR_RAD = math.radians(12.0)  # 180 degrees divided twice by 57.3 is less
HEAVY_KG = 50.0
LIGHT_KG, NO_WEIGHT_SHARE = 0.1, 0.1
UNEQUAL = 1.25
POSES = "turn the wrist by at least 60 degrees about two axes, free of contact"


def judge_installation(samples: Samples, expected: ExpectedInstallation) -> Installation:
    """Check axes, signs, units and payload against the cell file.

    Args:
        samples: Static readings in four attitudes or more, free of contact, in the axes that the
            cell file assigns to the sensor.
        expected: Expected installation, from the cell file.
    """
    poses = sort_into_poses(samples)
    lengths = length_findings(expected)
    expected = expected.in_metres()
    force, omitted = fit_force_drifting(poses, expected.down_in_base), list[int]()
    if not force.explained:
        poses, omitted = _without_disturbed_poses(poses, expected.down_in_base)
        force = fit_force_drifting(poses, expected.down_in_base)
    evidence = _force_evidence(poses, force)
    undetermined = _undetermined_finding(poses, force, expected)
    if undetermined is not None:
        return Installation((*lengths, undetermined), (), evidence)
    mass, true_mass_kg = mass_finding(force.mass, force.rms_N, expected), force.mass
    if mass is not None and mass.code == "force_unit" and expected.mass_kg is not None:
        true_mass_kg = expected.mass_kg  # with the mass as read the lever would not be in metres
    torque = fit_torque(poses, expected.down_in_base, force.rotation, true_mass_kg)
    axes = axis_findings(force, torque, expected)
    com_m = _com(force, torque, expected)
    uncertainty_m = torque.fits[0].rms_Nm / (true_mass_kg * GRAVITY_M_S2)
    lever = None if com_m is None else lever_finding(com_m, uncertainty_m, expected)
    if lever is not None and lever.kind == "payload" and axes:
        lever = None  # in the axes of the cell file, which are not the sensor's
    found = [*lengths, *axes, *(each for each in (mass, lever) if each is not None)]
    if com_m is not None:
        evidence |= {f"com_{axis}_m": float(x) for axis, x in zip("xyz", com_m, strict=True)}
    evidence |= {
        "rms_torque_Nm": torque.fits[0].rms_Nm,
        "spread_torque_Nm": torque.spread_Nm,
        "torque_wirings_left": float(len(torque.fits)),
    }
    open_signs = unidentified(torque, expected)
    remarks = [] if axes else [*open_signs, *mounting_remarks(force)]
    remarks += [f"pose {row + 1}, left out: contact, or motion" for row in omitted]
    return Installation(
        tuple(found), tuple(remarks), evidence, force.wiring, com_m, shows_torques=not open_signs
    )


def judge_recording(
    recording: WrenchRecording, axes: WrenchAxes | None, expected: ExpectedInstallation
) -> tuple[WrenchAxes, Installation]:
    """Check a recording with its wrench in the given axes; with None, in those that fit best."""
    tried = BOTH_AXES if axes is None else (axes,)
    found = {each: judge_installation(recording.samples(each), expected) for each in tried}
    best = min(tried, key=lambda each: found[each].evidence["rms_force_N"])
    return best, found[best]


def _undetermined_finding(
    poses: Poses, force: ForceFit, expected: ExpectedInstallation
) -> InstallationFinding | None:
    """Return why the force does not identify the axes, None when it does."""
    if force.explained and force.determined:
        return None
    if force.explained or not gravity_turns(poses, expected.down_in_base):
        return _similar_poses_finding(poses, force, expected)
    return _hypothesis_finding(poses, force, expected)


def _com(force: ForceFit, torque: TorqueFits, expected: ExpectedInstallation) -> Array | None:
    """Return the centre of mass if the torques show it, in the axes of the cell file."""
    if not torque.shown:
        return None
    fits = plausible_fits(torque, expected) or torque.fits
    cell_axes = (EYE, force.wiring)
    return min(fits, key=lambda fit: not any(same(fit.wiring, W) for W in cell_axes)).com_m


def _force_evidence(poses: Poses, force: ForceFit) -> dict[str, float]:
    return {
        "poses": float(len(poses)),
        "mass_kg": force.mass,
        "rms_force_N": force.rms_N,
        "rival_rms_force_N": force.rival_rms_N,
        "turned_deg": math.degrees(force.turn_rad),
    }


# --- hypotheses -----------------------------------------------------------------------------------


def _with_attitudes(samples: Samples, of: Callable[[Array], Array]) -> Samples:
    return replace(samples, R_base_sensor=np.array([of(R) for R in samples.R_base_sensor]))


def _attitude_w_first(R: Array) -> Array:
    """Return the attitude of a quaternion w x y z that was read as x y z w."""
    x, y, z, w = quaternion_from_R(R)
    return R_from_quaternion((y, z, w, x))


HYPOTHESES: tuple[tuple[str, str, Callable[[Samples], Samples]], ...] = (
    (
        "each attitude is that of the base in the sensor, not of the sensor in the base",
        "transpose the matrices, or conjugate the quaternions",
        lambda samples: _with_attitudes(samples, lambda R: R.T),
    ),
    (
        "the quaternions are in the order w x y z",
        "write them in the order x y z w",
        lambda samples: _with_attitudes(samples, _attitude_w_first),
    ),
    (
        "the readings are in base axes, not in sensor axes",
        "let the driver publish them in the axes of the sensor, or use --wrench-axes base",
        Samples.from_base_axes,
    ),
    (
        "forces and torques are exchanged",
        "exchange the first and the last three of the six numbers in the driver",
        lambda samples: replace(samples, force_N=samples.torque_Nm, torque_Nm=samples.force_N),
    ),
)


def _is_correctly_installed(force: ForceFit) -> bool:
    """Return whether a fit is certainly that of a correctly installed sensor."""
    straight = same(force.wiring, EYE) and not force.turned
    return force.explained and force.determined and straight


def _hypothesis_finding(
    poses: Poses, force: ForceFit, expected: ExpectedInstallation
) -> InstallationFinding:
    """Return the first hypothesis that explains readings that no axis permutation explains."""
    down = expected.down_in_base
    for text, remedy, transform in HYPOTHESES:
        if _is_correctly_installed(fit_force(replace(poses, means=transform(poses.means)), down)):
            return InstallationFinding("attitude", text, remedy)
    return (
        _no_weight_finding(force, expected)
        or _gravity_finding(poses)
        or _gain_finding(poses, down)
        or InstallationFinding(
            "attitude",
            "no mounting and no axis map explains the readings as a weight: the attitudes do not "
            "match (degrees taken for radians, another order of the angles, another robot), "
            "the tool was in contact, or the tool is too light for the sensor's drift",
            f"compare the recorded attitudes with the pendant's, then record again: {POSES}",
        )
    )


def _similar_poses_finding(
    poses: Poses, force: ForceFit, expected: ExpectedInstallation
) -> InstallationFinding:
    """Return the finding for too similar attitudes, whose unit may be wrong."""
    R = poses.means.R_base_sensor
    widest = max(float(angle(attitude, R).max()) for attitude in R)
    per_turn_kg = force.spread_N / (GRAVITY_M_S2 * max(widest, 1e-6) / 2.0)
    most_kg = HEAVY_KG if expected.mass_kg is None else 5.0 * expected.mass_kg
    if widest < SIMILAR_RAD and per_turn_kg > most_kg:
        text = (
            f"the attitudes differ by only {math.degrees(widest):.2g} degrees, but the force "
            f"as if {per_turn_kg:.3g} kg had been turned by that: radians are taken for degrees"
        )
        remedy = "multiply the angles of the attitudes by 57.2958"
        return InstallationFinding("attitude", text, remedy)
    text = f"{len(poses)} poses this similar do not identify the axes"
    return InstallationFinding("poses", text, POSES, "unsure")


def _no_weight_finding(
    force: ForceFit, expected: ExpectedInstallation
) -> InstallationFinding | None:
    """Return the finding for forces that do not change with the attitude."""
    expected_kg = LIGHT_KG if expected.mass_kg is None else expected.mass_kg
    if force.spread_N > NO_WEIGHT_SHARE * GRAVITY_M_S2 * expected_kg:
        return None
    text = f"the forces hardly change with the attitude ({force.spread_N:.2g} N): no weight is read"
    remedy = "check that the sensor is live, its unit, and that the tool is mounted on it"
    return InstallationFinding("no_weight", text, remedy)


def _without_disturbed_poses(poses: Poses, down_in_base: Array) -> tuple[Poses, list[int]]:
    """Leave out the few poses that spoil the fit: in contact, or read in motion.

    Returns the rest and the indices of those left out; all poses when that does not help.
    """
    rows, out = np.arange(len(poses)), list[int]()
    while LEAST_POSES_TO_OMIT < len(rows) <= MOST_POSES_TO_OMIT and len(out) < len(poses) // 4:
        fits = [fit_force(poses[np.delete(rows, k)], down_in_base) for k in range(len(rows))]
        worst = min(range(len(rows)), key=lambda k: fits[k].rms_N)
        out.append(int(rows[worst]))
        rows = np.delete(rows, worst)
        if fits[worst].explained and fits[worst].determined:
            return poses[rows], sorted(out)
    return poses, []


def _gravity_finding(poses: Poses) -> InstallationFinding | None:
    """Return the finding for correct axes on an arm mounted on a wall or a slope."""
    direction, residual_N = free_gravity(poses)
    force = fit_force(poses, direction)
    if not (_is_correctly_installed(force) and residual_N <= MISFIT_SHARE * force.weight_N):
        return None
    direction_text = ", ".join(f"{x + 0.0:.3f}" for x in direction.round(3))
    text = (
        f"gravity points along ({direction_text}) in the base: the arm is not mounted as the cell "
        "file says"
    )
    remedy = f"write gravity_direction_in_base: [{direction_text}]"
    return InstallationFinding("gravity", text, remedy)


def _gain_finding(poses: Poses, down_in_base: Array) -> InstallationFinding | None:
    """Return the finding for axes of unequal gain, dead ones included."""
    A, residual_N = free_gain(poses, down_in_base)
    gains = np.linalg.norm(A, axis=1)
    largest = float(gains.max())
    weight_N = GRAVITY_M_S2 * largest
    if len(poses) < LEAST_POSES_TO_OMIT or weight_N <= 0.0 or residual_N > MISFIT_SHARE * weight_N:
        return None
    if largest < UNEQUAL * gains.min():
        return None
    shares = dict(zip(("Fx", "Fy", "Fz"), gains / largest, strict=True))
    listed = ", ".join(f"{channel} {share:.2f}" for channel, share in shares.items())
    text = f"the axes read the same weight with unequal gain ({listed} of the largest)"
    remedy = "check the calibration matrix and the counts per newton of each axis"
    if silent := [channel for channel, share in shares.items() if share < 0.1]:
        remedy = f"{' and '.join(silent)} without signal: check the cable"
    return InstallationFinding("gain", text, remedy)
