"""Faults of the sensor and of its time, as the service publishes them and the cell holds.

H25 not finite, H26 silent and frozen, H27 saturated, H33 wrench and pose apart in time.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.sensor_faults import Disturb, frozen
from forcemesh import topics
from forcemesh.bus import Reading
from forcemesh.codec import Header
from forcemesh.messages import SensorWrench
from forcemesh.requests import MoveRequest
from services.wrench.service import Pairing, sensor_fault
from sim.robot.ft_sensor import FtSample
from tests.fakes.bench import CELL
from tests.fakes.lab import Lab
from tests.fakes.wrench_bench import REPORT_S, SENSOR_S, WrenchBench

FREEZE_AT_MOST_S = 0.1

# --- on the bus -----------------------------------------------------------------------------------


def test_a_pose_too_old_for_its_wrench_is_reported_as_misaligned() -> None:
    """H33: poses arrive at their rate, but 60 ms late; silence of the robot has another code."""
    bench = WrenchBench()
    bench.settle()
    waiting: list[tuple[int, bytes]] = []
    put = bench.transport.publish

    def late(key: str, _qos: Any) -> Callable[[bytes], None]:
        send = put(key, _qos)

        def delay(data: bytes) -> None:
            now_ns = bench.clock.now_ns()
            waiting.append((now_ns + 60_000_000, data))
            while waiting and waiting[0][0] <= now_ns:
                send(waiting.pop(0)[1])

        return delay

    bench.transport.publish = late  # type: ignore[method-assign]
    bench.replace_writer(topics.ROBOT_STATE)
    bench.transport.publish = put  # type: ignore[method-assign]
    bench.pass_s(0.07)
    found = bench.published()
    assert (found.valid, found.code) == (False, "misaligned")
    assert "60 ms apart, the limit is 20 ms" in found.reason


@given(st.lists(st.tuples(st.booleans(), st.integers(0, 200)), min_size=1, max_size=30))
@settings(max_examples=50)
def test_only_a_late_input_is_misaligned(stream: list[tuple[bool, int]]) -> None:
    """A silent input is never late: the gap is that of the last message."""
    pairing, stamps, seqs = Pairing(), [0, 0], [1, 1]
    for is_robot, late_ms in stream:
        stamps[is_robot] = max(stamps) - late_ms * 1_000_000
        seqs[is_robot] += 1
        pairing.update(header(seqs[0], stamps[0]), header(seqs[1], stamps[1]))
        apart_s = (stamps[not is_robot] - stamps[is_robot]) / 1e9
        assert pairing.apart_s == pytest.approx(apart_s)


def test_a_spike_that_was_left_out_is_counted() -> None:
    """It changes no wrench, and health says that there was one."""
    bench = WrenchBench()
    before = bench.settle()
    bench.force_N = np.array([0.0, 0.0, 300.0])
    bench.step()
    bench.force_N = np.zeros(3)
    after = bench.settle()
    assert after.valid
    assert after.force_N == pytest.approx(before.force_N, abs=1e-6)
    assert bench.service.counters()["sensor_spikes"] == 1


def test_inputs_of_two_clocks_are_never_misaligned() -> None:
    """Their stamps are not compared: an arm on another PC is not late by its uptime."""
    pairing = Pairing()
    pairing.update(header(1, 0), header(1, 10**15, boot="other"))
    assert pairing.apart_s == 0.0


def header(seq: int, stamp_ns: int, boot: str = "one") -> Any:
    """Return a header of one clock."""
    return Header(seq=seq, epoch=1, boot=boot, stamp_ns=stamp_ns)


# --- in the cell ----------------------------------------------------------------------------------


def disturbed(**changes: Any) -> Disturb:
    """Return a sensor disturbance that adds force or sets a status."""
    added_N = np.array(changes.get("added_N", (0.0, 0.0, 0.0)))

    def disturb(sample: FtSample) -> FtSample:
        status = changes.get("status", sample.status)
        return FtSample(sample.force_N + added_N, sample.torque_Nm, status, sample.counter)

    return disturb


FAULTY: dict[str, tuple[Callable[[], Disturb], str, float]] = {
    "saturated bit": (lambda: disturbed(status="saturated"), "sensor_saturated", 0.010),
    "near its range": (lambda: disturbed(added_N=(480.0, 0.0, 0.0)), "sensor_saturated", 0.010),
    "own fault": (lambda: disturbed(status="fault"), "sensor_fault", 0.010),
    "not finite": (lambda: disturbed(added_N=(np.nan, 0.0, 0.0)), "not_finite", 0.010),
    "jump": (lambda: disturbed(added_N=(0.0, 250.0, 0.0)), "sensor_jump", 0.012),
    "frozen": (frozen, "sensor_frozen", FREEZE_AT_MOST_S),
    "silent": (
        lambda: lambda _: None,
        "sensor_silent",
        CELL.stale_after_s(topics.SENSOR_WRENCH) + 0.01,
    ),
}


@pytest.mark.parametrize("name", FAULTY)
def test_every_fault_of_the_sensor_holds_the_pressing_arm_with_its_code(name: str) -> None:
    """H25 to H27 while pressing: in time, by its code, without more force, and permanently."""
    make, code, in_time_s = FAULTY[name]
    lab = Lab()
    lab.press()
    before_N = float(np.linalg.norm(lab.cell.arm.true_wrench().force_N))
    lab.cell.arm.ft_sensor.disturb = make()
    took_s = lab.seconds_until(lambda: lab.now(lab.command).permission is None, in_time_s + 0.05)
    assert took_s <= in_time_s
    lab.cell.advance(0.06)
    assert lab.status.state in {"FAULT", "HOLDING"}
    named = {trip.code for trip in lab.status.trips}
    if name == "silent":  # the arbiter may find the pose too far from the last sample first
        named.add(lab.now(lab.wrench).code)
    assert code in named
    lab.cell.advance(0.3)
    assert np.linalg.norm(lab.cell.arm.true_wrench().force_N) <= before_N + 1.0
    lab.cell.arm.ft_sensor.disturb = lambda sample: sample
    lab.cell.advance(1.0)
    lab.assert_still(0.3)


def test_a_single_wrong_sample_reaches_every_reader() -> None:
    """The fault of one sample is published for as long as the topic's deadline lasts."""
    bench = WrenchBench()
    bench.settle()
    bench.sensor = {"status": "fault"}
    bench.step()
    bench.sensor = {}
    for _ in range(round(REPORT_S / SENSOR_S) - 1):
        bench.step()
        assert (bench.published().valid, bench.published().code) == (False, "sensor_fault")
    bench.step(3)
    assert bench.published().valid


def test_collisions_at_the_speed_limit_are_no_sensor_faults() -> None:
    """A move into the plate at 0.25 m/s ends by the force ceiling or in the plate."""
    lab = Lab()
    lab.lift()
    lab.cell.advance(3.0)

    lab.ask(topics.MOVE, MoveRequest(kind="pose", pose=lab.target(z_m=-0.12), speed_m_s=0.25))
    lab.cell.advance(2.0)
    assert not [trip.code for trip in lab.status.trips if trip.code.startswith("sensor")]


def test_a_silent_sensor_has_its_own_code() -> None:
    """Missing and stale inputs are silence under any code of the reader."""
    silent: Reading[SensorWrench] = Reading(None, None, 9.0, "stale", silent=True, code="stale")
    assert sensor_fault(silent).code == "sensor_silent"
