"""Panel page and its loop: scene and plots for every browser, forms for operators."""

import asyncio
import threading
import time
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Any

import viser

from common.config.cell import CellConfig
from common.runtime.heartbeat import heartbeat_of_this_process
from common.runtime.stop import StopSignal
from forcemesh.clock import NS_PER_S
from services.panel.access import Door, context_of
from services.panel.faultlog import FaultLog
from services.panel.markup import html, paragraphs
from services.panel.plots import PLOT_PERIOD_S, PlotHistory, Plots
from services.panel.readout import NAMES, Readout
from services.panel.scene import Scene
from services.panel.server import RIGHTS, Gate, close_server, open_server
from services.panel.sessions import Rights
from services.panel.status_bar import UNANSWERED, may_stop, stop_text, strip
from services.panel.tabs import Refresh, all_tabs
from services.panel.viewer import Prose, RequestOutcome, Viewer, ask, put
from services.panel.watch import CellMonitor, Snapshot
from services.panel.wizard import WizardProcess

PAGE_PERIOD_S = 0.05  # of the scene and of the samples in the plots
FORMS_S = 0.25
IDLE_PERIOD_S = 0.25  # poll period while no page is open
OLD_S = 0.5  # age above which a snapshot is renewed before it is shown
LEFT_S = 3.0  # covers the gap while a page is reloaded
JOINED_WITHIN_S = 2.0  # for Stop motion: without an open page the panel is off the bus
DARK_KEY = "forcemesh dark"
ANSWERS_WITHIN_S = 20.0
DRAWN_SLOWLY = html(  # bar.html shows it where the browser has no graphics card
    '<p class="fm-software">The 3D view is drawn without a graphics card; it may lag.</p>'
)
STOPPED_BY = "Stop motion was pressed in the panel"


