"""Overruns of a loop: counted over a second, judged by the cell's deadlines."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.bus.memory_bus import MemoryTransport
from common.runtime.overruns import Overruns, allowed_gap_s
from forcemesh import topics
from forcemesh.clock import ManualClock
from forcemesh.messages import Health
from forcemesh.topics import ROLES
from tests.fakes.bench import CELL
from tests.unit.common.runtime.test_service import Reported, SlowWorker

MS = 1_000_000
ALLOWED_S = 0.02


@given(st.lists(st.integers(1, 60), min_size=1, max_size=200))
def test_the_count_is_that_of_the_long_gaps_of_the_last_second(gaps_ms: list[int]) -> None:
    """Against the plain definition, at every step; a loop that has just begun missed nothing."""
    overruns, now_ns, steps = Overruns(ALLOWED_S), 10**15, []
    assert (overruns.count, overruns.longest_s) == (0, 0.0)
    overruns.stepped(now_ns)
    assert (overruns.count, overruns.longest_s) == (0, 0.0)
    for gap_ms in gaps_ms:
        now_ns += gap_ms * MS
        steps.append((now_ns, gap_ms / 1e3))
        overruns.stepped(now_ns)
        recent = [gap_s for at_ns, gap_s in steps if now_ns - at_ns <= 1000 * MS]
        assert overruns.count == sum(gap_s > ALLOWED_S for gap_s in recent)
        assert overruns.longest_s == pytest.approx(max(recent))


@pytest.mark.parametrize("role", ROLES)
def test_every_loop_that_publishes_a_stream_may_miss_a_period_and_no_deadline(
    role: str,
) -> None:
    """At least two periods, less than its topic's deadline; the hub streams nothing."""
    allowed_s = allowed_gap_s(CELL, role)
    streams = [t for t in topics.TOPICS if t.writer == role and t.qos == "stream"]
    assert (allowed_s is None) == (not streams)
    for topic in streams:
        assert allowed_s is not None
        assert 2.0 / CELL.rate_hz(topic) <= allowed_s < CELL.stale_after_s(topic)


def test_health_reports_overruns_and_the_longest_gap() -> None:
    """From the loop that does the work, not from a thread next to it."""
    clock = ManualClock()
    worker = SlowWorker(clock, period_s=0.004)
    reported = Reported(worker, clock, MemoryTransport())

    def report_after_2_s(busy_s: float) -> Health:
        worker.busy_s, end_ns = busy_s, clock.now_ns() + 2000 * MS
        while clock.now_ns() < end_ns:
            reported.after(0.001)
        return reported.after(0.0)

    report = report_after_2_s(busy_s=0.0)
    assert (report.overruns, report.longest_gap_s) == (0, pytest.approx(0.004, abs=0.0011))
    report = report_after_2_s(busy_s=0.08)
    assert report.overruns == pytest.approx(12, abs=1)
    assert report.longest_gap_s == pytest.approx(0.081, abs=0.002)
    assert report_after_2_s(busy_s=0.0).overruns == 0
