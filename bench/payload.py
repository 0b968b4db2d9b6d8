"""Comparison of the payload identification with published methods: `make bench-payload`.

`python -m bench.payload RECORDING.csv` adds leave-one-out on that recording; `--quick` uses a
tenth of the seeds.
"""

import argparse
import timeit
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
from rich.console import Console
from rich.table import Table

from bench.payload_peers import PEERS
from common.config.payload import DOWN, BiasDrift, Payload
from common.motion.convert import vec3
from common.motion.frames import Array, R_from_quaternion, rotation_from_vector
from common.motion.weight import bias_since_end, predict, residual
from forcemesh.errors import DataError
from identification.estimates import payload_of
from identification.identify import identify_payload, identify_recording
from identification.model_selection import fitted_candidates
from identification.payload_model import perpendicular_axes
from identification.recording import Samples, read_recording
from identification.static_poses import carries_a_fit, sort_into_poses
from services.wrench.compensation import Compensation, Wrench

OTHER_POSES = 50
ORIENTATIONS = 200
TRAINING = (6, 10, 20)
NAMES = ("mass", "com", "bias force", "bias torque", "tilt", "mounting")
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
    """Errors of the cell: tilt and mounting [degrees], gain and drift as multiples."""

    tilt_deg: float = 0.0
    mounting_deg: float = 0.0
    gain: float = 0.0
    drift: float = 0.0


WORLDS = {
    "no error": CellErrors(),
    "tilt 1 deg": CellErrors(tilt_deg=1.0),
    "mounting 1 deg": CellErrors(mounting_deg=1.0),
    "gain 3 %": CellErrors(gain=1.0),
    "drift 1 N, 50 mNm": CellErrors(drift=1.0),
    "all of them": CellErrors(1.0, 1.0, 1.0, 1.0),
}


def truth(world: CellErrors, rng: np.random.Generator) -> Payload:
    """Return the payload of one cell: errors of the given size, in random directions."""
    heading = rng.uniform(0.0, 2.0 * np.pi)
    axis = rng.normal(size=3)
    lean = np.radians(world.tilt_deg) * np.array([np.cos(heading), np.sin(heading), 0.0])
    gains = 1.0 + world.gain * GAIN_ERROR * rng.normal(size=(2, 3))
    drifts = world.drift * rng.normal(size=(2, 3)) * np.array([[DRIFT_N], [DRIFT_NM]])
    return Payload(
        mass_kg=LEVEL.mass_kg,
        com_m=LEVEL.com_m,
        bias_force_N=LEVEL.bias_force_N,
        bias_torque_Nm=LEVEL.bias_torque_Nm,
        gravity_direction_in_base=vec3(rotation_from_vector(lean) @ np.array(DOWN)),
        mounting_rotation_rad=vec3(np.radians(world.mounting_deg) * axis / np.linalg.norm(axis)),
        force_gain=vec3(gains[0]),
        torque_gain=vec3(gains[1]),
        drift=BiasDrift(
            start_s=0.0, end_s=DURATION_S, force_N=vec3(drifts[0]), torque_Nm=vec3(drifts[1])
        ),
    )


def attitudes(rng: np.random.Generator, n: int) -> Array:
    """Return n uniformly random rotations. Shape (n, 3, 3)."""
    return np.array([R_from_quaternion(q) for q in rng.normal(size=(n, 4))])


def read(payload: Payload, R: Array, time_s: Array, rng: np.random.Generator | None) -> Samples:
    """Return the mean reading of each dwell, noisy when there is a generator."""
    force, torque = predict(payload, R)
    if payload.drift is not None:
        d_F, d_M = bias_since_end(payload.drift, time_s)
        force, torque = force + d_F, torque + d_M
    if rng is not None:
        few = np.sqrt(SAMPLES_PER_DWELL)
        force = force + NOISE_N / few * rng.normal(size=force.shape)
        torque = torque + NOISE_NM / few * rng.normal(size=torque.shape)
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
        time_s=samples.time_s,
    )
    return np.array([np.linalg.norm(v, axis=1).mean() for v in left])


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
        models[ours.chosen.model.name] += 1
        found["ours"].append(errors(ours.payload, others))
    return {name: np.array(values) for name, values in found.items()}, models


