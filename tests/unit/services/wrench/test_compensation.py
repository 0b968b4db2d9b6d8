"""From the sensor's reading to the force of the environment: compensation, filter, tare."""

import math
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from common.config.payload import Payload
from common.motion.convert import vec3
from common.motion.frames import GRAVITY_M_S2, rotation_from_vector
from common.motion.weight import predict
from services.wrench.calibration_manager import WEIGHT_SHARE, tare
from services.wrench.compensation import Compensation, Filter, Wrench
from tests.fakes.bench import CELL

NOTHING = Payload(
    mass_kg=0.0, com_m=(0.0, 0.0, 0.0), bias_force_N=(0.0, 0.0, 0.0), bias_torque_Nm=(0.0, 0.0, 0.0)
)
OFF_CENTRE = Payload(
    mass_kg=1.3,
    com_m=(0.012, -0.03, 0.06),
    bias_force_N=(1.5, -2.0, 3.0),
    bias_torque_Nm=(0.05, -0.04, 0.03),
)
MOST_N, MOST_NM = 10.0, 1.0  # of a change of bias
OF_WEIGHT_N = WEIGHT_SHARE * OFF_CENTRE.mass_kg * GRAVITY_M_S2

vectors = hnp.arrays(float, 3, elements=st.floats(-50.0, 50.0))
levers = hnp.arrays(float, 3, elements=st.floats(-0.3, 0.3))
turns = hnp.arrays(float, 3, elements=st.floats(-1.8, 1.8))
samples = hnp.arrays(float, 6, elements=st.floats(-100.0, 100.0))
triples = st.tuples(*[st.floats(-0.3, 0.3)] * 3)
biases = st.tuples(*[st.floats(-20.0, 20.0)] * 3)
payloads = st.builds(
    Payload,
    mass_kg=st.floats(0.0, 7.0),
    com_m=triples,
    bias_force_N=biases,
    bias_torque_Nm=biases,
)


def reading_of(payload, R, p, force_N, torque_Nm):
    """Return the reading of an ideal sensor, from a free body diagram in base axes.

    The weight acts at the centre of mass, the environment at the TCP; both about the sensor.
    """
    weight_N = np.array([0.0, 0.0, -payload.mass_kg * GRAVITY_M_S2])
    com_m, tcp_m = R @ np.array(payload.com_m), R @ p
    total_N = weight_N + force_N
    total_Nm = np.cross(com_m, weight_N) + torque_Nm + np.cross(tcp_m, force_N)
    return SimpleNamespace(
        force_N=R.T @ total_N + np.array(payload.bias_force_N),
        torque_Nm=R.T @ total_Nm + np.array(payload.bias_torque_Nm),
    )


def compensate(reading, *, R_base_sensor, p_sensor_tcp_in_sensor, payload):
    """Return the compensated reading of a sensor whose axes are those of the flange."""
    T_flange_tcp = pin.SE3(np.eye(3), p_sensor_tcp_in_sensor)
    T_base_flange = pin.SE3(R_base_sensor, np.array([0.2, -0.4, 0.6]))  # irrelevant position
    numbers = Wrench(vec3(np.array(reading.force_N)), vec3(np.array(reading.torque_Nm)))
    found = Compensation(payload, pin.SE3.Identity(), T_flange_tcp).at_tcp(numbers, T_base_flange)
    return SimpleNamespace(force_N=np.array(found.force_N), torque_Nm=np.array(found.torque_Nm))


# --- frame and reference point --------------------------------------------------------------------


@given(vectors, vectors, turns, levers, vectors, turns)
def test_power_is_the_same_at_the_sensor_and_at_the_tcp(f, t, turn, p, v_sensor, w) -> None:
    """F.v + M.w does not depend on axes or point, for any rigid motion of the tool."""
    R = rotation_from_vector(turn)
    at_tcp_in_base = compensate(
        SimpleNamespace(force_N=f, torque_Nm=t),
        R_base_sensor=R,
        p_sensor_tcp_in_sensor=p,
        payload=NOTHING,
    )
    v_tcp = v_sensor + np.cross(w, R @ p)

    at_sensor_W = (R @ f) @ v_sensor + (R @ t) @ w
    at_tcp_W = at_tcp_in_base.force_N @ v_tcp + at_tcp_in_base.torque_Nm @ w
    assert at_tcp_W == pytest.approx(at_sensor_W, abs=1e-8, rel=1e-9)


