"""A page of this process in front of a scripted cell, whose snapshots the test makes."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

from common.runtime.stop import StopSignal
from forcemesh.bus import Reading
from forcemesh.clock import MonotonicClock
from services.panel import page as page_module
from services.panel.access import Door
from services.panel.watch import Snapshot
from services.panel.wizard import Progress
from tests.chaos.common_net import free_port
from tests.fakes.bench import CELL, DEMO


def feed_of(reading: Reading[Any]) -> SimpleNamespace:
    """Return a feed whose newest message is this one."""
    return SimpleNamespace(reading=lambda: reading)


class ScriptedWatch:
    """A watch with one constant snapshot; `client` answers as a test defines."""

    def __init__(self, received: Snapshot) -> None:
        """Take the snapshot."""
        self.received = received
        self.clock = MonotonicClock()
        self.client: Any = SimpleNamespace(feed=self.feed)

    def join(self) -> None:
        """Do nothing."""

    def wait(self, _within_s: float) -> None:
        """Do nothing."""

    def leave(self) -> None:
        """Do nothing."""

    def snapshot(self) -> Snapshot:
        """Return the snapshot with the present time."""
        return replace(self.received, now_ns=self.clock.now_ns())

    def feed(self, topic: Any) -> SimpleNamespace:
        """Return a feed without messages."""
        return feed_of(Reading(None, None, float("inf"), f"{topic.key} missing", silent=True))


@contextmanager
def served(
    monkeypatch, watch: ScriptedWatch, progress: Progress | None = None, **door: Any
) -> Iterator[str]:
    """Serve a panel of this watch behind a door; yield its address."""
    monkeypatch.setattr(page_module, "CellMonitor", lambda _cell: watch)
    port, stop = free_port(), StopSignal()
    page = page_module.PanelPage(CELL, DEMO, Door("127.0.0.1", port, **door))
    if progress is not None:
        page._wizard.progress = progress
    thread = threading.Thread(target=page.run, args=[stop])
    thread.start()
    try:
        yield f"http://127.0.0.1:{port}/"
    finally:
        stop.set()
        thread.join()
        page.close()