def comparison_table(seeds: int) -> Table:
    """Return the errors of every method in every world, and the ratio of ours to LSM-short."""
    table = Table(
        title=f"mean residual on {OTHER_POSES} other poses, N / mN m, {seeds} recordings each"
    )
    for name in ("error", "poses", *PEERS, "ours", "ours : LSM-short", "worst", "our model"):
        table.add_column(name)
    for label, world in WORLDS.items():
        for poses in TRAINING:
            found, models = compared(world, poses, seeds)
            means = {name: values.mean(axis=0) for name, values in found.items()}
            share = means["ours"] / means["LSM-short"]
            worst = (found["ours"] / found["LSM-short"]).max(axis=0)
            model, times = models.most_common(1)[0]
            table.add_row(
                label,
                str(poses),
                *(f"{force:.3f} / {1e3 * torque:.2f}" for force, torque in means.values()),
                f"{share[0]:.3f} / {share[1]:.3f}",
                f"{worst[0]:.2f} / {worst[1]:.2f}",
                f"{model} ({times})",
            )
    return table


def accuracy_table(seeds: int) -> Table:
    """Return the error over random orientations after ten poses, and the deviations' coverage.

    The reference is free of noise: the difference is the payload's error alone.
    """
    table = Table(
        title=f"after 10 poses of {SAMPLES_PER_DWELL} samples (0.1 N, 5 mN m each), {seeds} seeds"
    )
    for name in ("cell", "mean N", "95 %", "mean mN m", "95 %", "within 2 sigma", *NAMES):
        table.add_column(name)
    for label, world in (
        ("no error", CellErrors()),
        ("tilt, mounting 1 deg", CellErrors(1.0, 1.0)),
    ):
        found = [trial(world, seed) for seed in range(seeds)]
        left = np.array([error for error, _ in found])
        inside = {n: np.concatenate([z[n] for _, z in found if n in z]) for n in found[0][1]}
        pooled = float(np.mean(np.abs(np.concatenate(list(inside.values()))) < 2.0))
        high = np.percentile(left, 95.0, axis=0)
        table.add_row(
            label,
            f"{left[:, 0].mean():.4f}",
            f"{high[0]:.4f}",
            f"{1e3 * left[:, 1].mean():.3f}",
            f"{1e3 * high[1]:.3f}",
            f"{100 * pooled:.1f} %",
            *(shares(inside[n].reshape(seeds, -1)) if n in inside else "" for n in NAMES),
        )
    return table


def shares(z: Array) -> str:
    """Return the percentage of errors within two standard deviations, for each parameter."""
    return " ".join(f"{100 * share:.1f}" for share in (np.abs(z) < 2.0).mean(axis=0))


def trial(world: CellErrors, seed: int, poses: int = 10) -> tuple[Array, dict[str, Array]]:
    """Return the error over random orientations, and each parameter's error over its deviation.

    A tilt or a mounting that was not identified counts as an infinite error.
    """
    rng = np.random.default_rng([77, seed])
    real = truth(world, rng)
    train, _ = recording(real, poses, 0, rng)
    found = identify_payload(train)
    R = attitudes(rng, ORIENTATIONS)
    now = np.full(ORIENTATIONS, real.drift.end_s if real.drift else 0.0)
    left = errors(found.payload, read(real, R, now, None))
    z = {}
    for name, key in (
        ("mass", "mass_kg"),
        ("com", "com_m"),
        ("bias force", "bias_force_N"),
        ("bias torque", "bias_torque_Nm"),
    ):
        off = np.subtract(getattr(found.payload, key), getattr(real, key))
        z[name] = np.atleast_1d(off / np.array(getattr(found.std, key)))
    solution = found.chosen.solution
    std, places = np.sqrt(np.diag(solution.covariance)), solution.model.places
    if world.tilt_deg:
        down = np.array(found.payload.gravity_direction_in_base)
        off = perpendicular_axes(down).T @ np.cross(down, real.gravity_direction_in_base)
        z["tilt"] = off / std[places["tilt"]] if "tilt" in places else np.full(2, np.inf)
    if world.mounting_deg:
        off = np.subtract(real.mounting_rotation_rad, found.payload.mounting_rotation_rad)
        is_identified = "mounting" in places
        z["mounting"] = off / std[places["mounting"]] if is_identified else np.full(3, np.inf)
    return left, z


