"""Readers distinguish two writers at once from one that was restarted, and disorder from order."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from forcemesh.faults import FAULTS
from tests.unit.forcemesh.conftest import STALE_S, Line

MS = 1_000_000
A, B = 1, 2  # two processes that write one topic
RESTART_S = 0.1  # two writers within this are two at once
CONFLICT_S = 1.0
BAD_MESSAGES = 5  # so many more bad ones than good ones are borne
MOST_RETIRED = 64  # former writers that are remembered


def pause_s(line: Line, duration_s: float) -> None:
    """Let time pass."""
    line.clock.advance_ns(round(duration_s * 1e9))


# --- two writers (H11) ----------------------------------------------------------------------------


def test_a_second_writer_is_detected_with_its_first_message(line: Line) -> None:
    """The first one has spoken a moment ago, and no process restarts as quickly as that."""
    line.deliver(1, epoch=A)
    line.clock.advance_ns(round(RESTART_S * 1e9) - 1)
    line.deliver(1, epoch=B)
    assert line.read().conflict
    assert line.reader.counters.overlaps == 1


def test_a_restarted_writer_is_no_conflict(line: Line) -> None:
    """Silence between the two distinguishes it from a second one; it is another writer anyway."""
    line.deliver(1, epoch=A)
    pause_s(line, RESTART_S)
    line.deliver(1, epoch=B)
    assert not line.read().conflict
    assert line.reader.counters.overlaps == 0


def test_a_writer_that_goes_on_after_it_was_followed_is_a_conflict(line: Line) -> None:
    """For example, it was frozen while another one took its place."""
    line.deliver(1, epoch=A)
    pause_s(line, 3.0)
    line.deliver(1, epoch=B)
    pause_s(line, 0.004)
    assert not line.deliver(2, epoch=A)
    assert line.read().conflict


def test_a_conflict_is_remembered_for_a_second_after_its_last_sign(line: Line) -> None:
    """No client may arm between two messages of the other writer."""
    line.deliver(1, epoch=A)
    line.deliver(1, epoch=B)
    line.clock.advance_ns(round(CONFLICT_S * 1e9) - 1)
    assert line.read().conflict
    line.clock.advance_ns(1)
    assert not line.read().conflict


@given(st.lists(st.integers(1, 60), min_size=1, max_size=30))
def test_two_writers_in_any_order_are_reported_within_two_periods(gaps_ms: list[int]) -> None:
    """Whatever the phase between them: the second check after the second one began finds it."""
    line = Line()
    line.deliver(1, epoch=A)
    for number, gap_ms in enumerate(gaps_ms, start=2):
        line.clock.advance_ns(gap_ms * MS)
        line.deliver(number, epoch=A if number % 2 else B)
        assert line.read().conflict


def test_of_many_former_writers_the_newest_are_never_accepted(line: Line) -> None:
    """The memory of them is bounded: a forgotten one is accepted, and is a second writer."""
    for epoch in range(1, 200):
        assert line.deliver(1, epoch=epoch)
    for epoch in range(200 - MOST_RETIRED, 199):
        assert not line.deliver(2, epoch=epoch)
    assert line.reader.counters.retired == MOST_RETIRED - 1
    assert line.deliver(7, epoch=1)
    assert line.read().conflict


# --- duplicated, reordered, spoilt (H14, H15) -----------------------------------------------------


def test_more_bad_messages_than_good_ones_are_a_fault(line: Line) -> None:
    """Exactly beyond the number that the counter allows; before it they are only dropped."""
    line.deliver(10)
    for _ in range(BAD_MESSAGES):
        line.deliver(9)
        assert line.read().fault == ""
    line.deliver(10)
    reading = line.read()
    assert (reading.code, reading.fresh) == ("bad_messages", None)
    assert "6 repeated" in reading.fault
    assert reading.code in FAULTS


def test_the_counter_saturates_so_that_order_comes_back(line: Line) -> None:
    """After any amount of rubbish a handful of good messages is enough, in time to be fresh."""
    line.deliver(1000)
    for _ in range(500):
        line.deliver(1)
    for seq in range(1001, 1001 + BAD_MESSAGES):
        assert line.read().code == "bad_messages"
        pause_s(line, STALE_S / 10)
        line.deliver(seq)
    assert line.read().fault == ""


@pytest.mark.parametrize(("strays", "code"), [(6, ""), (7, "bad_messages")])
def test_bad_messages_before_the_first_good_one_count_as_well(
    line: Line, strays: int, code: str
) -> None:
    """Six bad ones and a good one are five more: tolerated; one more of them is a fault."""
    for seq in range(strays):
        line.deliver(seq, topic="demo/wrench")
    assert line.read().code == "missing"
    line.deliver(1)
    assert line.read().code == code


def test_unreadable_bytes_count_as_bad(line: Line) -> None:
    """Between good messages they are forgotten one by one; in a row they are a fault."""
    for _ in range(BAD_MESSAGES + 2):
        line.deliver(1)
        line.source.waiting.append(b"\xc1")
        line.reader.poll()
    assert line.read().code == "undecodable"
    line.deliver(2)
    assert line.read().code == "bad_messages"
    assert "unreadable" in line.read().fault
