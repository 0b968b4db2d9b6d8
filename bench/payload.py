"""Payload identification beside the published methods, on simulated recordings.

`--file RECORDING.csv` adds each method's error on every pose of that recording when it is fitted to
the others.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np

from bench.harness import CaseTable, Options, Tables, grouped, largest
from bench.results import Row
from common.config.payload import DOWN, Payload
from common.motion.convert import vec3
from common.motion.frames import (
    GRAVITY_M_S2,
    Array,
    R_from_quaternion,
    rotation_from_vector,
    vector_from_rotation,
)
from common.motion.weight import predict, residual
from identification.identify import identify_payload, identify_recording, payload_of
from identification.model_selection import chosen_candidate, fitted_candidates
from identification.payload_fit import perpendicular_axes
from identification.recording import Poses, Samples, read_recording
from identification.static_poses import carries_a_fit, sort_into_poses


def plain_fit(
    samples: Samples, down_in_base: Array | None = None, R_mount: Array | None = None
) -> Payload:
    """Return the short published method: mass, centre of mass and bias by least squares.

    One stacked system of the same unknowns, as in KTH's force_torque_tools, has the same solution:
    force and torque share no unknown. Its gravity comes from an accelerometer on the sensor, here
    from the pose.
    """
    down = np.array(DOWN) if down_in_base is None else down_in_base
    R_mount = np.eye(3) if R_mount is None else R_mount
    g_s = np.swapaxes(samples.R_base_sensor @ R_mount, 1, 2) @ (GRAVITY_M_S2 * down)
    mass, *bias_N = _with_bias(g_s[:, :, None], samples.force_N)
    moment, bias_Nm = np.split(
        _with_bias(np.cross(g_s[:, None, :], np.eye(3)), samples.torque_Nm), 2
    )
    return Payload(
        mass_kg=max(float(mass), 1e-6),
        com_m=vec3(moment / max(float(mass), 1e-6)),
        bias_force_N=vec3(np.array(bias_N)),
        bias_torque_Nm=vec3(bias_Nm),
        gravity_direction_in_base=vec3(down),
        mounting_rotation_rad=vec3(vector_from_rotation(R_mount)),
    )


def fit_with_tilt(samples: Samples) -> Payload:
    """Return the fit with the weight as a free vector in base."""
    R_sensor_base = np.swapaxes(samples.R_base_sensor, 1, 2)
    weight = _with_bias(R_sensor_base, samples.force_N)[:3]
    return plain_fit(samples, weight / np.linalg.norm(weight))


def fit_with_mounting(samples: Samples) -> Payload:
    """Return the fit with the rotation nearest to a free matrix of mass and mounting."""
    g_s = np.swapaxes(samples.R_base_sensor, 1, 2) @ (GRAVITY_M_S2 * np.array(DOWN))
    columns = np.einsum("ij,nk->nijk", np.eye(3), g_s).reshape(len(g_s), 3, 9)
    U, _, Vt = np.linalg.svd(_with_bias(columns, samples.force_N)[:9].reshape(3, 3))
    R_mount = (U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt).T
    return plain_fit(samples, R_mount=R_mount)


PEERS: dict[str, Callable[[Samples], Payload]] = {
    "LSM-short": plain_fit,
    "with tilt": fit_with_tilt,
    "with mounting": fit_with_mounting,
    "KTH": plain_fit,
}


def _with_bias(columns: Array, readings: Array) -> Array:
    """Return x and b of readings = columns x + b by least squares. columns: (n, 3, k)."""
    n, _, k = columns.shape
    A = np.concatenate([columns, np.broadcast_to(np.eye(3), (n, 3, 3))], axis=2)
    return np.asarray(np.linalg.lstsq(A.reshape(-1, k + 3), readings.ravel(), rcond=None)[0])


NOISE_N, NOISE_NM = 0.1, 0.005  # of one sample
SAMPLES_PER_DWELL = 200  # averaged, as the wizard does
DURATION_S = 600.0
GAIN_ERROR = 0.03
DRIFT_N, DRIFT_NM = 1.0, 0.05  # over the recording, standard deviation of one axis
LEVEL = Payload(
    mass_kg=1.5,
    com_m=(0.02, -0.012, 0.085),
    bias_force_N=(1.0, -2.0, 3.0),
    bias_torque_Nm=(0.1, 0.2, -0.3),
)


@dataclass(frozen=True, slots=True)
class CellErrors:
    """Errors of the cell: tilt and mounting [degrees], gain of force and drift as multiples."""

    tilt_deg: float = 0.0
    mounting_deg: float = 0.0
    gain: float = 0.0
    drift: float = 0.0


WORLDS = {
    "no error": CellErrors(),
    "tilt 1 deg": CellErrors(tilt_deg=1.0),
    "mounting 1 deg": CellErrors(mounting_deg=1.0),
    "gain 3 %": CellErrors(gain=1.0),
    "all of them": CellErrors(1.0, 1.0, 1.0),
}


def truth(world: CellErrors, rng: np.random.Generator) -> Payload:
    """Return the payload of one cell: errors of the given size, in random directions, no drift."""
    heading = rng.uniform(0.0, 2.0 * np.pi)
    axis = rng.normal(size=3)
    lean = np.radians(world.tilt_deg) * np.array([np.cos(heading), np.sin(heading), 0.0])
    gains = 1.0 + world.gain * GAIN_ERROR * rng.normal(size=3)
    mounting = np.radians(world.mounting_deg) * axis / np.linalg.norm(axis)
    errors_of_cell = {
        "gravity_direction_in_base": vec3(rotation_from_vector(lean) @ np.array(DOWN)),
        "mounting_rotation_rad": vec3(mounting),
        "force_gain": vec3(gains),
    }
    return LEVEL.model_copy(update=errors_of_cell)


def attitudes(rng: np.random.Generator, n: int) -> Array:
    """Return n uniformly random rotations. Shape (n, 3, 3)."""
    return np.array([R_from_quaternion(q) for q in rng.normal(size=(n, 4))])


def read(
    payload: Payload,
    R: Array,
    time_s: Array,
    rng: np.random.Generator | None,
    *,
    drift: float = 0.0,
) -> Samples:
    """Return the mean reading of each dwell; with a generator, noisy, and drifting if asked to."""
    force, torque = predict(payload, R)
    if rng is not None:
        few = np.sqrt(SAMPLES_PER_DWELL)
        force = force + NOISE_N / few * rng.normal(size=force.shape)
        torque = torque + NOISE_NM / few * rng.normal(size=torque.shape)
        if drift:
            share = drift * (time_s[:, None] / DURATION_S - 1.0)
            force = force + DRIFT_N * share * rng.normal(size=3)
            torque = torque + DRIFT_NM * share * rng.normal(size=3)
    return Samples(R, force, torque, time_s)


def recording(
    payload: Payload, poses: int, others: int, rng: np.random.Generator
) -> tuple[Samples, Samples]:
    """Return a recording cut at random into training and other poses, both in order of time.

    Random poses that could not carry any fit are drawn again, as a wizard would.
    """
    n = poses + others
    while True:
        time_s = np.sort(rng.uniform(0.0, DURATION_S, n))
        samples = read(payload, attitudes(rng, n), time_s, rng)
        chosen = np.sort(rng.permutation(n)[:poses])
        train = samples[chosen]
        if carries_a_fit(sort_into_poses(train)):
            return train, samples[np.setdiff1d(np.arange(n), chosen)]


def errors(payload: Payload, samples: Samples) -> Array:
    """Return the mean norm of the residual of force [N] and torque [Nm]. Shape (2,)."""
    left = residual(
        payload,
        samples.R_base_sensor,
        force_N=samples.force_N,
        torque_Nm=samples.torque_Nm,
    )
    return np.array([np.linalg.norm(v, axis=1).mean() for v in left])


SEEDS, OTHER_POSES, TRAINING = 20, 50, (6, 10, 20)


def compared(world: CellErrors, poses: int, seeds: int) -> tuple[dict[str, Array], Counter[str]]:
    """Return each method's errors on the other poses, shape (seeds, 2), and our models."""
    found: dict[str, list[Array]] = {name: [] for name in (*PEERS, "ours")}
    models: Counter[str] = Counter()
    for seed in range(seeds):
        rng = np.random.default_rng([poses, seed])
        train, others = recording(truth(world, rng), poses, OTHER_POSES, rng)
        for name, fit in PEERS.items():
            found[name].append(errors(fit(train), others))
        ours = identify_payload(train)
        models[ours.chosen.name] += 1
        found["ours"].append(errors(ours.payload, others))
    return {name: np.array(values) for name, values in found.items()}, models


