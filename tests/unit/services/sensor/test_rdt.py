"""RDT without a socket: bytes, counts, sequence numbers, and the samples that are published."""

import math
import random
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.config.cell_sensor import SensorSection
from common.config.cell_terms import FrameSection
from forcemesh.clock import NS_PER_S
from services.sensor.driver import NO_FAULT
from services.sensor.rdt import (
    FROZEN_AFTER_NS,
    FROZEN_RECORDS,
    JUMP,
    LATE_WINDOW,
    RECORD,
    SEQUENCES,
    Kind,
    RdtCommand,
    RdtRecord,
    RdtStream,
    parse,
    request,
    sample_of,
)
from services.sensor.rdt_status import MONITOR_CONDITIONS
from services.sensor.service import Decimation

SCALE = SensorSection(
    T_flange_sensor=FrameSection(position_m=(0.0, 0.0, 0.0)),
    counts_per_N=10_000,
    counts_per_Nm=100_000,
    force_range_N=200,
    torque_range_Nm=8,
)
PERIOD_NS = 2_000_000

uint32 = st.integers(0, SEQUENCES - 1)
int32 = st.integers(-(2**31), 2**31 - 1)


def record(
    number: int, *, ft: int | None = None, counts: tuple[int, ...] | None = None
) -> RdtRecord:
    """Return the record at a place of the stream; its noise differs between places."""
    noise = counts or (number % 97, -(number % 89), 7, 1, -2, 3)
    ft_sequence = 14 * number if ft is None else ft
    return RdtRecord(number % SEQUENCES, ft_sequence % SEQUENCES, 0, noise)


def follow_all(
    records: list[RdtRecord], stream: RdtStream | None = None
) -> tuple[RdtStream, list[Kind]]:
    """Take the records, one in each period."""
    stream = stream or RdtStream()
    kinds: list[Kind] = []
    for place, item in enumerate(records):
        kind = stream.follow(item, place * PERIOD_NS)
        kinds.append(kind)
    return stream, kinds


# --- bytes ----------------------------------------------------------------------------------------


def test_requests_are_the_bytes_of_the_manual() -> None:
    """Header 0x1234, command, count 0 for endless; big endian."""
    assert request(RdtCommand.START) == bytes.fromhex("1234 0002 00000000")
    assert request(RdtCommand.STOP) == bytes.fromhex("1234 0000 00000000")


def test_record_is_the_bytes_of_the_manual() -> None:
    """Three unsigned numbers, then six signed counts, big endian, 36 bytes."""
    data = bytes.fromhex("00000001 0000000e 80010000 00000064 ffffff9c 7fffffff 80000000 00000000")
    expected = (100, -100, 2**31 - 1, -(2**31), 0, -1)
    assert parse(data + b"\xff\xff\xff\xff") == RdtRecord(1, 14, MONITOR_CONDITIONS[0], expected)


@given(uint32, uint32, uint32, st.tuples(*[int32] * 6))
def test_every_record_is_read_back_as_it_was_sent(
    rdt: int, ft: int, status: int, counts: tuple[int, ...]
) -> None:
    """The parser treats no value of any field as special."""
    assert parse(RECORD.pack(rdt, ft, status, *counts)) == RdtRecord(rdt, ft, status, counts)


@given(st.binary(max_size=80).filter(lambda data: len(data) != RECORD.size))
def test_datagram_of_another_size_is_no_record(data: bytes) -> None:
    """A datagram is one record or none; it is never cut to fit."""
    assert parse(data) is None


# --- content of a record --------------------------------------------------------------------------


@given(st.tuples(*[st.integers(-1_899_999, 1_899_999)] * 3), st.tuples(*[int32] * 3))
def test_counts_become_newtons_and_newton_metres(
    force: tuple[int, ...], torque: tuple[int, ...]
) -> None:
    """SI = counts / (counts per unit), each axis on its own, sign kept."""
    torque = tuple(count % 1_519_999 - 759_999 for count in torque)
    sample = sample_of(RdtRecord(1, 1, 0, force + torque), SCALE)
    assert sample.status == "ok"
    assert sample.reason == ""
    assert sample.force_N == pytest.approx([count / 1e4 for count in force])
    assert sample.torque_Nm == pytest.approx([count / 1e5 for count in torque])


