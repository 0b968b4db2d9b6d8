"""CSV files of synthetic recordings of a known payload."""

import numpy as np

from common.motion.frames import quaternion_from_R, rotation_from_vector
from common.motion.weight import bias_since_end, predict
from identification.recording import COLUMNS
from tests.fakes.weights import TRUTH

EYE = np.eye(3)


def write_recording(
    path, *, axes="sensor", poses=10, seed=0, payload=TRUTH, spread=3.0, start_s=0.0, wired=EYE
):
    """Write a noisy recording of random attitudes and return its path."""
    rng = np.random.default_rng(seed)
    lines = [",".join(COLUMNS)]
    for i in range(poses):
        R = rotation_from_vector(rng.uniform(-spread, spread, 3))
        force, torque = predict(payload, R)
        force = force + 0.01 * rng.normal(size=3)
        torque = torque + 0.0005 * rng.normal(size=3)
        time_s = start_s + 10.0 * i
        if payload.drift is not None:
            change = bias_since_end(payload.drift, np.array([time_s]))
            force, torque = force + change[0][0], torque + change[1][0]
        turn = R if axes == "base" else EYE
        measured = [*(turn @ wired @ force), *(turn @ wired @ torque)]
        row = [time_s, 0.5, 0.0, 0.6, *quaternion_from_R(R), *measured]
        lines.append(",".join(repr(float(v)) for v in row))
    path.write_text("\n".join(lines) + "\n")
    return path
