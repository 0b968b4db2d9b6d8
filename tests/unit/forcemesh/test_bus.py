"""Readers judge, counters count, roles are kept: the bus as services see it, in memory."""

from contextlib import AbstractContextManager, nullcontext

import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.bus.memory_bus import MemoryCall, MemoryTransport
from forcemesh import requests as q
from forcemesh import topics
from forcemesh.bus import Bus, Origin
from forcemesh.clock import ManualClock
from forcemesh.codec import decode_record, encode
from forcemesh.errors import BusError
from forcemesh.messages import SensorWrench, WrenchAtTcp
from forcemesh.topics import CLIENT, HELPERS, REQUESTS, ROLES, TOPICS
from tests.fakes.bench import CELL
from tests.fakes.records import full
from tests.unit.forcemesh.conftest import STALE_S, Line
from tests.unit.forcemesh.test_inbox import bus_of

MS = 1_000_000
LONGEST_REASON = "y" * 500

each_role = pytest.mark.parametrize("role", [*ROLES, *HELPERS, CLIENT, "unknown"])


# --- missing, invalid, stale ----------------------------------------------------------------------


def test_no_message_is_missing(line: Line) -> None:
    """The fault names the topic; there is no message to use by mistake."""
    reading = line.read()

    assert reading.fault == "sensor/wrench missing"
    assert (reading.message, reading.fresh, reading.origin) == (None, None, None)
    assert (reading.silent, reading.conflict, reading.code) == (True, False, "missing")
    assert reading.age_s == float("inf")


def test_a_message_is_good_up_to_the_last_nanosecond_and_stale_after_it(line: Line) -> None:
    """The boundary is exact, and the fault has both numbers."""
    line.deliver(1)
    line.clock.advance_ns(round(STALE_S * 1e9))
    good = line.read()
    assert good.fresh == SensorWrench(counter=1)
    assert (good.fault, good.silent, good.conflict, good.code) == ("", False, False, "")

    line.clock.advance_ns(1)
    reading = line.read()
    assert reading.fault == "sensor/wrench stale: 100 ms old, limit 100 ms"
    assert (reading.silent, reading.fresh) == (True, None)
    assert reading.message == SensorWrench(counter=1)


def test_a_message_that_the_writer_marks_invalid_is_a_fault_with_its_reason(line: Line) -> None:
    """Invalid and fresh: the reason is passed on; without one the reader reports that."""
    line.deliver(1, SensorWrench(valid=False, reason="no cable", code="sensor_silent"))
    reading = line.read()
    assert reading.fault == "sensor/wrench invalid: no cable"
    assert (reading.silent, reading.code) == (False, "sensor_silent")

    line.deliver(2, SensorWrench(valid=False))
    reading = line.read()
    assert reading.fault == "sensor/wrench invalid: no reason given"
    assert (reading.fresh, reading.code) == (None, "invalid")


def test_a_fault_can_be_passed_on_however_long_the_reason_was(line: Line) -> None:
    """Each hop puts its own words before the reason; the text must still fit a message."""
    line.deliver(1, SensorWrench(valid=False, reason=LONGEST_REASON))
    assert len(line.read().fault) == 400
    passed_on = WrenchAtTcp(valid=False, reason=line.read().fault)

    assert passed_on.reason.startswith("sensor/wrench invalid: yyy")


def test_a_message_that_waited_through_a_freeze_is_stale_when_it_is_found(line: Line) -> None:
    """One clock: age counts from the writer's stamp, not from when the reader woke up."""
    line.source.waiting.append(encode(line.header(1), SensorWrench()))
    line.clock.advance_ns(500 * MS)

    reading = line.read()
    assert reading.age_s == pytest.approx(0.5)
    assert reading.fault.startswith("sensor/wrench stale: 500 ms")


def test_a_stamp_of_another_clock_is_not_subtracted(line: Line) -> None:
    """From another host age counts since arrival, whatever its stamp is."""
    for seq, stamp_ns in enumerate((0, 10**18, -5), start=1):
        line.deliver(seq, boot="another host", stamp_ns=stamp_ns)
        line.clock.advance_ns(20 * MS)
        assert line.read().age_s == pytest.approx(0.02)


