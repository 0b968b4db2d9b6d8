"""The wrench service on the bus: its messages, and the conditions for "not valid"."""

from unittest.mock import patch

import numpy as np
import pytest

from common.motion.frames import rotation_from_vector
from forcemesh import topics
from forcemesh.messages import RobotState
from tests.fakes.bench import CELL
from tests.fakes.records import encode_unchecked
from tests.fakes.wrench_bench import DOWN, REPORT_S, SENSOR_S, WrenchBench

FAULT_HOLD_STEPS = round(REPORT_S / SENSOR_S)


# --- what is published ----------------------------------------------------------------------------


@pytest.mark.parametrize("turn", [(0, 0, 0), (1.0, 1.0, 2.0)])
def test_the_wrench_is_the_environments_at_the_tcp_in_base(bench: WrenchBench, turn) -> None:
    """In any orientation it is zero without contact and else the push, with the raw reading."""
    bench.R_base_flange = rotation_from_vector(np.array(turn, dtype=float)) @ DOWN
    free = bench.settle()
    assert free.valid
    assert free.force_N == pytest.approx((0, 0, 0), abs=1e-9)
    assert free.torque_Nm == pytest.approx((0, 0, 0), abs=1e-9)

    bench.force_N, bench.torque_Nm = np.array([3.0, -4.0, 30.0]), np.array([0.1, 0.2, -0.3])
    pushed = bench.settle()
    assert pushed.force_N == pytest.approx((3.0, -4.0, 30.0), abs=1e-5)
    assert pushed.torque_Nm == pytest.approx((0.1, 0.2, -0.3), abs=1e-5)
    assert pushed.raw_force_N == bench.sample().force_N
    assert pushed.raw_torque_Nm == bench.sample().torque_Nm


def test_it_publishes_at_the_control_rate_with_the_sample_behind_it(bench: WrenchBench) -> None:
    """Every second sample at 500 and 250 Hz; the origin is that sample's stamp and number."""
    bench.settle()
    before = bench.out.counters
    first = before.received + before.superseded
    for _ in range(500):
        bench.step()
        reading = bench.out.read(bench.clock.now_ns())
        origin = reading.origin
        assert origin is not None
        assert 0 <= bench.clock.now_ns() - origin.stamp_ns <= 2 * SENSOR_S * 1e9
    published = bench.out.counters.received + bench.out.counters.superseded - first
    assert published == pytest.approx(CELL.rates.control_hz * 500 * SENSOR_S, abs=2)


def is_of_now(bench: WrenchBench) -> bool:
    """Return whether the newest wrench is of the newest sample."""
    origin = bench.out.read(bench.clock.now_ns()).origin
    return origin is not None and origin.stamp_ns == bench.clock.now_ns()


@pytest.mark.parametrize("push_N", [0.0, 25.0])
def test_samples_that_arrive_together_are_filtered_as_one_after_the_other(
    bench: WrenchBench, push_N: float
) -> None:
    """A robot or a network may deliver the samples of a period at once; none is left out."""
    together = WrenchBench()
    for each in (bench, together):
        each.settle()
        while not is_of_now(each):  # the second of two samples is published
            each.step()
        each.force_N[2] = push_N
    for _ in range(20):
        bench.step(2)
        for _ in range(2):
            together.clock.sleep_s(SENSOR_S)
            together.before_step()
        together.service.step(together.clock.now_ns())
        assert together.published().force_N == pytest.approx(bench.published().force_N, abs=1e-12)
    assert together.service.counters() == bench.service.counters()


def test_a_fault_of_the_first_of_two_samples_is_reported(bench: WrenchBench) -> None:
    """At once, although the second one is good: it may be the only sign of a broken cable."""
    bench.settle()
    bench.clock.sleep_s(SENSOR_S)
    bench.sensor = {"status": "fault", "valid": False, "code": "sensor_fault", "reason": "cable"}
    bench.before_step()
    bench.sensor = {}
    bench.step()
    assert (bench.published().valid, bench.published().code) == (False, "sensor_fault")


# --- not valid ------------------------------------------------------------------------------------


def test_before_the_first_sample_it_reports_the_missing_input(bench: WrenchBench) -> None:
    """An idle service must differ from a dead one."""
    bench.silent = {"sensor", "robot"}
    bench.step()
    assert (bench.published().valid, bench.published().reason) == (False, "sensor/wrench missing")


