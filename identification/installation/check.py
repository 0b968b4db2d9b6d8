"""Sensor installation check: axes, signs and units against the cell file. Pure.

The weight of the tool is a known force in many directions. Static readings of it identify the axis
and the unit of each channel. Three things cannot be identified from them and are reported as such:
a hanging arm or a sensor that reports the reaction, the common sign of the torques when the side
of the centre of mass is unknown, and torque channels about which the tool has no moment.
"""

import math

from common.motion.frames import GRAVITY_M_S2, Array
from identification.installation.axes import (
    EYE,
    axis_findings,
    mounting_remarks,
    plausible_fits,
    same,
    unidentified,
)
from identification.installation.axis_fit import (
    ForceFit,
    TorqueFits,
    fit_force_drifting,
    fit_torque,
    gravity_turns,
)
from identification.installation.hypotheses import (
    hypothesis_finding,
    similar_poses_finding,
    without_disturbed_poses,
)
from identification.installation.payload import length_findings, lever_finding, mass_finding
from identification.installation.terms import (
    ExpectedInstallation,
    Installation,
    InstallationFinding,
)
from identification.recording import Samples, WrenchAxes, WrenchRecording
from identification.static_poses import Poses, sort_into_poses


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
        poses, omitted = without_disturbed_poses(poses, expected.down_in_base)
        force = fit_force_drifting(poses, expected.down_in_base)
    evidence = _force_evidence(poses, force)
    undetermined = _undetermined_finding(poses, force, expected)
    if undetermined is not None:
        return Installation((*lengths, undetermined), (), evidence)
    mass = mass_finding(force.mass, force.rms_N, expected)
    # The lever is in metres only if it is computed with the true weight.
    is_unit = mass is not None and mass.code == "force_unit" and expected.mass_kg is not None
    true_mass_kg = expected.mass_kg if is_unit and expected.mass_kg is not None else force.mass
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
    evidence |= _torque_evidence(torque)
    remarks = [] if axes else [*unidentified(torque, expected), *mounting_remarks(force)]
    remarks += [f"pose {row + 1}, left out: contact, or motion" for row in omitted]
    return Installation(tuple(found), tuple(remarks), evidence, force.wiring, com_m)


def judge_recording(
    recording: WrenchRecording, axes: WrenchAxes | None, expected: ExpectedInstallation
) -> tuple[WrenchAxes, Installation]:
    """Check a recording with its wrench in the given axes; with None, in those that fit best."""
    both: tuple[WrenchAxes, ...] = ("sensor", "base") if axes is None else (axes,)
    found = {each: judge_installation(recording.samples(each), expected) for each in both}
    best = min(both, key=lambda each: found[each].misfit)
    return best, found[best]


def _undetermined_finding(
    poses: Poses, force: ForceFit, expected: ExpectedInstallation
) -> InstallationFinding | None:
    """Return why the force does not identify the axes, None when it does."""
    if force.explained and force.determined:
        return None
    if force.explained or not gravity_turns(poses, expected.down_in_base):
        return similar_poses_finding(poses, force, expected)
    return hypothesis_finding(poses, force, expected)


def _com(force: ForceFit, torque: TorqueFits, expected: ExpectedInstallation) -> Array | None:
    """Return the centre of mass if the torques show it, in the axes of the cell file."""
    if not torque.shown:
        return None
    fits = plausible_fits(torque, expected) or list(torque.fits)
    cell_axes = (EYE, force.wiring)
    ranked = sorted(fits, key=lambda fit: not any(same(fit.wiring, W) for W in cell_axes))
    return ranked[0].com_m


def _force_evidence(poses: Poses, force: ForceFit) -> dict[str, float]:
    return {
        "poses": float(len(poses)),
        "mass_kg": force.mass,
        "rms_force_N": force.rms_N,
        "rival_rms_force_N": force.rival_rms_N,
        "turned_deg": math.degrees(force.turn_rad),
    }


def _torque_evidence(torque: TorqueFits) -> dict[str, float]:
    return {
        "rms_torque_Nm": torque.fits[0].rms_Nm,
        "spread_torque_Nm": torque.spread_Nm,
        "torque_wirings_left": float(len(torque.fits)),
    }
