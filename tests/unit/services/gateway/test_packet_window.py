"""Packets in flight: numbers and IDs that wrap, round trips, rates, and bounded memory."""

import random
from collections import deque
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller import packet_table
from controller.packet_table import ID_FIRST, Com
from forcemesh.clock import NS_PER_S
from services.gateway.packet_window import (
    DROP_AFTER_S,
    MOST_IN_FLIGHT,
    MOST_TIMES,
    NONE_YET,
    PacketWindow,
    Rate,
    RoundTrips,
    WrappingCounterRate,
    id_of,
)
from tests.fakes.dialogues import (
    MS,
    NONE,
    SPEED,
    at,
    greeted,
    in_feedback,
    joint_report,
    last_id,
    pose_report,
)

RING = 200  # of IDs in these tests: the same arithmetic, through in a moment
delays = st.lists(st.integers(0, 2 * NS_PER_S), min_size=1, max_size=60)
firsts = st.integers(0, 3_000_000)


def consecutive(first: int, count: int) -> range:
    """Return the numbers of the packets in order."""
    return range(first, first + count)


@given(delays, firsts)
def test_percentiles_are_measured_times(delays_ns: list[int], first: int) -> None:
    """At least 50 and 99 % of the times are no longer, and fewer are shorter."""
    trips, now_ns = RoundTrips(), 0
    for id_, delay_ns in zip(consecutive(first, len(delays_ns)), delays_ns, strict=True):
        trips.sent(id_, now_ns)
        trips.reached(id_, now_ns + delay_ns)
    spread = trips.spread(now_ns)
    assert spread is not None
    count = len(delays_ns)
    for share, value_s in ((Fraction(1, 2), spread.p50_s), (Fraction(99, 100), spread.p99_s)):
        assert sum(d / NS_PER_S <= value_s for d in delays_ns) >= share * count
        assert sum(d / NS_PER_S < value_s for d in delays_ns) < share * count
    assert trips.last_s == delays_ns[-1] / NS_PER_S


@given(firsts, st.integers(1, 40), st.data())
def test_an_echo_confirms_all_packets_before_it(
    first: int, count: int, data: st.DataObject
) -> None:
    """Later packets are still in flight; confirmed ones do not count again."""
    trips, ids = RoundTrips(), consecutive(first, count)
    for k, id_ in enumerate(ids):
        trips.sent(id_, k * MS)
    reached = data.draw(st.integers(0, count - 1))
    at_ns = count * MS
    for _ in range(2):
        trips.reached(ids[reached], at_ns)
    assert len(trips._times) == reached + 1
    assert trips.last_s == pytest.approx((at_ns - reached * MS) / NS_PER_S)
    trips.reached(ids[-1], at_ns)
    assert len(trips._times) == count


def test_old_times_are_dropped() -> None:
    """Times from a minute ago do not count."""
    trips = RoundTrips()
    trips.sent(1, 0)
    trips.reached(1, MS)
    after_ns = MS + round(DROP_AFTER_S * NS_PER_S)
    assert trips.spread(after_ns) is not None
    assert trips.spread(after_ns + 1) is None


def test_memory_is_bounded_and_the_oldest_are_timed() -> None:
    """A controller without echoes costs no memory; its first echo gives the longest time."""
    trips = RoundTrips()
    for id_ in range(1, 10 * MOST_IN_FLIGHT):
        trips.sent(id_, id_ * MS)
    trips.reached(1, NS_PER_S)
    assert trips.last_s == pytest.approx(0.999)
    for id_ in range(1, 10 * MOST_TIMES):
        trips.sent(id_, 0)
        trips.reached(id_, 0)
    assert len(trips.in_flight) + len(trips._times) <= MOST_IN_FLIGHT + MOST_TIMES


def test_a_dialogue_times_both_echoes_of_its_packets() -> None:
    """102 names the framed, 101 the taken packet; a hold voids the untaken ones."""
    dialogue = greeted()
    dialogue.feed(joint_report(last_id(dialogue)), MS)
    dialogue.move_to_pose(at(1), SPEED, 10 * MS)
    dialogue.feed(joint_report(last_id(dialogue)) + pose_report(last_id(dialogue)), 14 * MS)
    assert dialogue.window.receipts.last_s == pytest.approx(0.004)
    assert dialogue.window.executions.last_s == pytest.approx(0.004)
    dialogue.move_to_pose(at(2), SPEED, 20 * MS)
    dialogue.hold(21 * MS)
    dialogue.move_to_pose(at(3), SPEED, 30 * MS)
    dialogue.feed(pose_report(last_id(dialogue)), 37 * MS)
    assert dialogue.window.executions.last_s == pytest.approx(0.007)
    taken = [took for _, took in dialogue.window.executions._times]
    assert taken == [4 * MS] * 2 + [7 * MS]


def test_wrenches_and_heartbeats_are_framed_only_and_a_new_connection_starts_empty() -> None:
    """Command 4 has one echo; the next connection has no times of this one."""
    dialogue = in_feedback()
    taken = dialogue.window.executions.spread(0)
    dialogue.offer_wrench((1.0, 0.0, 0.0), NONE, NONE)
    data = dialogue.tick(5 * MS, permitted=True)
    assert data[7:14] == b"000004 "
    dialogue.feed(joint_report(last_id(dialogue)) + pose_report(last_id(dialogue)), 7 * MS)
    assert dialogue.window.receipts.last_s == pytest.approx(0.002)
    assert dialogue.window.executions.spread(7 * MS) == taken
    dialogue.connected(8 * MS)
    assert dialogue.window.receipts.spread(8 * MS) is None


