"""The simulated sensor's noise, quanta and range are the ones that were set."""

import numpy as np
import pytest

from common.motion.frames import Array
from sim.robot.ft_sensor import FtSensor
from sim.robot.settings import SimSettings

LOAD = np.array([10.0, -20.0, 30.0, 0.5, -0.25, 1.0])
UNBIASED = {"bias_force_N": (0.0,) * 3, "bias_torque_Nm": (0.0,) * 3}
NOISELESS = {"noise_force_N": 0.0, "noise_torque_Nm": 0.0}


def many(settings: SimSettings, count: int) -> Array:
    """Return readings of the one load, force then torque. Shape (count, 6)."""
    sensor = FtSensor(settings, -LOAD, seed=0)  # MuJoCo's sensors read the load on the tool
    samples = [sensor.sample() for _ in range(count)]
    return np.array([np.concatenate((s.force_N, s.torque_Nm)) for s in samples])


def test_noise_and_quanta_are_those_that_were_set() -> None:
    """Mean, deviation, independent axes; a reading is a whole number of quanta."""
    readings = many(SimSettings(**UNBIASED), 5000)
    assert readings.mean(axis=0)[:3] == pytest.approx(LOAD[:3], abs=0.006)
    assert readings.std(axis=0) == pytest.approx([0.1] * 3 + [0.005] * 3, rel=0.05)
    assert abs(np.corrcoef(readings.T) - np.eye(6)).max() < 0.06
    quanta = many(SimSettings(quantum_force_N=0.25, quantum_torque_Nm=0.01), 50)
    quanta /= np.array([0.25] * 3 + [0.01] * 3)
    assert quanta == pytest.approx(np.round(quanta), abs=1e-9)


@pytest.mark.parametrize("axis", range(6))
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_beyond_the_range_a_sample_is_saturated(axis: int, sign: float) -> None:
    """Any axis at its end is clipped and reported; just inside it is an ordinary reading."""
    settings = SimSettings(**UNBIASED, **NOISELESS, force_range_N=100.0, torque_range_Nm=5.0)
    for share, status in ((0.99, "ok"), (1.01, "saturated")):
        load = np.zeros(6)
        load[axis] = sign * share * (100.0 if axis < 3 else 5.0)
        sample = FtSensor(settings, -load, seed=0).sample()
        assert sample.status == status
        assert max(abs(sample.force_N)) <= 100.0
        assert max(abs(sample.torque_Nm)) <= 5.0
