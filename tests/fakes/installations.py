"""Static readings of a sensor in a given installation, and the fixes of the findings."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from bench.payload import CellErrors, attitudes, read, truth
from common.config.payload import Payload
from common.motion.frames import Array, Oat, R_from_oat
from identification.installation.terms import ExpectedInstallation
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
    drift = world.drift if world else 0.0
    while True:
        time_s = np.linspace(0.0, 300.0, poses)
        samples = read(payload, attitudes(rng, poses), time_s, rng, drift=drift)
        if carries_a_fit(sort_into_poses(samples)):
            break
    bias_N, bias_Nm = np.array(payload.bias_force_N), np.array(payload.bias_torque_Nm)
    return replace(
        samples,
        force_N=(samples.force_N - bias_N) @ force.T + bias_N,
        torque_Nm=(samples.torque_Nm - bias_Nm) @ torque.T + bias_Nm,
    )


def recorded(path: Path, wiring: Array = EYE, wrench_axes: WrenchAxes = "sensor") -> Path:
    """Write readings of the demo's tool and a wired sensor as a recording; return its path."""
    return write_recording(path, readings(TRUTH, force=wiring, torque=wiring), wrench_axes)
