"""Synthetic recordings of a known payload, in memory and as files."""

import csv
from pathlib import Path

import numpy as np
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

from bench.payload import LEVEL, attitudes, read
from common.config.payload import Payload
from common.motion.frames import Array, quaternion_from_R
from identification.recording import COLUMNS, Samples, WrenchAxes, WrenchRecording

TRUTH = LEVEL
QUICK = settings(
    max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
seeds = st.integers(0, 2**32 - 1)


def readings(payload: Payload, R: Array, rng: np.random.Generator | None = None) -> Samples:
    """Return readings without times, with noise when there is a generator for it."""
    found = read(payload, R, np.zeros(len(R)), rng)
    return Samples(R, found.force_N, found.torque_Nm)


def drawn(
    seed: int = 0, payload: Payload = TRUTH, poses: int = 10, start_s: float = 0.0
) -> Samples:
    """Return noisy readings in random attitudes, ten seconds apart."""
    rng = np.random.default_rng(seed)
    return read(payload, attitudes(rng, poses), start_s + 10.0 * np.arange(float(poses)), rng)


def as_recording(samples: Samples, wrench_axes: WrenchAxes) -> WrenchRecording:
    """Return a recording of the samples with its wrench in the given axes."""
    n = len(samples)
    turn = samples.R_base_sensor if wrench_axes == "base" else np.eye(3)[None]
    return WrenchRecording(
        source="made.csv",
        line=tuple(range(2, n + 2)),
        time_s=np.arange(n, dtype=float),
        position_m=np.zeros((n, 3)),
        R_base_sensor=samples.R_base_sensor,
        force_N=np.einsum("nij,nj->ni", turn, samples.force_N),
        torque_Nm=np.einsum("nij,nj->ni", turn, samples.torque_Nm),
    )


def write_recording(path: Path, samples: Samples, wrench_axes: WrenchAxes = "sensor") -> Path:
    """Write samples as a recording with its wrench in the given axes; return its path."""
    recording = as_recording(samples, wrench_axes)
    time_s = recording.time_s if samples.time_s is None else samples.time_s
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(COLUMNS)
        for k in range(len(samples)):
            wrench = (*recording.force_N[k].tolist(), *recording.torque_Nm[k].tolist())
            pose = (0.5, 0.0, 0.6, *quaternion_from_R(samples.R_base_sensor[k]))
            writer.writerow([float(time_s[k]), *pose, *wrench])
    return path
