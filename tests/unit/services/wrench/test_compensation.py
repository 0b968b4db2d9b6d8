"""From the sensor's reading to the wrench of the environment: compensation and filter."""

import math

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from common.config.payload import Payload
from common.motion.convert import vec3
from common.motion.frames import GRAVITY_M_S2, rotation_from_vector
from services.wrench.compensation import Compensation, Filter, Wrench
from tests.fakes.bench import CELL

vectors = hnp.arrays(float, 3, elements=st.floats(-50.0, 50.0))
levers = hnp.arrays(float, 3, elements=st.floats(-0.3, 0.3))
turns = hnp.arrays(float, 3, elements=st.floats(-1.8, 1.8))
samples = hnp.arrays(float, 6, elements=st.floats(-100.0, 100.0))
triples = st.tuples(*[st.floats(-0.3, 0.3)] * 3)
small_turns = st.tuples(*[st.floats(-0.1, 0.1)] * 3)
biases = st.tuples(*[st.floats(-20.0, 20.0)] * 3)
gains = st.tuples(*[st.floats(0.9, 1.1)] * 3)
payloads = st.builds(
    Payload,
    mass_kg=st.floats(0.0, 7.0),
    com_m=triples,
    bias_force_N=biases,
    bias_torque_Nm=biases,
    force_gain=gains,
    mounting_rotation_rad=small_turns,
    gravity_direction_in_base=st.sampled_from([(0.0, 0.0, -1.0), (1.0, 0.0, 0.0), (0.0, 0.6, 0.8)]),
)


@given(payloads, turns, levers, vectors, vectors, vectors)
def test_the_wrench_of_the_environment_remains(payload, turn, p, force_N, torque_Nm, a_m_s2):
    """Of a free body diagram in base axes: in base axes, about the TCP, positive pushes the robot.

    The weight, less the load of the acceleration, acts at the centre of mass, the environment at
    the TCP; both about the sensor. The mounting correction turns axes only.
    """
    R = rotation_from_vector(turn)
    R_true = R @ rotation_from_vector(np.array(payload.mounting_rotation_rad))
    g_m_s2 = GRAVITY_M_S2 * np.array(payload.gravity_direction_in_base)
    weight_N = payload.mass_kg * (g_m_s2 - a_m_s2)
    total_N = weight_N + force_N
    total_Nm = np.cross(R_true @ payload.com_m, weight_N) + torque_Nm + np.cross(R @ p, force_N)
    reading = Wrench(
        vec3(payload.force_gain * (R_true.T @ total_N) + payload.bias_force_N),
        vec3(R_true.T @ total_Nm + payload.bias_torque_Nm),
    )
    compensation = Compensation(payload, pin.SE3.Identity(), pin.SE3(np.eye(3), p))
    T_base_flange = pin.SE3(R, np.array([0.2, -0.4, 0.6]))  # the position is irrelevant
    found = compensation.at_tcp(reading, T_base_flange, vec3(a_m_s2))
    assert found.force_N == pytest.approx(force_N, abs=1e-8)
    assert found.torque_Nm == pytest.approx(torque_Nm, abs=1e-8)


def test_the_lever_is_that_of_the_cell_file() -> None:
    """It is from the sensor's origin to the TCP, in sensor axes that are turned by 30 degrees."""
    cos30, sin30 = math.cos(math.radians(30.0)), 0.5
    below = CELL.tool.T_flange_tcp
    aside = below.model_copy(update={"position_m": (0.1, 0.0, 0.16)})
    nothing = Payload(mass_kg=0.0, com_m=(0.0, 0.0, 0.0))
    T_flange_sensor = CELL.sensor.T_flange_sensor.pose
    R = T_flange_sensor.rotation
    for T_flange_tcp, lever in (
        (below.pose, [0.0, 0.0, 0.14]),
        (aside.pose, [0.1 * cos30, -0.1 * sin30, 0.14]),
    ):
        compensation = Compensation(nothing, T_flange_sensor, T_flange_tcp)
        for force_N in np.eye(3):
            reading = Wrench(vec3(force_N), (0.0, 0.0, 0.0))
            found = compensation.at_tcp(reading, pin.SE3.Identity())
            assert found.torque_Nm == pytest.approx(-R @ np.cross(lever, force_N))


# --- filter ---------------------------------------------------------------------------------------


def run(state: Filter, stream, dt_s: float = 0.002) -> list[np.ndarray]:
    """Feed samples; return the output after each."""
    outputs = []
    for sample in stream:
        state.feed(tuple(np.asarray(sample).tolist()), dt_s)
        assert state.output is not None
        outputs.append(np.array(state.output))
    return outputs


medians = st.sampled_from([1, 3, 5])
lowpasses = st.sampled_from([0.0, 0.001, 0.005, 1.0])


@given(samples, samples, st.sampled_from([3, 5]), lowpasses, st.integers(2, 9))
def test_a_single_spike_leaves_no_trace(sample, spike, median, lowpass_s, at) -> None:
    """One spike among equal samples, from the third on; the first sample is the first output."""
    stream = [sample] * 12
    stream[at] = spike
    for output in run(Filter(median, lowpass_s), stream):
        assert output == pytest.approx(sample, abs=1e-12)


def test_a_median_of_five_removes_two_spikes_at_once() -> None:
    """The spikes may be on either side of the window's middle."""
    for spikes in (([100.0] * 6, [90.0] * 6), ([-100.0] * 6, [-90.0] * 6)):
        stream = [np.zeros(6)] * 5 + [np.array(spike) for spike in spikes] + [np.zeros(6)] * 5
        assert not np.any(run(Filter(5, 0.0), stream))


@given(st.lists(samples, min_size=1, max_size=12), medians, lowpasses, st.floats(0.0, 0.1))
def test_the_output_never_leaves_the_range_of_the_input(stream, median, lowpass_s, dt_s) -> None:
    """Channel by channel there is no overshoot and no mixing."""
    outputs = np.array(run(Filter(median, lowpass_s), stream, dt_s))
    assert (outputs >= np.min(stream, axis=0) - 1e-9).all()
    assert (outputs <= np.max(stream, axis=0) + 1e-9).all()


@given(st.sampled_from([0.0005, 0.002, 0.004]))
def test_the_step_response_is_in_seconds_and_not_in_samples(dt_s) -> None:
    """1 - exp(-t/T) at every rate: a faster sensor is not filtered more."""
    steps = round(0.02 / dt_s)
    outputs = run(Filter(1, 0.01), [np.zeros(6)] + [np.ones(6)] * steps, dt_s)
    assert outputs[-1] == pytest.approx(np.full(6, 1.0 - math.exp(-2.0)), abs=1e-9)