@pytest.mark.parametrize(
    ("name", "topic"), [("sensor", topics.SENSOR_WRENCH), ("robot", topics.ROBOT_STATE)]
)
def test_a_stale_input_is_reported_by_name_and_at_the_usual_rate(
    bench: WrenchBench, name, topic
) -> None:
    """Valid up to the deadline, then not valid with age and limit, every period (H26)."""
    bench.settle()
    bench.silent = {name}
    bench.pass_s(CELL.stale_after_s(topic) - 2 * SENSOR_S)
    assert bench.published().valid
    bench.step(4)
    first = bench.out.counters.received + bench.out.counters.superseded
    bench.pass_s(1.0)
    message = bench.published()
    assert not message.valid
    assert message.reason.startswith(f"{topic.key} stale: ")
    assert bench.service.fault.startswith(f"{topic.key} stale: ")
    published = bench.out.counters.received + bench.out.counters.superseded - first
    assert published == pytest.approx(CELL.rates.control_hz, rel=0.4)

    bench.silent = set()
    assert bench.settle().valid
    assert bench.service.fault == ""


@pytest.mark.parametrize(
    ("changes", "code", "reason"),
    [
        ({"status": "fault", "reason": "hot", "valid": False}, "sensor_fault", "fault: hot"),
        ({"valid": False, "reason": "no cable"}, "sensor_fault", "sensor/wrench invalid: no cable"),
        ({"valid": False, "code": "sensor_frozen"}, "sensor_frozen", "no reason given"),
        ({"force_N": (0.0, 0.0, 501.0)}, "sensor_saturated", "Fz reads 501 N, 95% of its range"),
    ],
)
def test_an_invalid_sample_makes_no_wrench(bench: WrenchBench, changes, code, reason) -> None:
    """The wrench is not valid, with the reason, and later the filter has no trace of the sample."""
    bench.settle()
    bench.sensor = {"force_N": (100.0, 100.0, 100.0), **changes}
    bench.step(4)
    assert (bench.published().valid, bench.published().code) == (False, code)
    assert reason in bench.published().reason
    assert bench.published().force_N == (0.0, 0.0, 0.0)

    bench.sensor = {}
    for _ in range(FAULT_HOLD_STEPS + 2):
        bench.step()
        if bench.published().valid:
            assert bench.published().force_N == pytest.approx((0, 0, 0), abs=1e-9)
    assert bench.published().valid


def test_a_robot_without_an_orientation_makes_no_wrench(bench: WrenchBench) -> None:
    """The reason names topic and field of a zero quaternion; the service continues."""
    bench.settle()
    bench.silent = {"robot"}
    with patch("forcemesh.bus.encode", encode_unchecked):  # another program's
        bench.put(topics.ROBOT_STATE, RobotState(orientation_xyzw=(0.0, 0.0, 0.0, 0.0)))
    bench.step(2)
    assert not bench.published().valid
    assert "robot/state unreadable: RobotState.orientation_xyzw" in bench.published().reason


def test_a_sample_counts_once_for_any_number_of_steps(bench: WrenchBench) -> None:
    """Between two samples the output is constant: time is the sensor's, not the loop's."""
    bench.settle()
    bench.force_N = np.array([0.0, 0.0, 40.0])
    bench.step(4)
    bench.silent = {"sensor"}
    bench.step(3)
    before = bench.published().force_N[2]
    assert 1.0 < before < 39.0
    bench.step(10)
    assert bench.published().force_N[2] == before


def test_a_spike_during_several_steps_is_still_one_sample(bench: WrenchBench) -> None:
    """The median counts samples: a spike that is read five times is one of three."""
    bench.settle()
    bench.force_N = np.array([0.0, 0.0, 40.0])
    bench.step()
    bench.silent = {"sensor"}
    bench.step(5)
    bench.silent, bench.force_N = set(), np.zeros(3)
    for _ in range(6):
        bench.step()
        assert bench.published().valid
        assert bench.published().force_N == pytest.approx((0, 0, 0), abs=1e-9)


def test_every_sample_triggers_the_service(bench: WrenchBench) -> None:
    """Its trigger is the sensor: the filter runs at the sensor's rate."""
    assert bench.service.trigger is not None
    assert bench.service.trigger.topic is topics.SENSOR_WRENCH