def compared_row(case: tuple[str, int]) -> Row:
    """Return the mean errors of every method, and the ratios of ours to the short method."""
    label, poses = case
    found, models = compared(WORLDS[label], poses, SEEDS)
    means = {name: values.mean(axis=0) for name, values in found.items()}
    ratio, (model, times) = means["ours"] / means["LSM-short"], models.most_common(1)[0]
    return {
        "error": label,
        "poses": poses,
        **{f"{name}_N": force for name, (force, _) in means.items()},
        **{f"{name}_mN_m": 1e3 * torque for name, (_, torque) in means.items()},
        "force_ratio": ratio[0],
        "torque_ratio": ratio[1],
        "worst_ratio": (found["ours"] / found["LSM-short"]).max(),
        "our_model": f"{model} ({times})",
    }


COMPARED = CaseTable([*product(WORLDS, TRAINING)], compared_row)
RATED = ("LSM-short_N", "ours_N", "LSM-short_mN_m", "ours_mN_m", "force_ratio", "torque_ratio")

TRIALS, ORIENTATIONS, TRIAL_POSES = 500, 200, 10
TRIED = {"no error": CellErrors(), "tilt, mounting 1 deg": CellErrors(1.0, 1.0)}
PARAMETERS = {
    "mass": ("mass_kg", "mass_std_kg"),
    "com": ("com_m", "com_std_m"),
    "bias_force": ("bias_force_N", "bias_force_std_N"),
    "bias_torque": ("bias_torque_Nm", "bias_torque_std_Nm"),
}


