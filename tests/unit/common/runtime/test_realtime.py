"""Real time of a process: its priority, its memory, and the account of why a step was late."""

import ctypes
import gc
import os
import platform
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest

from common.bus.memory_bus import MemoryTransport
from common.runtime import realtime, service
from common.runtime.realtime import OTHERS, OWN_WORK, REALTIME, STOPPED, ProcessorAccount
from forcemesh.bus import Bus
from forcemesh.clock import ManualClock
from tests.fakes.bench import CELL

PRINTS_ITS_POLICIES = """
import os, threading
from pathlib import Path
from common.runtime.realtime import give_up_realtime_priority, take_realtime_priority

waits = threading.Event()
threading.Thread(target=waits.wait, daemon=True).start()
def policies():
    tasks = Path("/proc/self/task").iterdir()
    return sorted({os.sched_getscheduler(int(task.name)) for task in tasks})
print(take_realtime_priority(), policies())
give_up_realtime_priority()
print(policies())
"""


def printed_by(program: str, *words: str) -> list[str]:
    """Run a program in a process of its own; return the lines that it prints."""
    return subprocess.run(
        [sys.executable, "-c", program, *words],
        cwd=Path(__file__).parents[4],
        capture_output=True,
        text=True,
        check=True,
    ).stdout.splitlines()


def test_all_threads_go_first_or_the_machine_does_not_grant_it() -> None:
    """Also those that existed before; and none does any more once it is given up.

    Only root may leave idle priority, at which the pure tests begin.
    """
    before, found = os.sched_getscheduler(0), printed_by(PRINTS_ITS_POLICIES)
    assert found[0] in (f"True [{os.SCHED_FIFO}]", f"False [{before}]")
    stays_idle = found[0].startswith("False") and before == os.SCHED_IDLE
    assert found[1] == f"[{before if stays_idle else os.SCHED_OTHER}]"


def test_a_service_goes_first_only_while_it_works(monkeypatch: pytest.MonkeyPatch) -> None:
    """Starting and ending take tenths of a second, which loops that run already must not miss.

    First the memory of start-up, then the lock, and priority last: it would starve others.
    """
    order: list[str] = []

    @contextmanager
    def connect(_: object, role: str):
        try:
            yield Bus(role, CELL.cell, MemoryTransport(), CELL, ManualClock())
        finally:
            order.append("leaves the bus")

    class Worker:
        period_s, trigger, fault = 0.01, None, ""

        def step(self, now_ns: int) -> None:
            order.append("works")
            raise KeyboardInterrupt

        def counters(self) -> dict[str, int]:
            return {}

        def close(self) -> None:
            order.append("sends goodbye")

    def make(*_: object) -> Worker:
        order.append("is made")
        return Worker()

    for owner, name in (
        (gc, "collect"), (gc, "freeze"), (realtime, "lock_memory"),
        (realtime, "take_realtime_priority"), (service, "give_up_realtime_priority"),
    ):  # fmt: skip
        monkeypatch.setattr(owner, name, lambda name=name: order.append(name))
    monkeypatch.setattr(service, "cell_from_arguments", lambda _: CELL)
    with pytest.raises(KeyboardInterrupt):
        service.main("regulator", make, connect=connect)
    assert order == [
        "is made", "collect", "freeze", "lock_memory", "take_realtime_priority", "works",
        "sends goodbye", "give_up_realtime_priority", "leaves the bus",
    ]  # fmt: skip


def test_a_service_is_bound_to_the_cores_of_its_role(monkeypatch: pytest.MonkeyPatch) -> None:
    """Before it opens the bus, whose threads inherit them; without an entry, none."""
    order: list[object] = []

    @contextmanager
    def connect(_: object, role: str):
        order.append(role)
        raise KeyboardInterrupt
        yield

    cell = CELL.model_copy(update={"cores": {"arbiter": (1, 3)}})
    monkeypatch.setattr(service, "bind_to_cores", order.append)
    monkeypatch.setattr(service, "cell_from_arguments", lambda _: cell)
    for role in ("arbiter", "regulator"):
        with pytest.raises(KeyboardInterrupt):
            service.main(role, lambda *_: None, connect=connect)  # type: ignore[arg-type]
    assert order == [(1, 3), "arbiter", "regulator"]


# --- memory ---------------------------------------------------------------------------------------

LOCKS = """
import resource, sys
from pathlib import Path
if sys.argv[1] == "limited":
    resource.setrlimit(resource.RLIMIT_MEMLOCK, (65536, 65536))
from common.runtime import realtime
if sys.argv[1] == "limited":
    realtime._may_lock_without_limit = lambda: False
print(realtime.lock_memory(), realtime.is_memory_locked())
block = bytearray(50_000_000)  # a limit that is too small would end the process here
locked = [line for line in Path("/proc/self/status").read_text().splitlines() if "VmLck" in line]
print(int(locked[0].split()[1]) > 0)
"""


@pytest.mark.parametrize("limit", ["limited", "as it is"])
def test_memory_is_locked_or_reported_as_unlocked(limit: str) -> None:
    """With too small a limit nothing is locked, and nothing fails later for lack of memory."""
    printed, found = printed_by(LOCKS, limit)
    assert printed in ("True True", "False False")
    assert found == printed.split()[0]
    if limit == "limited":
        assert printed == "False False"


# --- account --------------------------------------------------------------------------------------

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


@pytest.mark.parametrize(
    ("text", "is_realtime", "cause"),
    [
        ("77 5030000000 9\n", False, OTHERS),
        ("77 5030000000 9\n", True, REALTIME),
        ("77 5001000000 9\n", False, STOPPED),
        ("", False, STOPPED),
        ("no numbers", False, STOPPED),
    ],
)
def test_waiting_for_a_processor_is_the_work_of_others(
    schedstat: Path, monkeypatch: pytest.MonkeyPatch, text: str, is_realtime: bool, cause: str
) -> None:
    """With real-time priority of other real-time work; what did not wait was stopped."""
    monkeypatch.setattr(realtime, "has_realtime_priority", lambda: is_realtime)
    found = ProcessorAccount()
    found.begins()
    found.begins()
    schedstat.write_text(text)
    assert found.cause_of(GAP_S) == cause
    found.fraction()  # waiting before the last health is not of this gap
    assert found.cause_of(GAP_S) == STOPPED


def test_a_long_step_is_its_own_cause(schedstat: Path) -> None:
    """Also while it waited for a processor in between."""
    found = ProcessorAccount()
    work(GAP_S)
    found.begins()
    schedstat.write_text("77 5039000000 9\n")
    assert found.cause_of(GAP_S) == OWN_WORK


def test_without_the_right_a_process_requests_short_time_slices(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of every thread, by sched_setattr(2); policy and nice value are kept."""
    asked: list[tuple[int, ...]] = []

    def syscall(number: int, thread: int, attributes: bytes, _: int) -> None:
        asked.append((number, thread, *realtime.SCHED_ATTR.unpack(attributes)))

    def refuse(_policy: int, _priority: int) -> None:
        raise PermissionError

    monkeypatch.setattr(realtime, "_set_all_threads", refuse)
    monkeypatch.setattr(realtime, "_threads", lambda _: [os.getpid(), 0])
    monkeypatch.setattr(platform, "machine", lambda: "x86_64")
    monkeypatch.setattr(ctypes, "CDLL", lambda _: SimpleNamespace(syscall=syscall))
    assert not realtime.take_realtime_priority()
    attributes = (48, 0, 0x08, os.nice(0), 0, 500_000, 0, 0)  # 8: keep the policy
    assert asked == [(314, thread, *attributes) for thread in (os.getpid(), 0)]
