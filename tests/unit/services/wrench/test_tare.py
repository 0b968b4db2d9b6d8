"""Tare by request: when it is accepted, and everything that it is refused for."""

from dataclasses import replace

import numpy as np
import pytest

from common.config.payload import Payload, residual
from common.motion.frames import GRAVITY_M_S2, rotation_from_vector
from forcemesh import topics
from forcemesh.messages import RobotStatus
from forcemesh.requests import Empty
from services.wrench.tare import TareLimits, tare
from tests.fakes.bench import CELL
from tests.fakes.wrench_bench import SENSOR_S, TOLD_S, WrenchBench

PAYLOAD_KG = 1.0


@pytest.fixture
def bench() -> WrenchBench:
    """A service that has heard nothing yet."""
    return WrenchBench()


def test_tare_at_rest_makes_the_reading_zero_and_says_so(bench: WrenchBench) -> None:
    """A drift of the sensor is taken out here and in another orientation; nothing else changes."""
    drifted = np.array(bench.sample().force_N) + np.array([2.0, -1.0, 0.5])
    bench.sensor = {"force_N": tuple(drifted.tolist())}
    assert np.linalg.norm(bench.settle().force_N) == pytest.approx(np.sqrt(5.25))
    bench.pass_s(0.3)
    reply = bench.ask(topics.TARE, Empty())
    assert reply.accepted
    assert reply.value == pytest.approx(np.sqrt(5.25))
    assert bench.settle().force_N == pytest.approx((0, 0, 0), abs=1e-9)
    assert bench.said().calibration == "cell file, tared"


def test_tare_is_refused_in_contact(bench: WrenchBench) -> None:
    """More than the cell allows is not drift; the number and the limit are told (H29)."""
    bench.force_N = np.array([0.0, 0.0, CELL.force.tare_max_N + 0.1])
    bench.settle()
    bench.pass_s(0.3)
    reply = bench.ask(topics.TARE, Empty())
    assert (reply.accepted, reply.code, reply.limit) == (False, "contact", CELL.force.tare_max_N)
    assert bench.settle().force_N[2] == pytest.approx(CELL.force.tare_max_N + 0.1)
    assert bench.said().calibration == "cell file"


def test_tare_is_refused_in_motion(bench: WrenchBench) -> None:
    """By the controller's bit, by the way that the flange has gone, and by the angle."""
    bench.pass_s(0.4)
    bench.status = RobotStatus(moving=True)
    bench.step()
    reply = bench.ask(topics.TARE, Empty())
    assert (reply.accepted, reply.code) == (False, "moving")
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
    """Refused with what is missing; samples from before a gap do not count."""
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
    bench.pass_s(TOLD_S + 2 * SENSOR_S)
    assert bench.ask(topics.TARE, Empty()).code == "wait"


def test_tare_needs_poses_for_all_its_samples(bench: WrenchBench) -> None:
    """A robot that was not heard for part of the window: wait, no guess and no crash."""
    bench.silent = {"robot"}
    bench.pass_s(0.3)
    bench.silent = set()
    bench.step(2)
    assert bench.ask(topics.TARE, Empty()).code == "wait"
    bench.pass_s(0.3)
    assert bench.ask(topics.TARE, Empty()).accepted


@pytest.mark.parametrize("share", [1 - 1 / 4.448, 1 - 1 / 9.807, 1.0, 2.0**0.5, 2.0])
def test_a_tare_must_not_swallow_the_weight_of_the_tool(share: float) -> None:
    """H30, H31: pounds, kgf, a dead axis, a swapped axis, a wrong sign; less of it is drift."""
    light = PAYLOAD_KG * 0.4  # so that the cell's own limit does not speak first
    payload = Payload(light, (0.0, 0.0, 0.05), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    limits = TareLimits(1000.0, 1000.0)
    weight_N = light * GRAVITY_M_S2
    off_N = np.array([0.0, 0.0, -weight_N * (1.0 - share), 0.0, 0.0, 0.0])
    kept, reply = tare(payload, [off_N], np.eye(3), limits)
    assert (reply.accepted, reply.code) == (False, "payload")
    assert kept == payload
    drift = np.array([0.0, 0.5 * weight_N, -weight_N, 0.0, 0.0, 0.0])
    assert tare(payload, [drift], np.eye(3), limits)[1].accepted


def tool_of(weight_N: float) -> Payload:
    """Return a tool of this weight below the sensor's origin, whose bias is nothing."""
    none = (0.0, 0.0, 0.0)
    return Payload(weight_N / GRAVITY_M_S2, (0.0, 0.0, 0.05), none, none)


def reading(weight_N: float, *, force_N: float = 0.0, torque_Nm: float = 0.0) -> np.ndarray:
    """Return what a sensor reads of a weight and of something that pulls it aside."""
    return np.array([force_N, 0.0, -weight_N, torque_Nm, 0.0, 0.0])


@pytest.mark.parametrize(
    ("force_N", "torque_Nm", "code"),
    [(3.0, 0.25, "ok"), (3.0 + 1e-9, 0.0, "contact"), (0.0, 0.25 + 1e-9, "contact")],
)
def test_a_change_as_large_as_the_limit_is_no_contact_yet(
    force_N: float, torque_Nm: float, code: str
) -> None:
    """The limit itself is allowed, for force and for torque."""
    sample = reading(1.0, force_N=force_N, torque_Nm=torque_Nm)
    _, reply = tare(tool_of(1.0), [sample], np.eye(3), TareLimits(3.0, 0.25))
    assert reply.code == code


@pytest.mark.parametrize(
    ("weight_N", "share", "code"),
    [(1.9, 0.7, "ok"), (2.1, 0.7, "payload"), (2.0, 0.7, "payload"), (2.0, 0.6, "ok")],
)
def test_from_two_newtons_on_a_tool_must_not_lose_more_than_three_fifths(
    weight_N: float, share: float, code: str
) -> None:
    """Both figures as the documentation says them; the refusal tells the limit."""
    tool = tool_of(weight_N)
    weight_N = tool.mass_kg * GRAVITY_M_S2
    sample = reading(weight_N, force_N=share * weight_N)
    _, reply = tare(tool, [sample], np.eye(3), TareLimits(1000.0, 1000.0))
    assert reply.code == code
    if code == "payload":
        assert reply.limit == pytest.approx(0.6 * weight_N)


def test_after_a_tare_nothing_is_left_of_what_was_read() -> None:
    """Also where each axis reads its load by a gain of its own, and had a bias before."""
    tool = replace(
        tool_of(1.0),
        bias_force_N=(0.3, -0.2, 0.1),
        bias_torque_Nm=(0.02, 0.01, -0.03),
        force_gain=(1.1, 0.9, 1.05),
        torque_gain=(0.95, 1.1, 0.9),
    )
    sample = np.array([0.8, 0.4, -1.3, 0.05, -0.02, 0.04])
    tared, reply = tare(tool, [sample], np.eye(3), TareLimits(5.0, 1.0))
    assert reply.accepted
    left_N, left_Nm = residual(tared, np.eye(3), force_N=sample[:3], torque_Nm=sample[3:])
    assert np.abs([left_N, left_Nm]).max() <= 1e-12
