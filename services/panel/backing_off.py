"""The button that frees an arm: one question, and a second one where no force can be followed.

It lasts seconds, so it runs in a thread of its own: a click never waits for it.
"""

import threading

import viser

from forcemesh.client import Cell, RefusedError
from forcemesh.errors import NotReachedError
from services.panel.markup import html
from services.panel.viewer import Viewer

WHAT = "Back off"
QUESTION = html(
    "<p>Frees an arm above a ceiling or outside the workspace: <b>it moves up to 20 mm at "
    "5 mm/s</b>, along the measured force or straight back in, then holds. Is everybody out of "
    "reach?</p>"
)


class BackOff:
    """Asks, backs off, and shows what came of it to the person who clicked."""

    def __init__(self, viewer: Viewer) -> None:
        """Put the button below what the form has so far."""
        self._viewer = viewer
        button = viewer.gui.add_button(WHAT, icon=viser.Icon.ARROW_BACK_UP, color="orange")
        button.on_click(lambda _event: viewer.confirm(WHAT, QUESTION, "Back off now", self._begin))

    def _begin(self, *, without_force: bool = False) -> None:
        threading.Thread(
            target=self._go, kwargs={"without_force": without_force}, daemon=True
        ).start()

    def _go(self, *, without_force: bool) -> None:
        refused: list[RefusedError] = []

        def back_off(cell: Cell) -> str:
            try:
                end = cell.back_off(without_force=without_force)
            except RefusedError as error:
                refused.append(error)
                raise
            if end.code != "back_off":
                raise NotReachedError(f"not free yet: {end.text}")
            return end.text

        self._viewer.do(WHAT, back_off)
        if refused and refused[0].code == "no_direction" and not without_force:
            self._ask_again(refused[0].text)

    def _ask_again(self, why: str) -> None:
        question = html(
            "<p>{}</p><p>Without a force to follow <b>the tool goes 5 mm back along its own "
            "axis</b>, at 5 mm/s, then the arm holds. Look at the tool: is that way free, and "
            "everybody out of reach?</p>",
            why,
        )
        self._viewer.confirm(
            f"{WHAT} without force",
            question,
            "Go 5 mm back",
            lambda: self._begin(without_force=True),
        )