@given(vectors, vectors, turns, levers, turns)
def test_power_is_the_same_with_a_rotated_sensor(f, t, turn, p, mounting) -> None:
    """The mounting correction turns axes only; the TCP stays where the cell file has it."""
    payload = NOTHING.model_copy(update={"mounting_rotation_rad": tuple(mounting.tolist())})
    R = rotation_from_vector(turn)
    R_true = R @ rotation_from_vector(mounting)
    reading = SimpleNamespace(force_N=f, torque_Nm=t)
    found = compensate(reading, R_base_sensor=R, p_sensor_tcp_in_sensor=p, payload=payload)

    assert found.force_N == pytest.approx(R_true @ f, abs=1e-9)
    assert found.torque_Nm == pytest.approx(R_true @ t - np.cross(R @ p, R_true @ f), abs=1e-9)


# --- weight and bias ------------------------------------------------------------------------------


@given(payloads, turns, levers)
@example(OFF_CENTRE, np.array([math.pi, 0.0, 0.0]), np.array([0.0, 0.0, 0.14]))
def test_an_off_centre_mass_weighs_nothing_in_any_orientation(payload, turn, p) -> None:
    """Without contact the result is zero in every orientation of the tool."""
    R = rotation_from_vector(turn)
    reading = reading_of(payload, R, p, np.zeros(3), np.zeros(3))
    found = compensate(reading, R_base_sensor=R, p_sensor_tcp_in_sensor=p, payload=payload)

    assert found.force_N == pytest.approx(np.zeros(3), abs=1e-9)
    assert found.torque_Nm == pytest.approx(np.zeros(3), abs=1e-9)


@given(payloads, turns, levers, vectors, vectors)
def test_the_force_of_the_environment_remains(payload, turn, p, force_N, torque_Nm) -> None:
    """It is in base axes, about the TCP, with its own sign: positive pushes the robot."""
    R = rotation_from_vector(turn)
    reading = reading_of(payload, R, p, force_N, torque_Nm)
    found = compensate(reading, R_base_sensor=R, p_sensor_tcp_in_sensor=p, payload=payload)

    assert found.force_N == pytest.approx(force_N, abs=1e-8)
    assert found.torque_Nm == pytest.approx(torque_Nm, abs=1e-8)


gains = st.tuples(*[st.floats(0.9, 1.1)] * 3)


@given(payloads, turns, levers, vectors, vectors, gains, gains)
def test_the_gain_of_an_axis_is_removed(
    payload, turn, p, force_N, torque_Nm, force_gain, torque_gain
) -> None:
    """The load of each axis, without bias, has a gain: the wrench is the same."""
    R = rotation_from_vector(turn)
    true = reading_of(payload, R, p, force_N, torque_Nm)
    b_F, b_M = np.array(payload.bias_force_N), np.array(payload.bias_torque_Nm)
    reading = SimpleNamespace(
        force_N=(true.force_N - b_F) * force_gain + b_F,
        torque_Nm=(true.torque_Nm - b_M) * torque_gain + b_M,
    )
    known = payload.model_copy(update={"force_gain": force_gain, "torque_gain": torque_gain})
    found = compensate(reading, R_base_sensor=R, p_sensor_tcp_in_sensor=p, payload=known)

    assert found.force_N == pytest.approx(force_N, abs=1e-8)
    assert found.torque_Nm == pytest.approx(torque_Nm, abs=1e-8)