def test_a_stamp_from_the_future_does_not_keep_a_message_fresh(line: Line) -> None:
    """On the own clock too, age counts at least since arrival."""
    line.deliver(1, stamp_ns=line.clock.now_ns() + 10**12)
    line.clock.advance_ns(round(STALE_S * 1e9) + 1)

    assert "stale" in line.read().fault


def test_the_sensor_sample_behind_a_message_is_carried(line: Line) -> None:
    """Stamp and number of the sample; a writer that does not number them has zero; or nothing."""
    line.deliver(1, sensor_stamp_ns=123, sensor_seq=7)
    assert line.read().origin == Origin(123, 7)
    line.deliver(2, sensor_stamp_ns=124)
    assert line.read().origin == Origin(124, 0)
    line.deliver(3)
    assert line.read().origin is None


# --- what is accepted, what is counted ------------------------------------------------------------


@given(st.lists(st.integers(1, 30), max_size=40))
def test_exactly_the_left_to_right_maxima_are_accepted(seqs: list[int]) -> None:
    """Any order, any repetition of a stream: only messages newer than all before."""
    line = Line()
    accepted = [seq for seq in seqs if line.deliver(seq)]

    maxima = [seq for i, seq in enumerate(seqs) if seq > max(seqs[:i], default=0)]
    counters = line.reader.counters
    assert accepted == maxima
    assert counters.received == len(maxima)
    assert counters.repeated == len(seqs) - len(maxima)
    assert counters.superseded == (maxima[-1] - maxima[0] + 1 - len(maxima) if maxima else 0)
    assert line.read().message == (SensorWrench(counter=maxima[-1]) if maxima else None)


@given(st.lists(st.tuples(st.integers(0, 4), st.integers(1, 9)), max_size=40))
def test_a_replaced_writer_is_never_accepted_again(messages: list[tuple[int, int]]) -> None:
    """A new epoch takes over and the old one is retired: two writers do not alternate."""
    line = Line()
    current: int | None = None
    retired: set[int] = set()
    newest, dropped = 0, 0
    for epoch, seq in messages:
        accepted = line.deliver(seq, epoch=epoch)
        if epoch in retired:
            dropped += 1
            assert not accepted
        elif epoch != current:
            retired |= set() if current is None else {current}
            current, newest = epoch, seq
            assert accepted
        else:
            assert accepted == (seq > newest)
            newest = max(newest, seq)
    assert line.reader.counters.retired == dropped


@given(st.binary(max_size=80))
def test_bytes_that_are_no_message_are_unknown_until_the_next_good_one(data: bytes) -> None:
    """Neither the message before nor zero: a fault with its own code, counted."""
    line = Line()
    line.deliver(1)
    line.source.waiting.append(data)
    assert not line.reader.poll()
    reading = line.read()
    assert (reading.fresh, reading.code) == (None, "undecodable")
    assert reading.fault.startswith("sensor/wrench unreadable: ")
    assert line.reader.counters.undecodable == 1
    assert line.reader.counters.last_error
    assert line.deliver(2)
    assert line.read().fresh is not None


# --- roles ----------------------------------------------------------------------------------------


def granted(is_granted: bool, refusal: str) -> AbstractContextManager[object]:
    """Expect a refusal, or none."""
    return nullcontext() if is_granted else pytest.raises(BusError, match=refusal)


@each_role
def test_the_tables_alone_decide_which_role_may_do_what(role: str) -> None:
    """Swept: every role with every topic and request; a refusal names the right role."""
    bus = bus_of(role)
    for topic in TOPICS:
        with granted(topic.writer == role, f"{role} may not write {topic.key}: {topic.writer}"):
            bus.publisher(topic)
        with granted(role in topic.readers, f"{role} is not a reader of {topic.key}"):
            assert bus.reader(topic).stale_after_s == CELL.stale_after_s(topic)
    for row in REQUESTS:
        with granted(row.server == role, f"{role} does not serve {row.key}: {row.server}"):
            bus.inbox(row)
        with granted(False, "did not answer" if role == CLIENT else "only clients send requests"):
            bus.ask(row, row.message.from_dict(full(row.message)))
    with granted(role in (CLIENT, *HELPERS), f"{role} may not tap wrench"):
        bus.tap(topics.WRENCH, 3)


