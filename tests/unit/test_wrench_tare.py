"""Tare by request: when it is accepted, and everything that it is refused for."""

import numpy as np
import pytest

from common import topics
from common.frames import GRAVITY_M_S2, rotation_from_vector
from common.messages import RobotStatus
from common.payload import Payload
from common.requests import Empty
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