def leave_one_out_table(path: Path | None) -> Table:
    """Return the residual of each pose when a method is fitted to the others."""
    if path is None:
        rng = np.random.default_rng(7)
        title, samples = (
            "simulated: all errors, 8 poses",
            recording(truth(WORLDS["all of them"], rng), 8, 0, rng)[0],
        )
    else:
        data = read_recording(path)
        axes = identify_recording(data, None).axes
        title, samples = f"{path.name}, wrench in {axes} axes", data.samples(axes)
    poses = sort_into_poses(samples)
    table = Table(title=f"leave one pose out: {title}")
    for name in ("method", "mean N", "rms N", "mean mN m", "rms mN m", "poses"):
        table.add_column(name)
    for name in (*PEERS, "ours"):
        left = []
        for pose in range(len(poses)):
            kept = np.setdiff1d(np.arange(len(poses)), [pose])
            try:
                payload = _fit(name, poses.means[kept], poses.weight[kept])
            except DataError:
                continue
            left.append(errors(payload, poses.means[np.array([pose])]))
        e = np.array(left)
        rms = np.sqrt((e**2).mean(axis=0))
        numbers = (e[:, 0].mean(), rms[0], 1e3 * e[:, 1].mean(), 1e3 * rms[1])
        table.add_row(name, *(f"{v:.3f}" for v in numbers), str(len(e)))
    return table


def _fit(name: str, samples: Samples, weight: Array) -> Payload:
    if name in PEERS:
        return PEERS[name](samples)
    poses = sort_into_poses(samples)
    poses = type(poses)(poses.means, weight, poses.first_row)
    chosen, _ = fitted_candidates(poses)
    return payload_of(chosen.solution, poses.means.time_s)


def with_cross(reading: Wrench, R: Array, p: Array, payload: Payload) -> tuple[Array, Array]:
    """Return the same wrench by numpy's cross product, for comparison of the cost."""
    R_true = R @ rotation_from_vector(np.array(payload.mounting_rotation_rad))
    reading_N, reading_Nm = np.array(reading.force_N), np.array(reading.torque_Nm)
    force, torque = residual(payload, R, force_N=reading_N, torque_Nm=reading_Nm)
    force, torque = R_true @ force, R_true @ torque
    return force, torque - np.cross(R @ p, force)


def cost_table() -> Table:
    """Return the processor time of one sample, the best of many rounds."""
    payload = truth(WORLDS["all of them"], np.random.default_rng(1))
    reading = Wrench((1.0, 2.0, 3.0), (0.1, 0.2, 0.3))
    R, p = rotation_from_vector(np.array([0.3, -0.2, 0.9])), np.array([0.01, 0.0, 0.14])
    T_base_flange = pin.SE3(R, np.zeros(3))
    compensation = Compensation(payload, pin.SE3.Identity(), pin.SE3(np.eye(3), p))
    table = Table("compensation of one sample", "microseconds", title="cost, the best of 30 rounds")

    def ours() -> object:
        return compensation.at_tcp(reading, T_base_flange)

    def crossed() -> object:
        return with_cross(reading, R, p, payload)

    for name, compensate_wrench in (("Compensation.at_tcp", ours), ("with np.cross", crossed)):
        best = min(timeit.repeat(compensate_wrench, number=500, repeat=30)) / 500
        table.add_row(name, f"{1e6 * best:.1f}")
    return table


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(prog="python -m bench.payload", description=__doc__)
    parser.add_argument("recording", nargs="?", type=Path, help="CSV for leave-one-out")
    parser.add_argument("--quick", action="store_true", help="a tenth of the seeds")
    options = parser.parse_args()
    part = 10 if options.quick else 1
    screen = Console(width=200)
    screen.print(cost_table())
    screen.print(leave_one_out_table(options.recording))
    screen.print(comparison_table(20 // (4 if options.quick else 1)))
    screen.print(accuracy_table(500 // part))


if __name__ == "__main__":
    main()