class PanelPage:
    """Panel of one cell: server, scene, plots, forms and their update loop."""

    def __init__(self, cell: CellConfig, cell_file: Path, door: Door) -> None:
        """Start the server; the page is available when this returns.

        Raises:
            ForcemeshError: The port is in use, or access control is not effective.
        """
        self._cell, self._wizard = cell, WizardProcess(cell_file)
        self._watch = CellMonitor(cell)
        self._readout, self._history = Readout(cell), PlotHistory(NAMES)
        self._log = FaultLog(lambda: datetime.now().astimezone().strftime("%H:%M:%S"))
        self._forms: dict[int, list[Refresh]] = {}
        self._snapshot = Snapshot()
        self._updated_ns = 0
        gate = Gate(door, f"forcemesh {cell.cell}")
        gate.routes = {"/state": self._state, "/stop": self._stop}
        self.server = open_server(gate, door, context_of(cell, door))
        self.server.gui.configure_theme(show_logo=False, show_share_button=False)
        self.server.gui.set_panel_label(f"forcemesh · {cell.cell}")
        self.server.gui.main_panel.dock_right()
        self.server.gui.main_panel.set_width(470)
        self._scene = Scene(self.server, cell)
        self._plots = Plots(self.server, self._history)
        self.server.on_client_connect(self._came)
        self.server.on_client_disconnect(self._disconnected)
        gate.ready = True

    def run(self, stop: StopSignal) -> None:
        """Update the page while a browser is connected; otherwise wait, off the bus."""
        plots_ns = forms_ns = 0
        heartbeat = heartbeat_of_this_process()
        while not stop.wait(PAGE_PERIOD_S if self._is_watched() else IDLE_PERIOD_S):
            heartbeat.beat(time.monotonic_ns(), "")
            if not self._is_watched():
                self._watch.leave()
                self._history.clear()
                continue
            self._watch.join()
            self._snapshot = snapshot = self._watch.snapshot()
            self._log.saw(snapshot.arbiter.fresh)
            self._history.add(snapshot.now_ns / NS_PER_S, self._readout.numbers(snapshot))
            if not self.server.get_clients():
                continue
            self._scene.draw(snapshot)
            if snapshot.now_ns - plots_ns >= PLOT_PERIOD_S * NS_PER_S:
                plots_ns = snapshot.now_ns
                self._plots.draw(snapshot.now_ns / NS_PER_S)
            if snapshot.now_ns - forms_ns >= FORMS_S * NS_PER_S:
                forms_ns = snapshot.now_ns
                for refreshes in list(self._forms.values()):
                    for refresh in refreshes:
                        refresh(snapshot)

    def close(self) -> None:
        """Leave the bus, then close the page; a running calibration ends in a hold."""
        self._wizard.close()
        self._watch.leave()
        close_server(self.server)

    # --- requests of the status bar ---------------------------------------------------------------

    async def _state(self, rights: Rights) -> dict[str, Any]:
        self._updated_ns = time.monotonic_ns()
        if self._watch.clock.now_ns() - self._snapshot.now_ns > OLD_S * NS_PER_S:
            # The loop is late; the bar must not show old data.
            self._snapshot = self._watch.snapshot()
        return strip(self._cell, self._snapshot, rights)

    async def _stop(self, rights: Rights) -> dict[str, Any]:
        if not may_stop(self._cell, rights):
            return {"text": "refused: this page is view-only", "answered": True}
        self._updated_ns = time.monotonic_ns()  # a stop request keeps the panel on the bus
        answer = await asyncio.to_thread(self._hold)
        text = stop_text(answer, self._watch.snapshot())
        return {"text": text, "answered": UNANSWERED not in text}

    def _hold(self) -> RequestOutcome:
        self._watch.wait(JOINED_WITHIN_S)
        return ask(self._watch, lambda cell: cell.hold(STOPPED_BY).text)

    # --- connected browsers -----------------------------------------------------------------------

    def _is_watched(self) -> bool:
        if self.server.get_clients():
            self._updated_ns = time.monotonic_ns()
        return bool(self._updated_ns) and time.monotonic_ns() - self._updated_ns < LEFT_S * NS_PER_S

    async def _came(self, client: viser.ClientHandle) -> None:
        """Build the forms of a new client that has operator rights."""
        await asyncio.to_thread(self._build, client, RIGHTS.get())

    async def _disconnected(self, client: viser.ClientHandle) -> None:
        self._forms.pop(client.client_id, None)

    def _build(self, client: viser.ClientHandle, rights: Rights) -> None:
        gui = client.gui
        if rights == "view":
            Prose(gui, paragraphs("View only: this session has no operator rights."))
            tabs = gui.add_tab_group()
        else:
            viewer = Viewer(client, self._watch, self._cell, self._wizard, self._log)
            viewer.answer = Prose(gui, paragraphs("Replies to requests appear here."))
            tabs, refreshes = gui.add_tab_group(), []
            for tab in all_tabs():
                with tabs.add_tab(tab.label, tab.icon):
                    refreshes.append(tab.build(viewer))
            self._forms[client.client_id] = refreshes
        with tabs.add_tab("Settings", viser.Icon.SETTINGS):
            add_settings(client)


def add_settings(client: viser.ClientHandle) -> None:
    """Add the dark mode switch, whose setting the browser stores, and the note on drawing."""
    dark = client.gui.add_checkbox("Dark mode", initial_value=False)
    Prose(client.gui, DRAWN_SLOWLY)

    def show(*, persist: bool) -> None:
        client.gui.configure_theme(show_logo=False, show_share_button=False, dark_mode=dark.value)
        if persist:
            client.local_storage.set_item(DARK_KEY, "yes" if dark.value else "no")

    dark.on_update(lambda _event: show(persist=True))

    def recall() -> None:
        with suppress(TimeoutError):  # a busy browser keeps the light theme
            if client.local_storage.get_item(DARK_KEY, timeout=ANSWERS_WITHIN_S) == "yes":
                put(dark, value=True)
                show(persist=False)

    threading.Thread(target=recall, daemon=True).start()