@pytest.mark.parametrize("axis", range(6))
@pytest.mark.parametrize("sign", [-1, 1])
def test_one_axis_at_95_percent_of_its_range_saturates_the_sample(axis: int, sign: int) -> None:
    """95 % of the range is saturated, one count below is not; the reason names axis and range."""
    limit = 1_900_000 if axis < 3 else 760_000
    at, below = [0] * 6, [0] * 6
    at[axis], below[axis] = sign * limit, sign * (limit - 1)
    saturated = sample_of(RdtRecord(1, 1, 0, tuple(at)), SCALE)
    assert saturated.status == "saturated"
    assert ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")[axis] in saturated.reason
    assert ("200 N" if axis < 3 else "8 N m") in saturated.reason
    assert (saturated.force_N + saturated.torque_Nm)[axis] == sign * (190.0 if axis < 3 else 7.6)
    assert sample_of(RdtRecord(1, 1, 0, tuple(below)), SCALE).status == "ok"


@given(uint32)
def test_every_status_but_two_is_a_fault_without_numbers(status: int) -> None:
    """Healthy and the user's threshold pass; an unknown bit is a fault."""
    sample = sample_of(RdtRecord(1, 1, status, (10_000,) * 6), SCALE)
    if status in {0, *MONITOR_CONDITIONS}:
        assert sample.status == "ok"
    else:
        assert sample.status == "fault"
        assert f"0x{status:08X}" in sample.reason
        assert sample.force_N == sample.torque_Nm == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("status", [0x8000_0000, 0x0001_0001, 0x8001_0001, 0x8003_0000, 1])
def test_status_next_to_the_harmless_one_is_a_fault(status: int) -> None:
    """The harmless status is one whole word; its single bits are faults."""
    assert sample_of(RdtRecord(1, 1, status, (0,) * 6), SCALE).status == "fault"


# --- sequences ------------------------------------------------------------------------------------


@given(uint32, st.integers(1, 200))
def test_whole_stream_is_all_samples(start: int, length: int) -> None:
    """A stream in order has no losses or restarts, also when its numbers wrap."""
    stream, kinds = follow_all([record(start + place) for place in range(length)])
    assert set(kinds) == {"sample"}
    assert stream.number == length
    assert stream.tally == replace(RdtStream().tally, records=length)


@given(uint32, st.lists(st.integers(1, JUMP - 1), min_size=1, max_size=20))
def test_gaps_are_counted_record_by_record(start: int, steps: list[int]) -> None:
    """The number of lost records is exact, and the number of the newest sample includes it."""
    places = [sum(steps[:end]) for end in range(len(steps) + 1)]
    stream, kinds = follow_all([record(start + place) for place in places])
    assert set(kinds) == {"sample"}
    assert stream.tally.lost == sum(step - 1 for step in steps)
    assert stream.number == 1 + sum(steps)


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
    assert kinds.count("sample") + kinds.count("reordered") == len({*order})
    assert stream.tally.restarts == 0
    assert stream.number == newest + 1


def test_only_the_newest_record_is_a_sample() -> None:
    """A record that arrives after a newer one is counted and gives no sample."""
    stream, kinds = follow_all([record(place) for place in (10, 13, 11, 11, 13, 12, 14)])
    expected = ["sample", "sample", "reordered", "duplicate", "duplicate", "reordered", "sample"]
    assert kinds == expected
    assert stream.tally.lost == 0


@pytest.mark.parametrize("back", [LATE_WINDOW, LATE_WINDOW + 1, 5_000, 2**31])
def test_far_step_back_is_a_restart(back: int) -> None:
    """After a restart the sensor's first record is taken."""
    stream, kinds = follow_all([record(100_000 + back), record(100_000, ft=1), record(100_001)])
    assert kinds == ["sample"] * 3
    assert (stream.tally.restarts, stream.tally.lost) == (1, 0)


