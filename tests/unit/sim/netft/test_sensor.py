"""The simulated Net F/T without sockets: the protocol of the manual, and its switches."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.sensor.rdt import parse
from sim.netft.protocol import record
from sim.netft.sensor import FaultSwitches, NetftSensor

WRENCH = (1.0, -2.0, 3.0, 0.1, -0.2, 0.3)
int32 = st.integers(-(2**31), 2**31 - 1)


def ask(sensor: NetftSensor, command: int, count: int = 0, client: str = "me") -> None:
    """Send a request."""
    sensor.receive(struct.pack(">HHI", 0x1234, command, count), client)


def numbers(sensor: NetftSensor, samples: int) -> list[int]:
    """Measure; return the places of the records that were sent."""
    sent = [datagram for _ in range(samples) for datagram in sensor.measure(WRENCH)]
    return [read.rdt_sequence for data, _ in sent if (read := parse(data)) is not None]


@given(st.integers(0, 2**32 - 1), st.integers(0, 2**32 - 1), st.tuples(*[int32] * 6))
def test_the_driver_reads_the_records_of_the_sensor(rdt: int, ft: int, counts: tuple) -> None:
    """Two authors of one format: bit for bit the same."""
    read = parse(record(rdt, ft, 0x80010000, counts))
    assert read is not None
    assert (read.rdt_sequence, read.ft_sequence, read.status) == (rdt, ft, 0x80010000)
    assert read.counts == counts


@given(st.integers(1, 30), st.integers(0, 40))
def test_a_number_of_records_is_that_number(count: int, samples: int) -> None:
    """Single records and short streams end by themselves; zero is without end."""
    sensor = NetftSensor()
    ask(sensor, 0x0002, count)
    assert numbers(sensor, samples) == list(range(1, min(count, samples) + 1))
    ask(sensor, 0x0002)
    assert numbers(sensor, 50) == list(range(1, 51))


@pytest.mark.parametrize(
    ("name", "word"),
    [("los", "1"), ("loss", "1.1"), ("loss", "nan"), ("stall", "2"), ("status", "-1"),
     ("status", "0x1ffffffff"), ("loss", "")],
)  # fmt: skip
def test_a_wrong_switch_is_refused_by_its_name(name: str, word: str) -> None:
    """And nothing is set."""
    with pytest.raises(ValueError, match=name):
        FaultSwitches().changed({"mute": "on", name: word})
