"""A page of this process in front of a cell that is only spoken of: its snapshots are made up."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

from common.config.load import load_cell
from forcemesh.bus import Reading
from forcemesh.clock import MonotonicClock
from services.panel import page as page_module
from services.panel.access import Door
from services.panel.watch import Snapshot
from services.panel.wizard import Progress
from tests.browser.rig import ROOT
from tests.chaos.common_net import free_port

CELL = ROOT / "cells" / "demo.yaml"


def said(reading: Reading[Any]) -> SimpleNamespace:
    """Return a feed whose newest message is this one."""
    return SimpleNamespace(reading=lambda: reading)


class SpokenWatch:
    """A watch that sees one snapshot for ever; `client` answers what a test lets it answer."""

    def __init__(self, received: Snapshot) -> None:
        """Take the snapshot."""
        self.received = received
        self.clock = MonotonicClock()
        self.client: Any = SimpleNamespace(feed=self.feed)

    def join(self) -> None:
        """Be there anyway."""

    def wait(self, _within_s: float) -> None:
        """Be there anyway."""

    def leave(self) -> None:
        """Be there anyway."""

    def look(self) -> Snapshot:
        """Return the snapshot as one of this moment."""
        return replace(self.received, now_ns=self.clock.now_ns())

    def feed(self, topic: Any) -> SimpleNamespace:
        """Return a feed of which nothing is known."""
        return said(Reading(None, None, float("inf"), f"{topic.key} missing", silent=True))


@contextmanager
def served(monkeypatch, watch: SpokenWatch, progress: Progress | None = None) -> Iterator[str]:
    """Serve a panel that sees what this watch sees; yield its address."""
    monkeypatch.setattr(page_module, "CellMonitor", lambda _cell: watch)
    port, stop = free_port(), threading.Event()
    page = page_module.PanelPage(load_cell(CELL), CELL, Door("127.0.0.1", port))
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