rates = st.floats(5.0, 1000.0)


@given(rates, st.floats(1.0, 20.0))
def test_a_steady_rate_is_found_to_one_event(rate_hz: float, duration_s: float) -> None:
    """The count is exact for any duration and rate, with memory for a few marks."""
    rate, count = Rate(), 0
    while count / rate_hz <= duration_s:
        rate.count(1, round(count / rate_hz * NS_PER_S))
        count += 1
    now_ns = round(duration_s * NS_PER_S)
    found = rate.hz(now_ns)
    assert found is not None
    assert found == pytest.approx(rate_hz, abs=1.001 / min(duration_s, 4.0))
    assert len(rate._marks) <= 40


def test_a_change_of_rate_shows_within_the_window() -> None:
    """Half a minute of 100/s does not hide the present 10/s, and silence becomes zero."""
    rate = Rate()
    times = [k * 10 * MS for k in range(3000)] + [30 * NS_PER_S + k * 100 * MS for k in range(60)]
    for at_ns in times:
        rate.count(1, at_ns)
    assert rate.hz(36 * NS_PER_S) == pytest.approx(10.0, abs=0.3)
    assert rate.hz(50 * NS_PER_S) == 0.0


@given(st.integers(0, 999_999), st.lists(st.integers(0, 400), min_size=20, max_size=40))
def test_a_wrapping_counter_is_followed(start: int, steps: list[int]) -> None:
    """Only the differences count, modulo the counter's span."""
    turns, value = WrappingCounterRate(1_000_000), start
    for k, step in enumerate(steps):
        value = (value + (step if k else 0)) % 1_000_000
        turns.read(value, k * 100 * MS)
    now_ns = (len(steps) - 1) * 100 * MS
    assert turns.hz(now_ns) == pytest.approx(sum(steps[1:]) / (now_ns / NS_PER_S))


@pytest.fixture
def _small_ring(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(packet_table, "ID_COUNT", RING)


def begun(start: int = 0) -> PacketWindow:
    """Return the window of a connection whose hello has been echoed."""
    window = PacketWindow(ID_FIRST + start)
    window.begin()
    window.sent(Com.HELLO, 0, 0, streamed=False)
    window.framed_up_to(id_of(window.last), 0)
    window.taken_up_to(id_of(window.last), 0)
    return window


@pytest.mark.usefixtures("_small_ring")
@pytest.mark.parametrize("start", [0, 1, 99, 100, 198, 199])
def test_ids_wrap_many_times_without_effect(start: int) -> None:
    """A dozen rings of set points and wrenches; each echo denotes the packet that was sent."""
    rng, window, pending = random.Random(start), begun(start), deque[int]()
    framed = taken = window.last
    while window.last < 12 * RING:
        is_set_point = rng.random() < 0.5 and window.last - taken < RING - 1
        if window.last - framed < RING - 1:
            com = Com.SET_POINT if is_set_point else Com.WRENCH
            window.sent(com, 0, 0, streamed=is_set_point)
            pending += [window.last] * is_set_point
        if rng.random() < 0.5:
            framed = rng.randint(framed, window.last)
            window.framed_up_to(id_of(framed), 0)
            assert window.number_of(id_of(framed)) == framed
        if pending and pending[0] <= framed and rng.random() < 0.7:
            taken = pending.popleft()
        window.taken_up_to(id_of(taken), 0)
        assert (window.framed, window.taken) == (framed, taken)
        assert window.unacknowledged == window.last - framed
        assert window.unexecuted == len(pending)


@pytest.mark.usefixtures("_small_ring")
@pytest.mark.parametrize("beats", range(0, 2 * RING + 50, 23))
def test_a_packet_is_not_executed_early_after_any_number_of_heartbeats(beats: int) -> None:
    """The last one executed may be more than a ring of packets old."""
    window = begun()
    taken = id_of(window.last)
    for _ in range(beats):
        window.sent(Com.HEARTBEAT, 0, 0, streamed=False)
        window.framed_up_to(id_of(window.last), 0)
        window.taken_up_to(taken, 0)
    window.sent(Com.SET_POINT, 0, 0, streamed=True)
    window.taken_up_to(taken, 0)
    assert window.unexecuted == 1
    window.taken_up_to(id_of(window.last), 0)
    assert (window.unexecuted, window.taken) == (0, window.last)


def test_ids_of_an_earlier_connection_do_not_count() -> None:
    """A controller that still reports an old ID has executed none of the new packets."""
    window = begun(500)
    window.begin()
    window.sent(Com.HELLO, 0, 0, streamed=False)
    window.sent(Com.SET_POINT, 0, 0, streamed=True)
    for stale in (window.last - 3, window.last - 2, window.last + 1):
        window.taken_up_to(id_of(stale), 0)
        assert (window.unexecuted, window.taken) == (1, NONE_YET)
    window.taken_up_to(id_of(window.last - 1), 0)  # the hello itself
    assert window.unexecuted == 1
