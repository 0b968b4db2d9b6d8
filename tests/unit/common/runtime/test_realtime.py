"""Priority of processes: one that works goes first, one that starts or ends does not."""

import gc
import os
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest

from common.bus.memory_bus import MemoryTransport
from common.runtime import realtime, service
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


def test_all_threads_go_first_or_the_machine_does_not_grant_it() -> None:
    """Also those that existed before; and none does any more once it is given up."""
    found = subprocess.run(
        [sys.executable, "-c", PRINTS_ITS_POLICIES],
        cwd=Path(__file__).parents[4],
        capture_output=True,
        text=True,
        check=True,
    ).stdout.splitlines()
    first, other = os.SCHED_FIFO, os.SCHED_OTHER
    assert found[0] in (f"True [{first}]", f"False [{other}]")
    assert found[1] == f"[{other}]"


def test_a_service_goes_first_only_while_it_works(monkeypatch: pytest.MonkeyPatch) -> None:
    """Starting and ending take tenths of a second, which loops that run already must not miss."""
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

    monkeypatch.setattr(gc, "freeze", lambda: order.append("freeze"))
    monkeypatch.setattr(realtime, "take_realtime_priority", lambda: order.append("take"))
    monkeypatch.setattr(service, "give_up_realtime_priority", lambda: order.append("give_up"))
    monkeypatch.setattr(service, "cell_from_arguments", lambda _: CELL)
    with pytest.raises(KeyboardInterrupt):
        service.main("regulator", make, connect=connect)
    assert order == [
        "is made",
        "freeze",
        "take",
        "works",
        "sends goodbye",
        "give_up",
        "leaves the bus",
    ]


def test_the_loop_is_spared_in_its_order(monkeypatch: pytest.MonkeyPatch) -> None:
    """First the memory of start-up, then the lock, and priority last: it would starve others."""
    order: list[str] = []
    for owner, name in (
        (gc, "collect"),
        (gc, "freeze"),
        (realtime, "lock_memory"),
        (realtime, "take_realtime_priority"),
    ):
        monkeypatch.setattr(owner, name, lambda name=name: order.append(name))
    realtime.prepare_realtime()
    assert order == ["collect", "freeze", "lock_memory", "take_realtime_priority"]
