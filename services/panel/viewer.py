"""Session of one browser: its forms, confirmations before motion, and replies.

Forms are per client: two browsers do not change each other's values, and a confirmation appears
only in the browser that requested it.
"""

import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import viser

from common.config.cell import CellConfig as CellFile
from forcemesh.client import Cell, RefusedError
from forcemesh.errors import BusError, ForcemeshError
from services.panel.faultlog import FaultLog
from services.panel.markup import Html, html
from services.panel.watch import CellMonitor
from services.panel.wizard import WizardProcess

Action = Callable[[Cell], str]  # executes a request and returns its result

CONFIRM_WITHIN_S = 40.0
SHOWN_S = 7.0
COLOURS: dict[str, Literal["green", "orange", "red"]] = {
    "done": "green",
    "refused": "orange",
    "stopped": "orange",
    "no answer": "red",
}
FRAME = '<div class="fm-prose">{}</div>'
MARKS = {"done": "✔", "refused": "✖", "stopped": "✖", "no answer": "⚠"}


class RequestOutcome(NamedTuple):
    """Result of a request: outcome and text."""

    word: Literal["done", "refused", "stopped", "no answer"]
    text: str


class Prose:
    """Text element of a form, escaped `Html`; sent to the browser only when it has changed.

    viser's Markdown is not used: it renders raw HTML, scripts included, creates links and reads
    pictures from this machine's disk; text from the bus must not do that.
    """

    def __init__(self, gui: viser.GuiApi, shown: Html) -> None:
        """Append the element to the form."""
        self._shown = shown
        self._handle = gui.add_html(str(html(FRAME, shown)))

    def show(self, shown: Html) -> None:
        """Replace the shown text."""
        if shown != self._shown:
            self._shown = shown
            self._handle.content = str(html(FRAME, shown))


def ask(watch: CellMonitor, action: Action) -> RequestOutcome:
    """Execute an action as a client of the cell; return its result as text."""
    try:
        return RequestOutcome("done", action(watch.client))
    except RefusedError as error:
        return RequestOutcome("refused", f"{error.code}: {error}")
    except BusError as error:
        return RequestOutcome("no answer", str(error))
    except ForcemeshError as error:
        return RequestOutcome("stopped", str(error))


@dataclass(slots=True)
class Viewer:
    """One connected browser with operator rights."""

    client: viser.ClientHandle
    watch: CellMonitor
    cell: CellFile
    wizard: WizardProcess
    log: FaultLog
    answer: Prose | None = None  # permanent line for replies
    _confirming: Any = None
    _lock: threading.Lock = field(default_factory=threading.Lock)

    @property
    def gui(self) -> viser.GuiApi:
        """Forms of this client."""
        return self.client.gui

    def do(self, what: str, action: Action) -> None:
        """Execute an action without confirmation and show the reply."""
        self.show(what, ask(self.watch, action))

    def show(self, what: str, answer: RequestOutcome) -> None:
        """Show a reply to this client: as a notification and in the permanent line."""
        text = answer.text or answer.word
        if self.answer is not None:
            self.answer.show(html("<p>{} <b>{}</b>: {}</p>", MARKS[answer.word], what, text))
        self.client.add_notification(
            title=f"{what}: {answer.word}",
            body=text,
            auto_close_seconds=SHOWN_S,
            color=COLOURS[answer.word],
        )

    def button(self, label: str, action: Callable[[], None], **style: Any) -> viser.GuiButtonHandle:
        """Add a button that executes an action; `style` as in viser."""
        handle = self.gui.add_button(label, **style)
        handle.on_click(lambda _event: action())
        return handle

    def confirm(
        self,
        what: str,
        text: Html,
        label: str,
        action: Callable[[], None],
        *,
        if_not: Callable[[], None] = lambda: None,
    ) -> None:
        """Ask this client to confirm a motion; execute the action on confirmation.

        The dialog expires after CONFIRM_WITHIN_S: a late click was meant for another situation.

        Args:
            what: Title.
            text: Description of the motion.
            label: Label of the confirming button.
            action: Executed on confirmation.
            if_not: Executed on cancel or expiry.
        """
        if self._confirming is not None:
            self._close(self._confirming)

        def end(chosen: Callable[[], None]) -> None:
            timer.cancel()
            if self._close(modal):  # a second click must not execute it twice
                chosen()

        timer = threading.Timer(CONFIRM_WITHIN_S, end, [if_not])
        timer.daemon = True
        modal = self.gui.add_modal(what)
        with modal:
            Prose(self.gui, text)
            self.button(label, lambda: end(action), color="orange", icon=viser.Icon.PLAYER_PLAY)
            self.button("Cancel", lambda: end(if_not), color="gray")
        with self._lock:
            self._confirming = modal
        timer.start()

    def confirm_and_do(self, what: str, text: Html, label: str, action: Action) -> None:
        """Ask for confirmation, then execute the action and show the reply."""
        self.confirm(what, text, label, lambda: self.do(what, action))

    def _close(self, modal: Any) -> bool:
        """Close a confirmation; return whether it was still open."""
        with self._lock:
            if self._confirming is not modal:
                return False
            self._confirming = None
        modal.close()
        return True


def in_background(action: Callable[[], None]) -> None:
    """Execute an action in a thread of its own, so that no click blocks."""
    threading.Thread(target=action, daemon=True).start()


def put(handle: Any, **properties: object) -> None:
    """Set the properties of an element that differ: each one set is sent to the browser."""
    for name, value in properties.items():
        if getattr(handle, name) != value:
            setattr(handle, name, value)
