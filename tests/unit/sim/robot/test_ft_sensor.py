"""The simulated sensor's faults: they are the ones that were set, and the same for one seed."""

import numpy as np
import pytest

from sim.robot.ft_sensor import FtSensor
from sim.robot.settings import SimSettings

FORCE = np.array([10.0, -20.0, 30.0])
TORQUE = np.array([0.5, -0.25, 1.0])
ON_TOOL = -np.concatenate((FORCE, TORQUE))  # as MuJoCo's sensors read this load
CLEAN = {
    "noise_force_N": 0.0,
    "noise_torque_Nm": 0.0,
    "quantum_force_N": 0.0,
    "quantum_torque_Nm": 0.0,
}


def many(settings: SimSettings, count: int, seed: int = 0) -> np.ndarray:
    """Return readings of the one load, force then torque. Shape (count, 6)."""
    sensor = FtSensor(settings, ON_TOOL, seed=seed)
    samples = [sensor.sample() for _ in range(count)]
    return np.array([np.concatenate((s.force_N, s.torque_Nm)) for s in samples])


def test_noise_has_the_spread_that_was_set():
    """Mean is the biased load, standard deviation the setting, axes independent."""
    settings = SimSettings(bias_force_N=(0, 0, 0), bias_torque_Nm=(0, 0, 0))
    readings = many(settings, 5000)
    assert readings.mean(axis=0)[:3] == pytest.approx(FORCE, abs=0.006)
    assert readings.std(axis=0)[:3] == pytest.approx([0.1] * 3, rel=0.05)
    assert readings.std(axis=0)[3:] == pytest.approx([0.005] * 3, rel=0.05)
    others = np.corrcoef(readings.T) - np.eye(6)
    assert abs(others).max() < 0.06


def test_readings_are_on_the_quantisation_grid():
    """Every reading is a whole number of steps."""
    settings = SimSettings(quantum_force_N=0.25, quantum_torque_Nm=0.01)
    steps = many(settings, 50) / np.array([0.25] * 3 + [0.01] * 3)
    assert steps == pytest.approx(np.round(steps), abs=1e-9)


@pytest.mark.parametrize("axis", range(6))
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_beyond_the_range_a_sample_is_saturated(axis, sign):
    """Any axis at its end clips and is reported; just inside it is an ordinary reading."""
    settings = SimSettings(
        **CLEAN,
        bias_force_N=(0, 0, 0),
        bias_torque_Nm=(0, 0, 0),
        force_range_N=100.0,
        torque_range_Nm=5.0,
    )
    for share, status in ((0.99, "ok"), (1.01, "saturated")):
        load = np.zeros(6)
        load[axis] = sign * share * (100.0 if axis < 3 else 5.0)
        sample = FtSensor(settings, -load, seed=0).sample()
        assert sample.status == status
        assert max(abs(sample.force_N)) <= 100.0
        assert max(abs(sample.torque_Nm)) <= 5.0