MUTANTS = {
    "transposed orientation": lambda R, p, load: (R.T, p, load),
    "inverted lever": lambda R, p, load: (R, -p, load),
    "no lever": lambda R, p, load: (R, 0.0 * p, load),
    "mirrored centre of mass": lambda R, p, load: (
        R, p, load.model_copy(update={"com_m": tuple(-x for x in load.com_m)})
    ),
    "centred mass": lambda R, p, load: (R, p, load.model_copy(update={"com_m": (0.0, 0.0, 0.0)})),
    "gravity upwards": lambda R, p, load: (
        R, p, load.model_copy(update={"gravity_direction_in_base": (0.0, 0.0, 1.0)})
    ),
    "inverted bias": lambda R, p, load: (
        R, p, load.model_copy(update={"bias_force_N": tuple(-x for x in load.bias_force_N)})
    ),
    "no bias of the torque": lambda R, p, load: (
        R, p, load.model_copy(update={"bias_torque_Nm": (0.0, 0.0, 0.0)})
    ),
}  # fmt: skip


@pytest.mark.parametrize("mutant", MUTANTS.values(), ids=MUTANTS)
def test_each_common_mistake_is_detected(mutant) -> None:
    """The checks above can fail: every typical error leaves newtons or newton metres."""
    R = rotation_from_vector(np.array([2.0, 0.7, -0.4]))
    p, force_N, torque_Nm = np.array([0.02, 0.0, 0.14]), np.array([3.0, 5.0, 30.0]), np.ones(3)
    reading = reading_of(OFF_CENTRE, R, p, force_N, torque_Nm)
    R_wrong, p_wrong, payload_wrong = mutant(R, p, OFF_CENTRE)
    found = compensate(
        reading, R_base_sensor=R_wrong, p_sensor_tcp_in_sensor=p_wrong, payload=payload_wrong
    )

    error = max(
        np.abs(found.force_N - force_N).max() / 1.0,
        np.abs(found.torque_Nm - torque_Nm).max() / 0.02,
    )
    assert error > 1.0


def test_the_lever_is_that_of_the_cell_file() -> None:
    """It is from the sensor's origin to the TCP, in sensor axes that are turned by 30 degrees."""
    cos30, sin30 = math.cos(math.radians(30.0)), 0.5
    below = CELL.tool.T_flange_tcp
    aside = below.model_copy(update={"position_m": (0.1, 0.0, 0.16)})
    T_flange_sensor = CELL.sensor.T_flange_sensor.pose
    R = T_flange_sensor.rotation
    for T_flange_tcp, lever in (
        (below.pose, [0.0, 0.0, 0.14]),
        (aside.pose, [0.1 * cos30, -0.1 * sin30, 0.14]),
    ):
        compensation = Compensation(NOTHING, T_flange_sensor, T_flange_tcp)
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


@given(samples, medians, lowpasses)
def test_constant_in_is_constant_out_from_the_first_sample(sample, median, lowpass_s) -> None:
    """The first sample is the first output, without a transient."""
    for output in run(Filter(median, lowpass_s), [sample] * 8):
        assert output == pytest.approx(sample, abs=1e-12)


@given(samples, samples, st.sampled_from([3, 5]), lowpasses, st.integers(2, 9))
def test_a_single_spike_leaves_no_trace(sample, spike, median, lowpass_s, at) -> None:
    """One spike among equal samples, from the third on, does not change the output."""
    stream = [sample] * 12
    stream[at] = spike
    for output in run(Filter(median, lowpass_s), stream):
        assert output == pytest.approx(sample, abs=1e-12)


def test_a_median_of_five_removes_two_spikes_at_once() -> None:
    """The spikes may be on either side of the window's middle."""
    for spikes in (([100.0] * 6, [90.0] * 6), ([-100.0] * 6, [-90.0] * 6)):
        stream = [np.zeros(6)] * 5 + [np.array(spike) for spike in spikes] + [np.zeros(6)] * 5
        assert not np.any(run(Filter(5, 0.0), stream))


def test_without_a_median_a_spike_is_visible() -> None:
    """This shows that the test above can fail."""
    stream = [np.zeros(6)] * 5 + [np.full(6, 100.0)] + [np.zeros(6)] * 5

    assert max(abs(output).max() for output in run(Filter(1, 0.005), stream)) > 10.0


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


# --- tare -----------------------------------------------------------------------------------------


