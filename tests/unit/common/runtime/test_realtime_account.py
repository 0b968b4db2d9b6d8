"""Why a step was late: from the processor time of its thread and the kernel's count of waiting."""

import time
from pathlib import Path

import pytest

from common.runtime import realtime
from common.runtime.realtime import OTHERS, OWN_WORK, REALTIME, STOPPED, ProcessorAccount

GAP_S = 0.04


@pytest.fixture
def schedstat(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The kernel's count, with 5 s of waiting so far."""
    path = tmp_path / "schedstat"
    path.write_text("77 5000000000 9\n")
    monkeypatch.setattr(realtime, "SCHEDSTAT", path)
    return path


def work(duration_s: float) -> None:
    """Use the processor for a time."""
    end_s = time.thread_time() + duration_s
    while time.thread_time() < end_s:
        pass


def test_a_long_step_is_its_own_cause(schedstat: Path) -> None:
    """Also while it waited for a processor in between."""
    found = ProcessorAccount()
    work(GAP_S)
    found.stepped()
    schedstat.write_text("77 5039000000 9\n")
    assert found.cause_of(GAP_S) == OWN_WORK


@pytest.mark.parametrize(("is_realtime", "cause"), [(False, OTHERS), (True, REALTIME)])
def test_waiting_for_a_processor_is_the_work_of_others(
    schedstat: Path, monkeypatch: pytest.MonkeyPatch, *, is_realtime: bool, cause: str
) -> None:
    """With real-time priority only other real-time work, or the kernel's limit, can be it."""
    monkeypatch.setattr(realtime, "has_realtime_priority", lambda: is_realtime)
    found = ProcessorAccount()
    found.stepped()
    found.stepped()
    schedstat.write_text("77 5030000000 9\n")
    assert found.cause_of(GAP_S) == cause
    found.fraction()  # waiting before the last health is not of this gap
    assert found.cause_of(GAP_S) == STOPPED


@pytest.mark.parametrize("text", ["77 5001000000 9\n", "", "no numbers"])
def test_what_neither_ran_nor_waited_was_stopped(schedstat: Path, text: str) -> None:
    """A frozen process; the same where the kernel does not count."""
    found = ProcessorAccount()
    found.stepped()
    found.stepped()
    schedstat.write_text(text)
    assert found.cause_of(GAP_S) == STOPPED


def test_the_share_is_that_of_the_whole_process_since_the_last_call() -> None:
    """Processor time over elapsed time."""
    since_s = time.monotonic()  # before the account's own start: a wait in between only adds to it
    found = ProcessorAccount()
    work(0.05)
    share = found.fraction()
    assert share * (time.monotonic() - since_s) >= 0.05
    time.sleep(0.05)
    assert found.fraction() < share
