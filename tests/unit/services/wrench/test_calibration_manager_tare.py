"""Tare by request: conditions and refusals."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.config.payload import Payload
from common.motion.frames import GRAVITY_M_S2, rotation_from_vector
from common.motion.weight import predict, residual
from forcemesh import topics
from forcemesh.messages import ContactEvent, ContactState, RobotStatus, Trip
from forcemesh.requests import Empty
from services.wrench.calibration_manager import Tared, tare
from tests.fakes.bench import CELL
from tests.fakes.wrench_bench import REPORT_S, SENSOR_S, WrenchBench


def test_tare_at_rest_makes_the_reading_zero_and_reports_it(bench: WrenchBench) -> None:
    """A drift is removed in this and in another orientation; nothing else changes."""
    drifted = np.array(bench.sample().force_N) + np.array([2.0, -1.0, 0.5])
    bench.sensor = {"force_N": tuple(drifted.tolist())}
    assert np.linalg.norm(bench.settle().force_N) == pytest.approx(np.sqrt(5.25))
    bench.pass_s(0.3)
    reply = bench.ask(topics.TARE, Empty())
    assert reply.accepted
    assert reply.value == pytest.approx(np.sqrt(5.25))
    assert bench.settle().force_N == pytest.approx((0, 0, 0), abs=1e-9)
    assert (bench.published().calibration, bench.published().tared) == ("cell file", True)


def test_tare_is_refused_in_contact(bench: WrenchBench) -> None:
    """More than the cell allows is not drift; the reply has the value and the limit (H29)."""
    bench.force_N = np.array([0.0, 0.0, CELL.force.tare_max_N + 0.1])
    bench.settle()
    bench.pass_s(0.3)
    reply = bench.ask(topics.TARE, Empty())
    assert (reply.accepted, reply.code, reply.limit) == (False, "contact", CELL.force.tare_max_N)
    assert bench.settle().force_N[2] == pytest.approx(CELL.force.tare_max_N + 0.1)
    assert bench.published().calibration == "cell file"


def test_tare_is_refused_in_motion(bench: WrenchBench) -> None:
    """Motion is the controller's bit, a travel of the flange, or an angle."""
    bench.pass_s(0.4)
    bench.status = RobotStatus(moving=True)
    bench.step()
    reply = bench.ask(topics.TARE, Empty())
    assert (reply.accepted, reply.code, reply.limit) == (False, "moving", 2e-4)
    bench.status = RobotStatus()
    bench.p_m = bench.p_m + np.array([0.0, 0.0, 3e-4])
    bench.step()
    reply = bench.ask(topics.TARE, Empty())
    assert (reply.code, reply.limit) == ("moving", 2e-4)
    assert reply.value == pytest.approx(3e-4)
    bench.pass_s(0.3)
    bench.R_base_flange = rotation_from_vector(np.array([0.02, 0.0, 0.0])) @ bench.R_base_flange
    bench.step()
    reply = bench.ask(topics.TARE, Empty())
    assert (reply.code, reply.limit) == ("moving", 2e-3)
    assert reply.value == pytest.approx(0.02)
    bench.pass_s(0.3)
    assert bench.ask(topics.TARE, Empty()).accepted


def test_tare_needs_inputs_and_a_full_window(bench: WrenchBench) -> None:
    """The refusal names the missing input; samples from before a gap do not count."""
    bench.pass_s(0.1)
    reply = bench.ask(topics.TARE, Empty())
    assert (reply.accepted, reply.code) == (False, "wait")
    bench.pass_s(0.4)
    bench.silent = {"sensor"}
    bench.pass_s(0.3)
    reply = bench.ask(topics.TARE, Empty())
    assert (reply.accepted, reply.code) == (False, "sensor_silent")
    assert "sensor/wrench stale" in reply.text
    bench.silent = set()
    bench.pass_s(REPORT_S + 2 * SENSOR_S)
    assert bench.ask(topics.TARE, Empty()).code == "wait"


def test_tare_needs_poses_for_all_its_samples(bench: WrenchBench) -> None:
    """While the window lacks poses of the robot the reply is `wait`."""
    bench.silent = {"robot"}
    bench.pass_s(0.3)
    bench.silent = set()
    bench.step(2)
    assert bench.ask(topics.TARE, Empty()).code == "wait"
    bench.pass_s(0.3)
    assert bench.ask(topics.TARE, Empty()).accepted


def tool_of(weight_N: float) -> Payload:
    """Return a tool of this weight below the sensor's origin, without bias."""
    none = (0.0, 0.0, 0.0)
    return Payload(
        mass_kg=weight_N / GRAVITY_M_S2,
        com_m=(0.0, 0.0, 0.05),
        bias_force_N=none,
        bias_torque_Nm=none,
    )


def reading(weight_N: float, *, force_N: float = 0.0, torque_Nm: float = 0.0) -> np.ndarray:
    """Return the reading of a weight and of a lateral pull."""
    return np.array([force_N, 0.0, -weight_N, torque_Nm, 0.0, 0.0])


