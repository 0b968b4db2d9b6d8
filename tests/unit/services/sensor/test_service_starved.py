"""The sensor driver without samples: its messages and its recovery, on real sockets."""

import socket

import pytest

from services.sensor.rdt import RdtCommand, request
from tests.fakes.rdt_sensor import (
    PATIENCE_S,
    PERIOD_S,
    FakeSensor,
    Rig,
    assert_no_numbers,
    is_at_rate,
)

pytestmark = pytest.mark.realtime

STALE_S = 0.020


def test_before_the_first_sample_the_driver_reports_it_at_its_rate(rig: Rig) -> None:
    """An idle driver differs from a dead one from its first period on."""
    messages = rig.advance(0.2)
    assert_no_numbers(messages, "nothing received")
    assert is_at_rate(messages, 0.2)
    assert f"127.0.0.1:{rig.sensor.port}" in messages[-1].reason


def test_silence_is_reported_after_the_deadline_without_old_numbers(rig: Rig) -> None:
    """Before the deadline nothing is published; after it every message is not valid."""
    rig.stream(0.1)
    assert rig.advance(STALE_S - 2 * PERIOD_S) == []
    rig.advance(4 * PERIOD_S)
    messages = rig.advance(0.2)
    assert_no_numbers(messages, "nothing received any more")
    assert is_at_rate(messages, 0.2)
    assert rig.driver.fault


def test_silent_sensor_gets_new_requests_and_its_new_stream_is_taken(rig: Rig) -> None:
    """Requests are repeated until the sensor answers; its numbers may begin at 1 again."""
    rig.stream(0.1)
    rig.advance(0.6)
    assert [rig.sensor.receive(), rig.sensor.receive()] == [request(RdtCommand.START)] * 2
    assert rig.sensor.place == 0
    messages = rig.stream(0.1)
    assert len(messages) == 50
    assert all(message.valid for message in messages)
    assert [rig.counters[name] for name in ("lost", "duplicates", "restarts")] == [0, 0, 0]
    assert [message.counter for message in messages] == list(range(51, 101))
    assert rig.driver.fault == ""


def test_streaming_sensor_gets_no_second_request(rig: Rig) -> None:
    """A second request would restart the stream."""
    rig.stream(1.0)
    assert rig.counters["requests"] == 1


def test_unrequested_sequence_restart_is_reported_and_loses_no_record(rig: Rig) -> None:
    """A restarted sensor may have another bias: its samples are not valid for a while."""
    rig.stream(0.4)
    rig.sensor.place, rig.sensor.ft = 0, 0
    messages = rig.stream(0.2)
    assert_no_numbers(messages, "sensor restarted")
    assert {message.code for message in messages} == {"sensor_restarted"}
    assert len(messages) == 100
    assert (rig.counters["restarts"], rig.counters["lost"]) == (1, 0)
    rig.stream(0.06)
    assert all(message.valid for message in rig.stream(0.1))


def test_stalled_sensor_is_not_valid_although_records_come(rig: Rig) -> None:
    """Records with the previous sample give no sample; a new sample makes the topic valid."""
    rig.stream(0.1)
    assert rig.stream(STALE_S - 2 * PERIOD_S, stalled=True) == []
    rig.stream(4 * PERIOD_S, stalled=True)
    messages = rig.stream(0.3, stalled=True)
    assert_no_numbers(messages, f"stalled: ft_sequence stays at {rig.sensor.ft}")
    assert is_at_rate(messages, 0.3)
    assert rig.counters["requests"] == 1
    assert all(message.valid for message in rig.stream(0.02))


def test_sensor_that_stalls_and_then_falls_silent_is_reported_as_silent(rig: Rig) -> None:
    """The reason describes the present state."""
    rig.stream(0.1)
    rig.stream(0.1, stalled=True)
    rig.advance(0.3)
    assert_no_numbers(rig.advance(0.1), "nothing received: check address")


def test_answer_within_the_first_step_is_taken(sensor: FakeSensor) -> None:
    """A socket that was opened just now has no late data."""
    with Rig(sensor) as rig:
        rig.advance(PERIOD_S / 10)
        sensor.receive()
        (message,) = [message for message in rig.stream(PERIOD_S) if message.valid]
        assert message.counter == 1
        assert rig.counters["late"] == 0


@pytest.mark.parametrize("data", [b"", b"x" * 35, b"x" * 37, b"x" * 1400, b"x" * 4000])
def test_malformed_records_are_counted_and_reported(rig: Rig, data: bytes) -> None:
    """Data of another kind on the port has another reason than silence."""
    rig.advance(STALE_S)
    messages = rig.send(data, data)
    assert_no_numbers(messages, "bytes received, which are not an RDT record of 36 bytes")
    assert rig.counters["malformed"] == 2


def test_records_that_waited_during_a_stall_of_the_process_are_dropped(rig: Rig) -> None:
    """The age of records that waited for longer than the deadline is unknown."""
    rig.stream(0.1)
    rig.clock.sleep_s(2 * STALE_S)
    messages = rig.send(*(rig.sensor.record(force_N=50.0) for _ in range(20)))
    assert_no_numbers(messages, "waited up to")
    assert rig.counters["late"] == 20
    assert rig.counters["lost"] == 0
    assert all(message.valid for message in rig.stream(0.02))


def test_closed_port_is_reported(sensor: FakeSensor) -> None:
    """A closed port has another reason than a wrong address; once open, the stream is taken."""
    with Rig(sensor) as rig:
        rig.sensor.socket.close()
        rig.advance(0.1)
        assert_no_numbers(rig.advance(0.6), "connection refused")
        reopened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        reopened.bind(("127.0.0.1", rig.sensor.port))
        reopened.settimeout(PATIENCE_S)
        rig.sensor.socket = reopened
        rig.advance(0.3)
        rig.sensor.receive()
        assert all(message.valid for message in rig.stream(0.02))
        rig.advance(2 * STALE_S)
        assert_no_numbers(rig.advance(STALE_S), "nothing received any more")


def test_network_that_refuses_to_send_is_reported(sensor: FakeSensor) -> None:
    """The reason has the network error; the driver continues to send requests."""
    broadcast = "255.255.255.255"  # the kernel forbids it to a socket without SO_BROADCAST
    with Rig(sensor, **{"sensor.address": broadcast}) as rig:
        messages = rig.advance(1.0)
        assert_no_numbers(messages[5:], "sensor 255.255.255.255:")
        assert rig.counters["requests"] >= 3


def test_unanswered_requests_are_repeated_from_a_new_socket(rig: Rig) -> None:
    """After a change of the host's address the old socket would receive nothing."""
    first = rig.sensor.client
    rig.advance(2.5)
    clients = set()
    for _ in range(9):
        rig.sensor.receive()
        clients.add(rig.sensor.client)
    assert first in clients
    assert len(clients) == 2
    assert all(message.valid for message in rig.stream(0.02))


def test_closing_stops_the_stream(rig: Rig) -> None:
    """The sensor does not continue to stream without a receiver."""
    rig.stream(0.02)
    rig.driver.close()
    assert rig.sensor.receive() == request(RdtCommand.STOP)
