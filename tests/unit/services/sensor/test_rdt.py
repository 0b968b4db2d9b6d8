"""RDT without a socket: bytes, counts, and the sequence of a stream."""

import math
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.config.cell_sensor import SensorSection
from common.config.cell_terms import FrameSection
from services.sensor.driver import NO_FAULT
from services.sensor.rdt import (
    FROZEN_AFTER_NS,
    FROZEN_RECORDS,
    JUMP,
    LATE_WINDOW,
    RECORD,
    SEQUENCES,
    RdtCommand,
    RdtRecord,
    RdtStream,
    RecordKind,
    parse,
    request,
    sample_of,
)
from services.sensor.rdt_status import MONITOR_CONDITIONS, NAMES

SCALE = SensorSection(
    T_flange_sensor=FrameSection(position_m=(0.0, 0.0, 0.0)),
    counts_per_N=10_000,
    counts_per_Nm=100_000,
    force_range_N=200,
    torque_range_Nm=8,
)
PERIOD_NS = 2_000_000

uint32 = st.integers(0, SEQUENCES - 1)


def record(
    number: int, *, ft: int | None = None, counts: tuple[int, ...] | None = None
) -> RdtRecord:
    """Return the record at a place of the stream; its noise differs between places."""
    noise = counts or (number % 97, -(number % 89), 7, 1, -2, 3)
    ft_sequence = 14 * number if ft is None else ft
    return RdtRecord(number % SEQUENCES, ft_sequence % SEQUENCES, 0, noise)


def follow_all(
    records: list[RdtRecord], stream: RdtStream | None = None
) -> tuple[RdtStream, list[RecordKind]]:
    """Take the records, one in each period."""
    stream = stream or RdtStream()
    return stream, [stream.follow(item, at * PERIOD_NS) for at, item in enumerate(records)]


# --- bytes ----------------------------------------------------------------------------------------


def test_requests_and_records_are_the_bytes_of_the_manual() -> None:
    """Header 0x1234, command, count 0 for endless; three numbers and six counts, big endian."""
    assert request(RdtCommand.START) == bytes.fromhex("1234 0002 00000000")
    assert request(RdtCommand.STOP) == bytes.fromhex("1234 0000 00000000")
    data = bytes.fromhex("00000001 0000000e 80010000 00000064 ffffff9c 7fffffff 80000000 00000000")
    expected = (100, -100, 2**31 - 1, -(2**31), 0, -1)
    assert parse(data + b"\xff\xff\xff\xff") == RdtRecord(1, 14, MONITOR_CONDITIONS[0], expected)


@given(st.binary(max_size=80).filter(lambda data: len(data) != RECORD.size))
def test_datagram_of_another_size_is_no_record(data: bytes) -> None:
    """A datagram is one record or none; it is never cut to fit."""
    assert parse(data) is None


# --- content of a record --------------------------------------------------------------------------


NEAR_HARMLESS = [0x8000_0000, 0x0001_0001, 0x8001_0001, 0x8003_0000, 1, *MONITOR_CONDITIONS, 0]


@given(uint32 | st.sampled_from(NEAR_HARMLESS))
def test_every_status_but_three_is_a_fault_without_numbers(status: int) -> None:
    """The harmless ones are whole words; any other is shown in hexadecimal, its bits by name."""
    sample = sample_of(RdtRecord(1, 1, status, (10_000,) * 6), SCALE)
    if status in {0, *MONITOR_CONDITIONS}:
        assert sample.status == "ok"
        return
    assert sample.status == "fault"
    assert f"0x{status:08X}" in sample.reason
    assert sample.force_N == sample.torque_Nm == (0.0, 0.0, 0.0)
    for bit in (bit for bit in range(31) if status >> bit & 1):
        assert NAMES.get(bit, f"bit {bit}") in sample.reason


# --- sequences ------------------------------------------------------------------------------------


@given(uint32, st.integers(0, 2**32))
def test_disorder_within_the_window_is_classified_exactly(start: int, seed: int) -> None:
    """Each record of a shuffled stream with copies and losses is counted exactly once."""
    rng = random.Random(seed)
    length = 60
    came = [place for place in range(1, length) if rng.random() > 0.2]
    copies = [place for place in came if rng.random() < 0.2]
    tail = [*came, *copies]
    # A record is held back by a few places at most, as a network does it.
    tail.sort(key=lambda place: place + rng.uniform(0.0, 20.0))
    order = [0, *tail]
    stream, kinds = follow_all([record(start + place) for place in order])
    newest = max(order)
    assert stream.tally.duplicates == len(copies) == kinds.count("duplicate")
    assert stream.tally.lost == newest + 1 - len({*order})
    assert stream.tally.reordered == kinds.count("reordered")
    highest = [place for at, place in enumerate(order) if place > max(order[:at], default=-1)]
    assert kinds.count("sample") == len(highest)
    assert kinds.count("sample") + kinds.count("reordered") == len({*order})
    assert (stream.tally.restarts, stream.number) == (0, newest + 1)


@pytest.mark.parametrize(
    "records",
    [
        *([record(100_000 + back), record(100_000, ft=1)] for back in (LATE_WINDOW, 5_000, 2**31)),
        [record(5), record(1, ft=1_000)],  # near its old numbers: no copy has a later sample
        [record(1), record(1 + JUMP)],  # more than a second of records: no loss
    ],
)
def test_a_far_step_or_a_later_sample_is_a_restart_and_no_loss(records: list[RdtRecord]) -> None:
    """After a restart the sensor's first record is taken."""
    stream, kinds = follow_all(records)
    assert kinds == ["sample", "sample"]
    assert (stream.tally.restarts, stream.tally.lost) == (1, 0)


@pytest.mark.parametrize("axis", range(6))
@pytest.mark.parametrize("sign", [-1, 1])
def test_one_axis_at_95_percent_of_its_range_saturates_the_sample(axis: int, sign: int) -> None:
    """The numbers are kept; the reason names axis and range."""
    counts, value, limit = (1_900_000, 190.0, "200 N") if axis < 3 else (760_000, 7.6, "8 N m")
    read = tuple(sign * counts * (number == axis) for number in range(6))
    sample = sample_of(RdtRecord(1, 1, 0, read), SCALE)
    assert sample.status == "saturated"
    assert ["Fx", "Fy", "Fz", "Tx", "Ty", "Tz"][axis] in sample.reason
    assert limit in sample.reason
    assert (sample.force_N + sample.torque_Nm)[axis] == sign * value


@pytest.mark.parametrize(("count", "period_ns"), [(FROZEN_RECORDS, 10_000_000), (200, 1_000_000)])
def test_reading_without_noise_is_frozen(count: int, period_ns: int) -> None:
    """Six equal counts for the minimum time and number are frozen; one other count ends it."""
    stream, faults = RdtStream(), []
    for number in range(count):
        stream.follow(record(number, counts=(5,) * 6), number * period_ns)
        faults.append(stream.frozen_fault(number * period_ns).code)
    since = max(FROZEN_RECORDS - 1, math.ceil(FROZEN_AFTER_NS / period_ns))
    assert faults == ["" if place < since else "sensor_frozen" for place in range(count)]
    stream.follow(record(count, counts=(5, 5, 5, 5, 5, 6)), count * period_ns)
    assert stream.frozen_fault(count * period_ns) == NO_FAULT
