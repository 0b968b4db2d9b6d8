"""One person at one browser: what they are asked before the arm moves, and what is answered.

Every form belongs to the one who fills it in: two people at two browsers never change each other's
numbers, and a question appears only to the one who clicked.
"""

import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal

import viser

from common.config.cell import Cell as CellFile
from forcemesh.client import Cell, RefusedError
from forcemesh.errors import BusError, ForcemeshError
from services.panel.faultlog import FaultLog
from services.panel.markup import Html, html
from services.panel.prose import Prose
from services.panel.watch import Watch
from services.panel.wizard import Wizard

Action = Callable[[Cell], str]  # does it, and returns what came of it

CONFIRM_WITHIN_S = 40.0
SHOWN_S = 7.0
COLOURS: dict[str, Literal["green", "orange", "red"]] = {
    "done": "green",
    "refused": "orange",
    "stopped": "orange",
    "no answer": "red",
}
MARKS = {"done": "✔", "refused": "✖", "stopped": "✖", "no answer": "⚠"}


@dataclass(frozen=True, slots=True)
class Answer:
    """What came of something that was asked for."""

    word: Literal["done", "refused", "stopped", "no answer"]
    text: str


def ask(watch: Watch, action: Action) -> Answer:
    """Do something as a client of the cell, and put its end into words."""
    try:
        return Answer("done", action(watch.client))
    except RefusedError as error:
        return Answer("refused", f"{error.code}: {error}")
    except BusError as error:
        return Answer("no answer", str(error))
    except ForcemeshError as error:
        return Answer("stopped", str(error))


@dataclass(slots=True)
class Viewer:
    """One connected browser that may operate."""

    client: viser.ClientHandle
    watch: Watch
    cell: CellFile
    wizard: Wizard
    log: FaultLog
    _confirming: Any = None
    _answer: Prose | None = None
    _lock: threading.Lock = field(default_factory=threading.Lock)

    @property
    def gui(self) -> viser.GuiApi:
        """Where this person's forms are."""
        return self.client.gui

    def do(self, what: str, action: Action) -> None:
        """Ask for something that does not need to be confirmed, and show the answer."""
        self.show(what, ask(self.watch, action))

    def show(self, what: str, answer: Answer) -> None:
        """Show an answer to this person: at once, and in the line that stays."""
        text = answer.text or answer.word
        if self._answer is not None:
            self._answer.show(html("<p>{} <b>{}</b>: {}</p>", MARKS[answer.word], what, text))
        self.client.add_notification(
            title=f"{what}: {answer.word}",
            body=text,
            auto_close_seconds=SHOWN_S,
            color=COLOURS[answer.word],
        )

    def keep_answers_in(self, line: Prose) -> None:
        """Name the line that stays."""
        self._answer = line

    def confirm(
        self,
        what: str,
        text: Html,
        label: str,
        action: Callable[[], None],
        *,
        if_not: Callable[[], None] | None = None,
    ) -> None:
        """Ask this person alone whether the arm may move; do it when they say so.

        The question goes away by itself: a click that comes late was meant for another situation.

        Args:
            what: Title.
            text: What will happen.
            label: Of the button that lets it happen.
            action: What that button does.
            if_not: What is done when they say no, or nothing in time.
        """
        self.dismiss()
        modal = self.gui.add_modal(what)
        with modal:
            Prose(self.gui, text)
            yes = self.gui.add_button(label, color="orange", icon=viser.Icon.PLAYER_PLAY)
            no = self.gui.add_button("Cancel", color="gray")

        def refuse() -> None:
            if self._close(modal) and if_not is not None:
                if_not()

        timer = threading.Timer(CONFIRM_WITHIN_S, refuse)
        timer.daemon = True

        @yes.on_click
        def _(_event: object) -> None:
            timer.cancel()
            if self._close(modal):  # a second click on the way must not do it twice
                action()

        @no.on_click
        def _(_event: object) -> None:
            timer.cancel()
            refuse()

        with self._lock:
            self._confirming = modal
        timer.start()

    def confirm_and_do(self, what: str, text: Html, label: str, action: Action) -> None:
        """Ask first, then ask the cell, and show the answer."""
        self.confirm(what, text, label, lambda: self.do(what, action))

    def dismiss(self) -> None:
        """Take an open question away."""
        if self._confirming is not None:
            self._close(self._confirming)

    def _close(self, modal: Any) -> bool:
        """Close a question; tell whether it was still open."""
        with self._lock:
            if self._confirming is not modal:
                return False
            self._confirming = None
        modal.close()
        return True


def put(handle: Any, value: object) -> None:
    """Put a value into a form's field."""
    handle.value = value
