"""The sensor driver's messages for records that arrive on a real UDP socket."""

import socket
from itertools import pairwise

import pytest

from forcemesh.clock import NS_PER_S
from services.sensor.rdt_status import MONITOR_CONDITIONS
from tests.fakes.rdt_sensor import PERIOD_S, FakeSensor, Rig, assert_no_numbers

pytestmark = pytest.mark.realtime


# --- samples --------------------------------------------------------------------------------------


def test_every_record_becomes_one_message_in_SI(rig: Rig) -> None:
    """Each record of a good stream is converted and published once, stamped when it was read."""
    messages = rig.stream(0.1)
    assert [message.counter for message in messages] == list(range(1, 51))
    assert all(message.valid and message.status == "ok" for message in messages)
    assert messages[6].force_N == pytest.approx((7e-6, -7e-6, 3.0))
    assert messages[6].torque_Nm == pytest.approx((-0.5, 7e-6, 0.0))
    stamps = rig.published.stamps[-50:]
    gaps = {after - before for before, after in pairwise(stamps)}
    assert all(abs(gap - PERIOD_S * NS_PER_S) <= 600_000 for gap in gaps)
    assert rig.driver.fault == ""


def test_records_that_wait_together_are_all_published_and_the_newest_last(rig: Rig) -> None:
    """After a short stall no record is skipped, and a reader of the newest gets the newest."""
    messages = rig.send(*(rig.sensor.record(force_N=force) for force in (1.0, 2.0, 3.0)))
    assert [message.force_N[2] for message in messages] == [1.0, 2.0, 3.0]


def test_sensor_up_to_twice_as_fast_is_passed_on_whole(sensor: FakeSensor) -> None:
    """500 Hz to a cell of 250 Hz: the filter gets every sample."""
    with Rig(sensor, **{"rates.sensor_hz": 250.0}) as rig:
        rig.start()
        assert len(rig.stream(1.0)) == 500
        assert rig.counters["keep_every"] == 1


def test_faster_sensor_is_decimated(sensor: FakeSensor) -> None:
    """500 Hz to a cell of 100 Hz: every fifth sample is published, once the rate is known."""
    with Rig(sensor, **{"rates.sensor_hz": 100.0}) as rig:
        rig.start()
        rig.stream(0.5)
        messages = rig.stream(1.0)
        assert len(messages) == pytest.approx(100, abs=1)
        assert {b.counter - a.counter for a, b in pairwise(messages)} == {5}
        assert rig.counters["sensor_hz"] == 500


def test_decimation_continues_after_a_silence(sensor: FakeSensor) -> None:
    """A silence does not lower the measured rate, which would publish every sample."""
    with Rig(sensor, **{"rates.sensor_hz": 100.0}) as rig:
        rig.start()
        rig.stream(0.5)
        rig.advance(0.3)
        sensor.receive()
        assert len(rig.stream(0.2)) == pytest.approx(20, abs=1)


def test_a_bad_sample_between_two_published_ones_is_reported(sensor: FakeSensor) -> None:
    """One saturated sample between two kept ones makes the next message not valid."""
    with Rig(sensor, **{"rates.sensor_hz": 100.0}) as rig:
        rig.start()
        rig.stream(0.5)
        while not rig.stream(PERIOD_S):
            pass
        assert rig.stream(PERIOD_S, force_N=199.0) == []
        messages = rig.stream(10 * PERIOD_S)
        assert [message.status for message in messages] == ["saturated", "ok"]


def test_lost_records_are_counted_and_show_in_the_counter(rig: Rig) -> None:
    """A gap alone is no fault; readers of the topic find it in the counter."""
    rig.stream(0.02)
    for _ in range(4):
        rig.sensor.record()
    (message,) = rig.stream(PERIOD_S)
    assert message.valid
    assert message.counter == 15
    assert rig.counters["lost"] == 4


def test_copies_and_late_records_are_counted_and_not_published(rig: Rig) -> None:
    """An old reading never follows a newer one."""
    first, second, third = (rig.sensor.record(force_N=force) for force in (1.0, 2.0, 3.0))
    messages = rig.send(first, third, second, third, first, second)
    assert [message.force_N[2] for message in messages] == [1.0, 3.0]
    assert (rig.counters["reordered"], rig.counters["duplicates"]) == (1, 3)
    assert rig.counters["lost"] == 0


def test_datagrams_of_another_address_are_dropped(rig: Rig) -> None:
    """The driver accepts datagrams of the cell file's address only."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other_sender:
        assert rig.sensor.client is not None
        other_sender.sendto(rig.sensor.record(), rig.sensor.client)
    rig.advance(PERIOD_S)
    assert rig.counters["records"] == 0


# --- bad samples ----------------------------------------------------------------------------------


def test_serious_status_is_published_at_once_and_without_numbers(rig: Rig) -> None:
    """Numbers with a serious status are not published; the next good sample is."""
    assert_no_numbers(rig.stream(0.02, status=0x8000_0008), "status 0x80000008")
    assert "0x80000008" in rig.driver.fault
    assert all(message.valid for message in rig.stream(0.02))
    assert rig.driver.fault == ""


def test_threshold_of_the_user_is_counted_and_no_fault(rig: Rig) -> None:
    """The user's threshold concerns the process and not the reading."""
    for count, status in enumerate(MONITOR_CONDITIONS, start=1):
        assert all(message.valid for message in rig.stream(0.02, status=status))
        assert rig.counters["monitor_conditions"] == 10 * count


@pytest.mark.parametrize("force_N", [190.0, -190.0, 2000.0])
def test_saturated_sample_is_not_valid_and_names_the_axis(rig: Rig, force_N: float) -> None:
    """One axis at 95 % of its range makes the whole sample invalid."""
    for message in rig.stream(0.02, force_N=force_N):
        assert not message.valid
        assert message.status == "saturated"
        assert message.reason.startswith("Fz reads")
        assert message.force_N[2] == force_N
    assert all(message.valid for message in rig.stream(0.02, force_N=189.9))


def test_frozen_reading_is_found(rig: Rig) -> None:
    """Samples with new numbers and constant counts are not valid after 0.1 s."""
    messages = rig.stream(0.3, frozen=True)
    assert [message.valid for message in messages[:50]] == [True] * 50
    assert_no_numbers(messages[51:], "frozen")
    assert all(message.valid for message in rig.stream(0.02))
