"""The panel's button for backing off: its questions, requests and answers."""

import threading
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import pytest

from forcemesh.errors import RefusedError
from forcemesh.faults import tripped
from forcemesh.messages import Trip
from services.panel.tabs.move import add_back_off
from services.panel.viewer import Viewer, ask

DONE_WITHIN_S = 10.0
NO_DIRECTION = RefusedError("no_direction", "no force can be followed: <b>", remedy="inspect")


class ConfirmingViewer:
    """A fake viewer that confirms each question and records each answer."""

    def __init__(self, *ends: Trip | RefusedError) -> None:
        """Let the cell answer with these, one after the other."""
        self.questions: list[str] = []
        self.answers: list[tuple[str, str]] = []
        self.without_force: list[bool] = []
        self._ends = list(ends)
        self._over = threading.Event()
        add_back_off(cast(Viewer, self))

    def button(self, _label: str, click: Callable[[], None], **_style: Any) -> None:
        """Keep the button's action."""
        self._click = click

    def confirm(self, _what: str, text: Any, label: str, action: Callable[[], None]) -> None:
        """Confirm the question."""
        self.questions += [label, str(text)]
        action()

    def do(self, _what: str, action: Callable[[Any], str]) -> None:
        """Send the request and keep the answer."""
        answer = ask(cast(Any, SimpleNamespace(client=self)), action)
        self.answers.append((answer.word, answer.text))
        if not self._ends:
            self._over.set()

    def back_off(self, *, without_force: bool) -> Trip:
        """Answer as the cell."""
        self.without_force.append(without_force)
        end = self._ends.pop(0)
        if isinstance(end, RefusedError):
            raise end
        return end

    def click(self) -> None:
        """Click, and wait for all answers."""
        self._click()
        assert self._over.wait(DONE_WITHIN_S)


def test_one_question_frees_an_arm_along_its_force() -> None:
    """The end is shown unchanged."""
    viewer = ConfirmingViewer(tripped("back_off", "free after 3.5 mm"))
    viewer.click()
    assert viewer.questions[::2] == ["Back off now"]
    assert viewer.answers == [("done", "free after 3.5 mm")]
    assert viewer.without_force == [False]


def test_without_a_usable_force_a_second_question_is_asked() -> None:
    """It has the reason as escaped text; the tool moves back only after it."""
    viewer = ConfirmingViewer(NO_DIRECTION, tripped("back_off", "5.0 mm back"))
    viewer.click()
    assert viewer.questions[::2] == ["Back off now", "Move 5 mm back"]
    assert "no force can be followed: &lt;b&gt;" in viewer.questions[3]
    assert viewer.without_force == [False, True]
    assert [word for word, _ in viewer.answers] == ["refused", "done"]


@pytest.mark.parametrize(
    "refused", [RefusedError("already", "nothing"), RefusedError("state", "hold first")]
)
def test_another_refusal_asks_no_second_question(refused: RefusedError) -> None:
    """There is nothing to confirm."""
    viewer = ConfirmingViewer(refused)
    viewer.click()
    assert viewer.questions[::2] == ["Back off now"]
    assert viewer.answers[0][0] == "refused"


def test_a_refusal_of_the_second_request_ends_it() -> None:
    """There is no third question."""
    viewer = ConfirmingViewer(NO_DIRECTION, NO_DIRECTION)
    viewer.click()
    assert viewer.without_force == [False, True]


def test_an_arm_that_is_still_loaded_is_not_shown_as_done() -> None:
    """The motion ended, and the arm is not free."""
    viewer = ConfirmingViewer(tripped("still_loaded", "the force is still 40 N"))
    viewer.click()
    assert viewer.answers == [("stopped", "not free yet: the force is still 40 N")]