@pytest.mark.parametrize("room", [1, 3])
def test_a_tap_hands_out_the_newest_messages_in_their_order(room: int) -> None:
    """As many as there is room for, the oldest of them first."""
    transport = MemoryTransport()
    source = bus_of(CLIENT, transport).tap(topics.WRENCH, room)
    put = transport.publish("demo/wrench", "stream")
    for number in range(5):
        put(bytes([number]))
    newest = [bytes([number]) for number in range(5)][-room:]
    assert [source.take() for _ in range(room + 1)] == [*newest, None]


@pytest.mark.parametrize("polled", [False, True])
@given(counts=st.lists(st.integers(0, 5), max_size=6))
def test_a_queue_is_read_message_by_message(polled: bool, counts: list[int]) -> None:
    """Each as far as there was room; the last one again when nothing is new."""
    transport, clock, room = MemoryTransport(), ManualClock(), 3
    publisher = Bus("wrench", "demo", transport, CELL, clock).publisher(topics.WRENCH)
    reader = Bus(CLIENT, "demo", transport, CELL, clock).reader(topics.WRENCH, room)
    read, last = list[int | None](), None
    for count in counts:
        for _ in range(count):
            publisher.put(topics.WRENCH.message())
        assert not polled or reader.poll() == (count > 0)  # as a trigger does
        headers = [each.header for each in reader.readings(clock.now_ns())]
        read = [None if header is None else header.seq for header in headers]
        newest = [*range(publisher.seq - min(count, room) + 1, publisher.seq + 1)]
        assert read == (newest or [last])
        last = read[-1]


# --- another cell ---------------------------------------------------------------------------------


@pytest.mark.parametrize("topic", topics.TOPICS, ids=lambda topic: topic.key)
def test_a_message_of_another_cell_is_dropped(topic):
    """The bytes of one cell, delivered to the same topic of the next one, move nothing there."""
    cell, transport, clock = CELL, MemoryTransport(), ManualClock()
    delivered = transport.subscribe(f"left/{topic.key}")
    Bus(topic.writer, "left", transport, cell, clock).publisher(topic).put(topic.message())
    reader = Bus(topic.readers[0], "right", transport, cell, clock).reader(topic)
    data = delivered.take()
    assert data is not None
    transport.publish(f"right/{topic.key}", topic.qos)(data)
    assert not reader.poll()
    assert reader.counters.misrouted == 1
    assert "addressed to 'left/" in reader.counters.last_error


@pytest.mark.parametrize("request_row", topics.REQUESTS, ids=lambda request: request.key)
def test_a_request_to_another_cell_is_refused(request_row):
    """A request to one cell is not executed by the next one."""
    cell, transport, clock = CELL, MemoryTransport(), ManualClock()
    asked = request_row.message.from_dict(full(request_row.message))
    sent = []

    def deliver(_timeout_s, _until):
        call = transport.serve(f"left/{request_row.key}").take()
        assert call is not None
        sent.append(call.data)

    transport.advance = deliver
    transport.serve(f"left/{request_row.key}")
    with pytest.raises(BusError):  # no one answers: the bytes are what counts
        Bus(topics.CLIENT, "left", transport, cell, clock).ask(request_row, asked)
    inbox = Bus(request_row.server, "right", transport, cell, clock).inbox(request_row)
    call = MemoryCall(sent[0])
    transport.serve(f"right/{request_row.key}").waiting.append(call)
    for incoming in inbox.take_all():  # a hold is taken from any client, and reported
        assert request_row in (topics.HOLD, topics.FORCE_STOP)
        incoming.reply(q.Reply(accepted=True))
    assert call.reply is not None
    assert "addressed to 'left/" in decode_record(call.reply, q.Reply).text
