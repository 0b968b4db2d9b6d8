"""Back-off button: one confirmation, a second one when no force direction is available.

Backing off takes seconds, so it runs in a separate thread: no click blocks.
"""

import threading

import viser

from forcemesh.client import Cell, RefusedError
from forcemesh.errors import NotReachedError
from services.panel.markup import html
from services.panel.viewer import Viewer

WHAT = "Back off"
QUESTION = html(
    "<p>Frees an arm above a force limit or outside the workspace: <b>it moves up to 20 mm at "
    "5 mm/s</b>, along the measured force or straight back into the workspace, then holds. "
    "Confirm that the area is clear.</p>"
)


class BackOffButton:
    """Confirms, requests the back-off and shows its result on the page that requested it."""

    def __init__(self, viewer: Viewer) -> None:
        """Add the button to the form."""
        self._viewer = viewer
        button = viewer.gui.add_button(WHAT, icon=viser.Icon.ARROW_BACK_UP, color="orange")
        button.on_click(lambda _event: viewer.confirm(WHAT, QUESTION, "Back off now", self._begin))

    def _begin(self, *, without_force: bool = False) -> None:
        threading.Thread(
            target=self._start, kwargs={"without_force": without_force}, daemon=True
        ).start()

    def _start(self, *, without_force: bool) -> None:
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
            "<p>{}</p><p>Without a measured force <b>the tool moves 5 mm back along its own "
            "axis</b>, at 5 mm/s, then the arm holds. Confirm that this path is free and that "
            "the area is clear.</p>",
            why,
        )
        self._viewer.confirm(
            f"{WHAT} without force",
            question,
            "Move 5 mm back",
            lambda: self._begin(without_force=True),
        )
