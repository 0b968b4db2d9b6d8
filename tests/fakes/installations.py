"""Static readings of a sensor that is installed in some way, and the fixes that are asked for."""

import csv
import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from bench.payload_worlds import CellErrors, attitudes, read, truth
from common.config.payload import Payload
from common.motion.frames import Array, Oat, R_from_oat, quaternion_from_R
from identification.installation.terms import ExpectedInstallation, InstallationFinding
from identification.recording import COLUMNS, Samples
from identification.static_poses import carries_a_fit, sort_into_poses

EYE = np.eye(3)
PAYLOAD = Payload(1.0, (0.012, -0.008, 0.055), (1.5, -2.0, 3.0), (0.05, -0.04, 0.03))
TRUTH = replace(PAYLOAD, com_m=(0.012, -0.008, 0.06))  # as cells/demo.yaml has it
OAT_DEG = (30.0, 0.0, 0.0)
ERRORS = CellErrors(tilt_deg=1.5, mounting_deg=2.0, gain=1.0, drift=1.0)


def oat_matrix(oat_deg: tuple[float, ...]) -> Array:
    """Return the rotation of angles as a cell file has them."""
    return R_from_oat(Oat(*np.radians(oat_deg).tolist()))


def belief(
    payload: Payload = PAYLOAD, oat_deg: tuple[float, float, float] = OAT_DEG
) -> ExpectedInstallation:
    """Return a cell file that says the truth; the tool is along z of sensor and flange."""
    R = oat_matrix(oat_deg)
    p_sensor = np.array([0.0, 0.0, 0.02])
    return ExpectedInstallation(
        mass_kg=payload.mass_kg,
        com_m=np.array(payload.com_m),
        oat_deg=oat_deg,
        R_flange_sensor=R,
        p_flange_sensor_m=p_sensor,
        p_flange_tcp_m=p_sensor + R @ np.array([0.0, 0.0, 0.14]),
    )


def readings(
    payload: Payload = PAYLOAD,
    *,
    poses: int = 8,  # of six, one drawing in a thousand does not tell one axis from another
    force: Array = EYE,
    torque: Array = EYE,
    world: CellErrors | None = None,
    seed: int = 0,
) -> Samples:
    """Return noisy static readings whose channels show `force` and `torque` of the load."""
    rng = np.random.default_rng(seed)
    if world is not None:
        errors = truth(world, rng)
        payload = replace(
            errors,
            mass_kg=payload.mass_kg,
            com_m=payload.com_m,
            bias_force_N=payload.bias_force_N,
            bias_torque_Nm=payload.bias_torque_Nm,
        )
    while True:
        time_s = np.linspace(0.0, 300.0, poses)
        seen = read(payload, attitudes(rng, poses), time_s, rng)
        if carries_a_fit(sort_into_poses(seen)):
            break
    bias_N, bias_Nm = np.array(payload.bias_force_N), np.array(payload.bias_torque_Nm)
    return replace(
        seen,
        force_N=(seen.force_N - bias_N) @ force.T + bias_N,
        torque_Nm=(seen.torque_Nm - bias_Nm) @ torque.T + bias_Nm,
    )


def mended(
    finding: InstallationFinding, seen: Samples, of: ExpectedInstallation
) -> tuple[Samples, ExpectedInstallation]:
    """Do what a finding of axes says, word by word, on an arm that stands upright."""
    oat = re.search(r"T_flange_sensor\.oat_deg: \[(.*?)\]", finding.remedy)
    if finding.code == "reaction":
        return replace(seen, force_N=-seen.force_N, torque_Nm=-seen.torque_Nm), of
    if oat:
        x, y, z = (float(angle) for angle in oat[1].split(","))
        R = oat_matrix((x, y, z))
        assert of.R_flange_sensor is not None
        turned = seen.R_base_sensor @ of.R_flange_sensor.T @ R
        # Positions are in flange axes, where they stay; the lever is in those of the sensor.
        com = None if of.com_m is None else R.T @ of.R_flange_sensor @ of.com_m
        told = replace(of, R_flange_sensor=R, oat_deg=(x, y, z), com_m=com)
        return replace(seen, R_base_sensor=turned), told
    channels = {"F": seen.force_N, "M": seen.torque_Nm}
    after = {name: values.copy() for name, values in channels.items()}
    orders = re.findall(r"([FM])([xyz]) = (-?)[FM]([xyz])", finding.remedy.split(";")[0])
    orders += re.findall(r"(M)([xyz]) = (-?)M([xyz])", finding.remedy.partition("; in")[2])
    assert orders, finding
    for name, axis, sign, source in orders:
        value = channels[name][:, "xyz".index(source)]
        after[name][:, "xyz".index(axis)] = -value if sign else value
    return replace(seen, force_N=after["F"], torque_Nm=after["M"]), of


def recorded(
    path: Path, wiring: Array = EYE, *, times: float = 1.0, base_axes: bool = False
) -> Path:
    """Write readings of the demo's tool and a wired sensor as a recording; return its path."""
    seen = readings(TRUTH, force=wiring, torque=wiring, poses=8)
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        for k in range(len(seen)):
            R = seen.R_base_sensor[k]
            turn = R if base_axes else EYE
            wrench = (*(times * turn @ seen.force_N[k]), *(turn @ seen.torque_Nm[k]))
            writer.writerow([k, 0.5, 0.0, 0.6, *quaternion_from_R(R), *wrench])
    return path
