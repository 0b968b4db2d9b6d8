"""The panel's button that frees an arm: what is asked, and what is said of its end."""

import threading
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import pytest

from forcemesh.errors import RefusedError
from forcemesh.faults import tripped
from forcemesh.messages import Trip
from services.panel.backing_off import BackOffButton
from services.panel.viewer import Viewer, ask

DONE_WITHIN_S = 10.0
NO_DIRECTION = RefusedError("no_direction", "no force can be followed: <b>", remedy="look")


class Person:
    """Stands in for a viewer: clicks yes at each question, and reads each answer."""

    def __init__(self, *ends: Trip | RefusedError) -> None:
        """Let the cell answer with these, one after the other."""
        self.gui = SimpleNamespace(add_button=lambda *_, **__: self)
        self.asked: list[str] = []
        self.answers: list[tuple[str, str]] = []
        self.without_force: list[bool] = []
        self._ends = list(ends)
        self._over = threading.Event()
        BackOffButton(cast(Viewer, self))

    def on_click(self, click: Callable[[object], None]) -> None:
        """Take the button's action."""
        self._click = click

    def confirm(self, _what: str, text: Any, label: str, action: Callable[[], None]) -> None:
        """Agree."""
        self.asked += [label, str(text)]
        action()

    def do(self, _what: str, action: Callable[[Any], str]) -> None:
        """Ask the cell, and keep the answer."""
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
        """Click, and wait until all is answered."""
        self._click(None)
        assert self._over.wait(DONE_WITHIN_S)


def test_one_question_frees_an_arm_that_feels_its_way_out() -> None:
    """The end is told as it is."""
    person = Person(tripped("back_off", "free after 3.5 mm"))
    person.click()
    assert person.asked[::2] == ["Back off now"]
    assert person.answers == [("done", "free after 3.5 mm")]
    assert person.without_force == [False]


def test_without_a_force_to_follow_a_second_question_is_asked() -> None:
    """With the reason in it, letter by letter; only then the tool goes back by itself."""
    person = Person(NO_DIRECTION, tripped("back_off", "5.0 mm back"))
    person.click()
    assert person.asked[::2] == ["Back off now", "Move 5 mm back"]
    assert "no force can be followed: &lt;b&gt;" in person.asked[3]
    assert person.without_force == [False, True]
    assert [word for word, _ in person.answers] == ["refused", "done"]


@pytest.mark.parametrize(
    "refused", [RefusedError("already", "nothing"), RefusedError("state", "hold first")]
)
def test_no_other_refusal_asks_again(refused: RefusedError) -> None:
    """There is nothing to confirm."""
    person = Person(refused)
    person.click()
    assert person.asked[::2] == ["Back off now"]
    assert person.answers[0][0] == "refused"


def test_a_refusal_of_the_second_try_ends_it() -> None:
    """It does not ask for ever."""
    person = Person(NO_DIRECTION, NO_DIRECTION)
    person.click()
    assert person.without_force == [False, True]


def test_an_arm_that_is_still_loaded_is_not_called_done() -> None:
    """It ended, and the arm is not free."""
    person = Person(tripped("still_loaded", "the force is still 40 N"))
    person.click()
    assert person.answers == [("stopped", "not free yet: the force is still 40 N")]
