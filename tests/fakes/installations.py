"""Static readings of a sensor in a given installation, and the fixes of the findings."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from bench.payload import CellErrors, attitudes, read, truth
from common.config.payload import Payload
from common.motion.frames import Array, Oat, R_from_oat
from identification.installation.terms import ExpectedInstallation, InstallationFinding
from identification.recording import Samples, WrenchAxes
from identification.static_poses import carries_a_fit, sort_into_poses
from tests.fakes.weights import write_recording

EYE = np.eye(3)
PAYLOAD = Payload(
    mass_kg=1.0,
    com_m=(0.012, -0.008, 0.055),
    bias_force_N=(1.5, -2.0, 3.0),
    bias_torque_Nm=(0.05, -0.04, 0.03),
)
TRUTH = PAYLOAD.model_copy(update={"com_m": (0.012, -0.008, 0.06)})  # as in cells/demo.yaml
OAT_DEG = (30.0, 0.0, 0.0)
ERRORS = CellErrors(tilt_deg=1.5, mounting_deg=2.0, gain=1.0, drift=1.0)


def oat_matrix(oat_deg: tuple[float, ...]) -> Array:
    """Return the rotation matrix of O, A, T in a cell file."""
    return R_from_oat(Oat(*np.radians(oat_deg).tolist()))


def belief(
    payload: Payload = PAYLOAD, oat_deg: tuple[float, float, float] = OAT_DEG
) -> ExpectedInstallation:
    """Return a cell file with the true installation; the tool is along z of sensor and flange."""
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
    poses: int = 8,  # with six poses, one draw in a thousand does not distinguish the axes
    force: Array = EYE,
    torque: Array = EYE,
    world: CellErrors | None = None,
    seed: int = 0,
) -> Samples:
    """Return noisy static readings whose channels show `force` and `torque` of the load."""
    rng = np.random.default_rng(seed)
    if world is not None:
        own = payload.model_dump(include={"mass_kg", "com_m", "bias_force_N", "bias_torque_Nm"})
        payload = truth(world, rng).model_copy(update=own)
    while True:
        time_s = np.linspace(0.0, 300.0, poses)
        samples = read(payload, attitudes(rng, poses), time_s, rng)
        if carries_a_fit(sort_into_poses(samples)):
            break
    bias_N, bias_Nm = np.array(payload.bias_force_N), np.array(payload.bias_torque_Nm)
    return replace(
        samples,
        force_N=(samples.force_N - bias_N) @ force.T + bias_N,
        torque_Nm=(samples.torque_Nm - bias_Nm) @ torque.T + bias_Nm,
    )


def apply_remedy(
    finding: InstallationFinding, samples: Samples, of: ExpectedInstallation
) -> tuple[Samples, ExpectedInstallation]:
    """Apply the remedy of a finding of axes, word by word, to an arm that stands upright."""
    oat = re.search(r"T_flange_sensor\.oat_deg: \[(.*?)\]", finding.remedy)
    if finding.code == "reaction":
        return replace(samples, force_N=-samples.force_N, torque_Nm=-samples.torque_Nm), of
    if oat:
        x, y, z = (float(angle) for angle in oat[1].split(","))
        R = oat_matrix((x, y, z))
        assert of.R_flange_sensor is not None
        turned = samples.R_base_sensor @ of.R_flange_sensor.T @ R
        # Positions are in flange axes, where they stay; the lever is in those of the sensor.
        com = None if of.com_m is None else R.T @ of.R_flange_sensor @ of.com_m
        corrected = replace(of, R_flange_sensor=R, oat_deg=(x, y, z), com_m=com)
        return replace(samples, R_base_sensor=turned), corrected
    channels = {"F": samples.force_N, "M": samples.torque_Nm}
    after = {name: values.copy() for name, values in channels.items()}
    orders = re.findall(r"([FM])([xyz]) = (-?)[FM]([xyz])", finding.remedy.split(";")[0])
    orders += re.findall(r"(M)([xyz]) = (-?)M([xyz])", finding.remedy.partition("; in")[2])
    assert orders, finding
    for name, axis, sign, source in orders:
        value = channels[name][:, "xyz".index(source)]
        after[name][:, "xyz".index(axis)] = -value if sign else value
    return replace(samples, force_N=after["F"], torque_Nm=after["M"]), of


def recorded(path: Path, wiring: Array = EYE, wrench_axes: WrenchAxes = "sensor") -> Path:
    """Write readings of the demo's tool and a wired sensor as a recording; return its path."""
    return write_recording(path, readings(TRUTH, force=wiring, torque=wiring), wrench_axes)
