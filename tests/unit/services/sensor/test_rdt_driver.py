"""The RDT driver on the simulated Net F/T, on a virtual clock: its messages and its requests.

Each fault of the sensor has its own code: tests/unit/sim/netft.
"""

import pytest

from forcemesh.clock import NS_PER_S
from forcemesh.messages import ZERO3, SensorWrench
from tests.fakes.netft_rig import PERIOD_S, STALE_S, TRUTH, NetftRig


def assert_faults(messages: list[SensorWrench], code: str, reason: str) -> None:
    """Assert that every message is a fault of this code, with its reason and without a reading."""
    assert {(each.valid, each.status, each.code) for each in messages} == {(False, "fault", code)}
    assert all(reason in each.reason for each in messages), messages[-1].reason
    assert all(each.force_N == each.torque_Nm == ZERO3 for each in messages)


def test_every_record_becomes_one_message_in_SI() -> None:
    """One request, no fault; the stream ends with the service."""
    rig = NetftRig()
    rig.run(0.1)
    first = rig.published[-1].counter
    messages = rig.run(1.0)
    assert [each.counter for each in messages] == list(range(first + 1, first + 1001))
    assert all(each.valid and each.status == "ok" for each in messages)
    assert messages[-1].force_N == pytest.approx(TRUTH[:3], abs=5e-3)
    assert (rig.counters["requests"], rig.counters["lost"], rig.service.fault) == (1, 0, "")
    rig.driver.close()
    assert rig.sensor.client is None


def test_silence_is_reported_at_the_rate_of_the_cell_without_old_numbers() -> None:
    """From the first period on; later after the deadline, before which nothing is published."""
    rig = NetftRig(cell={"rates.sensor_hz": 500.0})
    rig.switch(mute="on")
    messages = rig.run(0.2)
    assert_faults(messages, "sensor_silent", "simulated:49152: nothing received: check address")
    assert len(messages) == pytest.approx(0.2 * 500.0, abs=2)
    rig.switch(mute="off")
    rig.run(0.3)
    rig.switch(mute="on")
    stale_s = rig.cell.deadlines.sensor_s
    assert rig.run(stale_s - PERIOD_S) == []
    rig.run(4 * PERIOD_S)
    messages = rig.run(0.1)
    assert_faults(messages, "sensor_silent", "nothing received any more")
    assert messages[0].reason.startswith(f"no sample for {1e3 * stale_s + 5:.0f} ms")
    assert len(messages) == pytest.approx(0.1 * 500.0, abs=2)


def test_records_that_waited_during_a_stall_of_the_process_are_dropped() -> None:
    """The age of records that waited for longer than the deadline is unknown."""
    rig = NetftRig()
    rig.run(0.1)
    for _ in range(20):
        ((data, client),) = rig.sensor.measure(TRUTH.tolist())
        rig.link.deliver(data, client)
    rig.clock.advance_ns(round(2 * STALE_S * NS_PER_S))
    rig.service.step(rig.clock.now_ns())
    assert_faults(rig.run()[-1:], "overrun", "waited up to")
    assert (rig.counters["late"], rig.counters["lost"]) == (20, 0)
    assert all(each.valid for each in rig.run(0.05))
