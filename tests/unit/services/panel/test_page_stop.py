"""Stop motion on a panel without a connected browser: it joins the bus before its request."""

import asyncio
import threading
from types import SimpleNamespace
from typing import Any

import pytest

from common.runtime.stop import StopSignal
from forcemesh.errors import BusError
from forcemesh.requests import Reply
from services.panel import page as page_module
from services.panel.access import Door
from services.panel.watch import CellMonitor, Snapshot
from tests.chaos.common_net import free_port
from tests.fakes.bench import CELL, DEMO


class ReachableMonitor(CellMonitor):
    """A monitor that reaches its hub as soon as the page's own thread joins."""

    def _open(self) -> None:
        held: Any = SimpleNamespace(hold=lambda reason: Reply(accepted=True, text=reason))
        held.close = lambda: None
        self._client = held
        self._joined.set()

    def snapshot(self) -> Snapshot:
        """Return an empty snapshot."""
        return Snapshot()


@pytest.fixture
def page(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return a running panel without a browser."""
    stop = StopSignal()
    monkeypatch.setattr(page_module, "CellMonitor", ReachableMonitor)
    page = page_module.PanelPage(CELL, DEMO, Door("127.0.0.1", free_port()))
    thread = threading.Thread(target=page.run, args=[stop])
    thread.start()
    yield page
    stop.set()
    thread.join()
    page.close()


def test_a_stop_before_the_first_view_is_answered(page: Any) -> None:
    """Once, the page showed NO ANSWER for a working cell."""
    with pytest.raises(BusError, match="no page was open"):
        page._watch.client  # noqa: B018
    answer = asyncio.run(page._stop("operate"))
    assert answer == {"text": page_module.STOPPED_BY, "answered": True}
