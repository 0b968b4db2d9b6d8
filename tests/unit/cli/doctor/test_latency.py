"""Wake-up latency of the cores: what is measured, and what is said about it."""

import multiprocessing as mp
import os
import threading

import pytest

from cli.doctor import latency
from cli.doctor.checks import ReportLine
from cli.doctor.latency import CoreLatency, LatencyCause, check_latency, latency_lines
from cli.doctor.remedies import REMEDIES
from tests.fakes.bench import CELL

PERIOD_S, DEADLINE_S = 0.004, 0.02


def line_of(
    longest_s: float, *, cause: LatencyCause = "the core", is_realtime: bool = True
) -> ReportLine:
    """Return the line on a core whose longest latency this was."""
    late_s = (*[50e-6] * 999, longest_s)
    found = CoreLatency(3, late_s, is_realtime, cause)
    return check_latency(found, period_s=PERIOD_S, deadline_s=DEADLINE_S)


@pytest.mark.parametrize(
    ("longest_s", "result"),
    [(0.0039, "PASS"), (0.0041, "WARN"), (0.0199, "WARN"), (0.0201, "FAIL")],
)
def test_a_core_is_judged_by_its_longest_latency(longest_s: float, result: str) -> None:
    """Within a control period nothing is lost; beyond a deadline the arm holds."""
    line = line_of(longest_s)
    assert (line.check, line.result) == ("latency, core 3", result)
    assert f"{1e6 * longest_s:.0f} at most" in line.found
    assert line.remedy == ("" if result == "PASS" else REMEDIES["latency"])
    assert "1000 wake-ups with SCHED_FIFO 20: 50 us late at the median" in line.found
    assert "with ordinary priority" in line_of(longest_s, is_realtime=False).found
    assert ("the core itself did not run" in line.found) == (result != "PASS")
    other = line_of(longest_s, cause="other work").found
    assert ("other work on this core" in other) == (result != "PASS")


@pytest.mark.realtime
@pytest.mark.processes
def test_each_core_is_measured_in_a_process_of_its_own() -> None:
    """One line for each core that this process may use; nearly every millisecond is measured."""
    lines = latency_lines(CELL, 0.3)
    cores = sorted(os.sched_getaffinity(0))
    assert [line.check for line in lines] == [f"latency, core {core}" for core in cores]
    for line in lines:
        assert 1 <= int(line.found.split()[0]) <= 301


def measured(duration_s: float) -> CoreLatency:
    """Measure one core in a thread of this process, which keeps its affinity and priority."""
    receiver, sender = mp.Pipe(duplex=False)
    core = min(os.sched_getaffinity(0))
    thread = threading.Thread(target=latency._measure, args=(core, duration_s, sender))
    thread.start()
    found = receiver.recv()
    thread.join()
    return found


@pytest.fixture
def _harmless(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave priority, memory and garbage collection of the tests as they are."""
    monkeypatch.setattr(latency, "lock_memory", lambda: False)
    monkeypatch.setattr(latency, "take_realtime_priority", lambda: False)
    monkeypatch.setattr("gc.disable", lambda: None)


@pytest.mark.usefixtures("_harmless")
@pytest.mark.parametrize(("waited", "cause"), [(True, "other work"), (False, "the core")])
def test_the_cause_of_the_longest_latency(
    monkeypatch: pytest.MonkeyPatch, waited: bool, cause: str
) -> None:
    """The kernel counts what a thread waits for a processor; nothing waited: no other work ran."""
    clock_ns, account_ns = [0], [0]

    def sleep(duration_s: float) -> None:
        late_ns = 30_000_000 if 40_000_000 < clock_ns[0] < 42_000_000 else 20_000
        clock_ns[0] += round(duration_s * 1e9) + late_ns
        account_ns[0] += late_ns if waited else 0

    monkeypatch.setattr("time.sleep", sleep)
    monkeypatch.setattr("time.monotonic_ns", lambda: clock_ns[0])
    monkeypatch.setattr(latency, "waited_ns", lambda: account_ns[0])
    found = measured(0.1)
    assert max(found.late_s) == pytest.approx(0.03)
    assert len(found.late_s) == 100 - 29  # what is over is not measured late again
    assert found.cause == cause
