"""Stop motion of a panel at which nobody has looked yet: it joins the bus before it speaks."""

import asyncio
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from common.config.load import load_cell
from forcemesh.errors import BusError
from forcemesh.requests import Reply
from services.panel import page as page_module
from services.panel.access import Door
from services.panel.watch import CellMonitor, Snapshot
from tests.chaos.common_net import free_port

CELL = Path(__file__).resolve().parents[4] / "cells" / "demo.yaml"


class Reached(CellMonitor):
    """A watch that reaches its hub as soon as the page's own thread joins."""

    def _open(self) -> None:
        held: Any = SimpleNamespace(hold=lambda reason: Reply(accepted=True, text=reason))
        held.close = lambda: None
        self._client = held
        self._joined.set()

    def look(self) -> Snapshot:
        """See nothing."""
        return Snapshot()


@pytest.fixture
def page(monkeypatch: pytest.MonkeyPatch) -> Any:
    """A panel that runs; no browser has been there."""
    cell, stop = load_cell(CELL), threading.Event()
    monkeypatch.setattr(page_module, "CellMonitor", Reached)
    page = page_module.PanelPage(cell, CELL, Door("127.0.0.1", free_port()))
    thread = threading.Thread(target=page.run, args=[stop])
    thread.start()
    yield page
    stop.set()
    thread.join()
    page.close()


def test_who_stops_before_anybody_has_looked_is_answered(page: Any) -> None:
    """Without that the page said NO ANSWER of a cell that is well."""
    with pytest.raises(BusError, match="no page was open"):
        page._watch.client  # noqa: B018
    answer = asyncio.run(page._stop("operate"))
    assert answer == {"text": page_module.STOPPED_BY, "answered": True}