@given(
    st.tuples(*[st.floats(-1.8, 1.8)] * 3),
    st.tuples(*[st.floats(-3.0, 3.0)] * 3),
    st.tuples(*[st.floats(-0.3, 0.3)] * 3),
)
def test_after_a_tare_the_reading_is_zero_in_every_orientation(turn, drift_N, drift_Nm) -> None:
    """Only the bias changes, in units of the reading, also with gains and a bias before."""
    R = rotation_from_vector(np.array(turn))
    tool = tool_of(12.0).model_copy(
        update={
            "bias_force_N": (0.3, -0.2, 0.1),
            "bias_torque_Nm": (0.02, 0.01, -0.03),
            "force_gain": (1.1, 0.9, 1.05),
        }
    )
    drift = np.concatenate((drift_N, drift_Nm)) * (*tool.force_gain, 1.0, 1.0, 1.0)
    still = np.concatenate(predict(tool, R)) + drift
    found = tare(tool, [still - 1.0, still, still + 1.0], R, most_N=10.0, most_Nm=1.0)
    assert isinstance(found, Tared)
    assert found.change_N == pytest.approx(np.linalg.norm(drift_N), abs=1e-9)
    tared = found.payload
    elsewhere = np.concatenate(predict(tool, np.eye(3))) + drift
    left = residual(tared, np.eye(3), force_N=elsewhere[:3], torque_Nm=elsewhere[3:])
    assert np.abs(left).max() <= 1e-12
    kept = {"bias_force_N": tared.bias_force_N, "bias_torque_Nm": tared.bias_torque_Nm}
    assert tared == tool.model_copy(update=kept)


@pytest.mark.parametrize(("place", "limit"), [(0, 3.0), (3, 0.25)])
def test_a_tare_is_refused_exactly_above_its_limits(place: int, limit: float) -> None:
    """The limit itself is drift; one bit above it is contact, with value and limit."""
    tool = tool_of(0.0)
    for value, accepted in ((limit, True), (math.nextafter(limit, math.inf), False)):
        sample = value * np.eye(6)[place]
        found = tare(tool, [sample], np.eye(3), most_N=3.0, most_Nm=0.25)
        assert isinstance(found, Tared) is accepted
        if isinstance(found, Trip):
            assert (found.code, found.value, found.limit) == ("contact", value, limit)


vectors = st.tuples(*[st.floats(-4.0, 4.0)] * 3)


@given(st.lists(st.tuples(vectors, vectors), min_size=1, max_size=12))
def test_no_sequence_of_tares_moves_the_zero_beyond_the_limit(loads) -> None:
    """However a contact grows from tare to tare: what all of them absorb stays within the limit."""
    calibrated = tool_of(1.0).model_copy(update={"force_gain": (1.2, 0.9, 1.0)})
    payload, total = calibrated, np.zeros(6)
    for load in loads:
        total = total + np.concatenate(load) * ([1.0] * 3 + [0.1] * 3)
        sample = np.concatenate(predict(calibrated, np.eye(3)))
        sample += total * (*calibrated.force_gain, 1.0, 1.0, 1.0)
        found = tare(payload, [sample], np.eye(3), most_N=5.0, most_Nm=0.5, calibrated=calibrated)
        payload = found.payload if isinstance(found, Tared) else payload
        bias_N, bias_Nm = np.array(payload.bias_force_N), np.array(payload.bias_torque_Nm)
        assert np.linalg.norm(bias_N / calibrated.force_gain) <= 5.0 + 1e-9
        assert np.linalg.norm(bias_Nm) <= 0.5 + 1e-9
        if isinstance(found, Trip):
            assert found.limit in (5.0, 0.5)
            assert found.value is not None
            assert found.value > found.limit


def test_the_limit_counts_from_the_calibration_until_the_next_one(bench: WrenchBench) -> None:
    """Three newtons twice are six; the refusal has value, limit, key and remedy."""
    bench.pass_s(0.3)
    reading_N = np.array(bench.sample().force_N)
    for pull_N, accepted in ((3.0, True), (6.0, False), (4.9, True)):
        bench.sensor = {"force_N": tuple((reading_N + np.array([pull_N, 0.0, 0.0])).tolist())}
        bench.pass_s(0.3)
        reply = bench.ask(topics.TARE, Empty())
        assert reply.accepted == accepted
        if not accepted:
            assert (reply.code, reply.limit) == ("contact", CELL.force.tare_max_N)
            assert reply.value == pytest.approx(6.0)
            assert "force.tare_max_N" in reply.text
            assert "forcemesh calibrate" in reply.text


@pytest.mark.parametrize(
    ("state", "accepted"), [("contact", False), ("sliding", False), ("lost", True)]
)
def test_a_tare_while_the_regulator_reports_contact_is_refused(
    bench: WrenchBench, state: ContactState, accepted: bool
) -> None:
    """A small force in a known contact is not drift; a report that is stale is not a contact."""
    bench.pass_s(0.3)
    bench.put(topics.CONTACT, ContactEvent(state=state, peak_N=4.0))
    assert bench.ask(topics.TARE, Empty()).accepted == accepted
    bench.pass_s(2.0 * CELL.stale_after_s(topics.CONTACT))
    assert bench.ask(topics.TARE, Empty()).accepted


@pytest.mark.parametrize(
    ("weight_N", "share", "code"),
    [(1.9, 0.7, "ok"), (2.1, 0.7, "payload"), (2.0, 0.7, "payload"), (2.0, 0.6, "ok")],
)
def test_above_two_newtons_a_tare_may_remove_three_fifths_of_the_weight(
    weight_N: float, share: float, code: str
) -> None:
    """Both figures are those of the documentation; the refusal has the limit."""
    tool = tool_of(weight_N)
    weight_N = tool.mass_kg * GRAVITY_M_S2
    sample = reading(weight_N, force_N=share * weight_N)
    found = tare(tool, [sample], np.eye(3), most_N=1000.0, most_Nm=1000.0)
    assert (found.code if isinstance(found, Trip) else "ok") == code
    if isinstance(found, Trip):
        assert found.limit == pytest.approx(0.6 * weight_N)