@given(turns, vectors.filter(lambda v: np.linalg.norm(v) < OF_WEIGHT_N), turns, levers)
def test_tare_zeroes_the_reading_in_every_orientation(turn, drift, other, drift_Nm):
    """The bias is in sensor axes: a drift removed here is removed in every other orientation."""
    R = rotation_from_vector(turn)
    drifted = OFF_CENTRE.model_copy(
        update={
            "bias_force_N": tuple((np.array(OFF_CENTRE.bias_force_N) + drift).tolist()),
            "bias_torque_Nm": tuple((np.array(OFF_CENTRE.bias_torque_Nm) + drift_Nm).tolist()),
        }
    )
    still = reading_of(drifted, R, np.zeros(3), np.zeros(3), np.zeros(3))
    reading = np.concatenate([still.force_N, still.torque_Nm])
    tared, reply = tare(
        OFF_CENTRE, [reading - 1.0, reading, reading + 1.0], R, most_N=MOST_N, most_Nm=MOST_NM
    )

    assert reply.accepted
    assert reply.value == pytest.approx(np.linalg.norm(drift), abs=1e-9)
    elsewhere = rotation_from_vector(other)
    found = compensate(
        reading_of(drifted, elsewhere, np.zeros(3), np.zeros(3), np.zeros(3)),
        R_base_sensor=elsewhere,
        p_sensor_tcp_in_sensor=np.zeros(3),
        payload=tared,
    )
    assert found.force_N == pytest.approx(np.zeros(3), abs=1e-9)
    assert found.torque_Nm == pytest.approx(np.zeros(3), abs=1e-9)
    assert tared == OFF_CENTRE.model_copy(
        update={"bias_force_N": tared.bias_force_N, "bias_torque_Nm": tared.bias_torque_Nm}
    )


def test_tare_considers_the_gain() -> None:
    """A bias shift is in units of the reading, not in newtons of load."""
    payload = OFF_CENTRE.model_copy(update={"force_gain": (1.1, 0.9, 1.0)})
    reading = np.concatenate([v + 0.5 for v in predict(payload, np.eye(3))])
    tared, reply = tare(payload, [reading], np.eye(3), most_N=MOST_N, most_Nm=MOST_NM)
    assert reply.accepted
    assert tared.bias_force_N == pytest.approx(np.array(payload.bias_force_N) + 0.5)


@given(turns, vectors, st.floats(0.0, 3.0))
def test_tare_is_refused_exactly_above_its_limits(turn, push, torque_Nm) -> None:
    """Force, torque, share of the weight: refused with value and limit, the payload unchanged."""
    R = rotation_from_vector(turn)
    force_N = float(np.linalg.norm(push))
    assume(min(abs(force_N - MOST_N), abs(force_N - OF_WEIGHT_N)) > 1e-6)
    assume(abs(torque_Nm - MOST_NM) > 1e-6)
    load = reading_of(OFF_CENTRE, R, np.zeros(3), push, np.array([torque_Nm, 0.0, 0.0]))
    reading = np.concatenate([load.force_N, load.torque_Nm])
    tared, reply = tare(OFF_CENTRE, [reading], R, most_N=MOST_N, most_Nm=MOST_NM)

    rules = [
        ("contact", force_N, MOST_N),
        ("contact", torque_Nm, MOST_NM),
        ("payload", force_N, OF_WEIGHT_N),
    ]
    broken = [rule for rule in rules if rule[1] > rule[2]]
    assert reply.accepted == (not broken)
    if broken:
        assert tared is OFF_CENTRE
        code, value, limit = broken[0]
        assert (reply.code, reply.limit) == (code, pytest.approx(limit))
        assert reply.value == pytest.approx(value)


def test_tare_accepts_the_limit_itself() -> None:
    """Exactly at the limit is drift, one bit above it is contact."""
    for place, limit in ((0, MOST_N), (3, MOST_NM)):
        for value, accepted in ((limit, True), (math.nextafter(limit, math.inf), False)):
            reading = np.zeros(6)
            reading[place] = value
            assert (
                tare(NOTHING, [reading], np.eye(3), most_N=MOST_N, most_Nm=MOST_NM)[1].accepted
                == accepted
            )