def test_step_back_with_a_later_sample_is_a_restart() -> None:
    """A stream that restarts near its old numbers has later samples, which no copy has."""
    stream, kinds = follow_all([record(5), record(1, ft=1_000), record(2, ft=1_014)])
    assert kinds == ["sample"] * 3
    assert stream.tally.restarts == 1


def test_far_jump_ahead_is_a_restart_and_no_loss() -> None:
    """A jump of more than a second of records is a restart and not a loss."""
    stream, _ = follow_all([record(1), record(1 + JUMP)])
    assert (stream.tally.restarts, stream.tally.lost) == (1, 0)


def test_requested_stream_may_begin_anywhere() -> None:
    """A new stream begins at 1 again; that is no loss, no restart and no copy."""
    stream, _ = follow_all([record(place) for place in range(5, 10)])
    stream, kinds = follow_all([record(1), record(2)], replace(stream, newest=None))
    assert kinds == ["sample", "sample"]
    assert stream.number == 7
    assert stream.tally == replace(RdtStream().tally, records=7)


def test_repeated_sample_gives_no_sample() -> None:
    """Records with a constant ft_sequence are counted and give no sample."""
    stream, kinds = follow_all([record(1, ft=5), *(record(n, ft=5) for n in (2, 3)), record(4)])
    assert kinds == ["sample", "repeated", "repeated", "sample"]
    assert stream.tally.repeated == 2


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


def test_stalled_sensor_is_not_called_frozen() -> None:
    """Repeats of one sample are a stall, which has another cause than frozen readings."""
    repeats = [record(number, ft=5, counts=(5,) * 6) for number in range(100)]
    stream, _ = follow_all([*repeats, record(100, ft=6, counts=(5,) * 6)])
    assert stream.frozen_fault(101 * PERIOD_NS) == NO_FAULT


# --- decimation -----------------------------------------------------------------------------------


def kept_hz(rate_hz: float, target_hz: float, *, lose: float = 0.0) -> tuple[float, int]:
    """Return the kept samples per second and the divisor, once the rate is known."""
    rng = random.Random(1)
    state, kept = Decimation(target_hz), 0
    for number in range(int(3 * rate_hz)):
        if rng.random() < lose:
            continue
        is_kept = state.keeps(number, int(number * NS_PER_S / rate_hz))
        kept += is_kept and number >= rate_hz
    return kept / 2.0, state.keep_every


@given(st.floats(50.0, 1000.0), st.floats(0.1, 2.0))
def test_up_to_twice_the_target_rate_every_sample_is_kept(target: float, ratio: float) -> None:
    """The filter gets every sample that it can use."""
    rate_hz = max(20.0, target * ratio)
    if rate_hz <= 2.0 * target:
        kept, every = kept_hz(rate_hz, target)
        assert every == 1
        assert kept == pytest.approx(rate_hz, abs=2.0)


@pytest.mark.parametrize("rate_hz", [1250.0, 2000.0, 3500.0, 7000.0])
@pytest.mark.parametrize("lose", [0.0, 0.1])
def test_faster_sensor_is_decimated_to_about_the_target_rate(rate_hz: float, lose: float) -> None:
    """The nearest whole divisor is used; the next sample replaces a lost one."""
    kept, every = kept_hz(rate_hz, 500.0, lose=lose)
    assert every == round(rate_hz / 500.0)
    assert rate_hz / every * (1.0 - 0.6 * lose) <= kept <= rate_hz / every + 1.0


def test_pause_is_not_counted_as_a_low_rate() -> None:
    """After a gap the old divisor holds until the rate has been measured again."""
    state = Decimation(500.0)
    for number in range(7000):
        state.keeps(number, number * NS_PER_S // 7000)
    state.pause()
    for number in range(7000, 8000):
        state.keeps(number, 10 * NS_PER_S + number * NS_PER_S // 7000)
        assert state.keep_every == 14