def trial(world: CellErrors, seed: int) -> tuple[Array, dict[str, Array]]:
    """Return the error over random orientations, and each parameter's error over its deviation.

    The reference is free of noise. A tilt or a mounting that was not identified counts as an
    infinite error.
    """
    rng = np.random.default_rng([77, seed])
    real = truth(world, rng)
    train, _ = recording(real, TRIAL_POSES, 0, rng)
    found = identify_payload(train)
    R = attitudes(rng, ORIENTATIONS)
    left = errors(found.payload, read(real, R, np.zeros(ORIENTATIONS), None))
    z = {}
    for name, (key, std_key) in PARAMETERS.items():
        off = np.subtract(getattr(found.payload, key), getattr(real, key))
        z[name] = np.atleast_1d(off / np.array(found.std[std_key]))
    solution = found.chosen
    down = np.array(found.payload.gravity_direction_in_base)
    tilt = perpendicular_axes(down).T @ np.cross(down, real.gravity_direction_in_base)
    mounting = np.subtract(real.mounting_rotation_rad, found.payload.mounting_rotation_rad)
    for name, off, is_there in (
        ("tilt", tilt, world.tilt_deg), ("mounting", mounting, world.mounting_deg)
    ):  # fmt: skip
        if is_there:
            fitted = name in solution.errors
            z[name] = off / solution.std(name) if fitted else np.full(len(off), np.inf)
    return left, z


def accuracy_row(label: str) -> Row:
    """Return the error after ten poses, and how often the truth is within two deviations."""
    found = [trial(TRIED[label], seed) for seed in range(TRIALS)]
    left = np.array([error for error, _ in found])
    inside = {n: np.array([np.abs(z[n]) < 2.0 for _, z in found]) for n in found[0][1]}
    high = np.percentile(left, 95.0, axis=0)
    return {
        "cell": label,
        "mean_N": left[:, 0].mean(),
        "of_95_pct_N": high[0],
        "mean_mN_m": 1e3 * left[:, 1].mean(),
        "of_95_pct_mN_m": 1e3 * high[1],
        "pooled_pct": 100 * np.concatenate([each.ravel() for each in inside.values()]).mean(),
        **{
            name: " ".join(f"{100 * share:.1f}" for share in each.mean(axis=0))
            for name, each in inside.items()
        },
    }


ACCURACY = CaseTable([*TRIED], accuracy_row)


def left_out(path: Path) -> Iterator[Row]:
    """Yield the residual of each pose of a recording when a method is fitted to the others."""
    data = read_recording(path)
    poses = sort_into_poses(data.samples(identify_recording(data, None).axes))
    for name in (*PEERS, "ours"):
        left = []
        for pose in range(len(poses)):
            others = poses[np.setdiff1d(np.arange(len(poses)), [pose])]
            payload = PEERS[name](others.means) if name in PEERS else _ours(others)
            left.append(errors(payload, poses.means[np.array([pose])]))
        found = np.array(left)
        mean, rms = found.mean(axis=0), np.sqrt((found**2).mean(axis=0))
        in_mN_m = {"mean_mN_m": 1e3 * mean[1], "rms_mN_m": 1e3 * rms[1]}
        yield {"method": name, "mean_N": mean[0], "rms_N": rms[0], **in_mN_m, "poses": len(found)}


def _ours(poses: Poses) -> Payload:
    return payload_of(chosen_candidate(fitted_candidates(poses, np.array(DOWN))))


def measure(options: Options) -> Tables:
    """Return all tables."""
    rows = COMPARED.measured(options)
    worst = ({**place, **largest(ours, RATED)} for place, ours in grouped(rows, "error"))
    tables: dict[str, Iterable[Row]] = {
        "compared": rows,
        "worst": worst,
        "accuracy": ACCURACY.measured(options),
    }
    if options.file is not None:
        tables["left-out"] = left_out(options.file)
    return tables
