"""Questions, answers and log of the panel's tabs, without a browser."""

from collections.abc import Callable
from html import escape
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from forcemesh.errors import RefusedError
from forcemesh.faults import FAULTS, tripped
from forcemesh.messages import ArbiterStatus, Trip
from forcemesh.requests import ForceStartRequest
from services.panel.faultlog import FAULTS_KEPT, FaultLog
from services.panel.tabs import move
from services.panel.tabs.faults import SHOWN, log_text
from services.panel.tabs.force import guiding_question, start_question
from services.panel.viewer import RequestOutcome, Viewer
from tests.fakes.bench import CELL


class ConfirmingViewer(Viewer):
    """A viewer whose person clicks every button and confirms every question at once."""

    def __init__(self, client: Any) -> None:
        browser: Any = SimpleNamespace(gui=None)
        watch: Any = SimpleNamespace(client=client)
        rest: dict[str, Any] = {"wizard": None, "log": None}
        super().__init__(cell=CELL, client=browser, watch=watch, **rest)
        self.questions: list[tuple[str, str]] = []  # label and text
        self.answers: list[tuple[str, str]] = []

    def button(self, label: str, action: Callable[[], None], **_: Any) -> Any:
        """Click the button."""
        action()

    def confirm(self, what: str, text: Any, label: str, action: Any, **_: Any) -> None:
        """Confirm the question."""
        self.questions.append((label, f"{what}: {text}"))
        action()

    def show(self, what: str, answer: RequestOutcome) -> None:
        """Keep the answer."""
        self.answers.append((answer.word, answer.text))


NO_DIRECTION = RefusedError("no_direction", "no force can be followed: <b>", remedy="inspect")
STILL_LOADED = tripped("still_loaded", "the force is still 40 N")


@pytest.mark.parametrize(
    ("ends", "answer"),
    [
        ([tripped("back_off", "free after 3.5 mm")], ("done", "free after 3.5 mm")),
        ([STILL_LOADED], ("stopped", "not free yet: the force is still 40 N")),
        ([RefusedError("already", "nothing")], ("refused", "nothing")),
        ([RefusedError("state", "hold first")], ("refused", "hold first")),
        ([NO_DIRECTION, tripped("back_off", "5.0 mm back")], ("done", "5.0 mm back")),
        ([NO_DIRECTION, NO_DIRECTION], ("refused", "no force can be followed: <b>")),
    ],
)
def test_back_off_asks_again_only_where_no_force_can_be_followed(
    ends: list[Trip | RefusedError], answer: tuple[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The reason stands in the second question as text; there is no third one."""
    ahead, asked = iter(ends), []

    def back_off(*, without_force: bool) -> Trip:
        asked.append(without_force)
        end = next(ahead)
        if isinstance(end, RefusedError):
            raise end
        return end

    monkeypatch.setattr(move, "in_background", lambda run: run())
    viewer = ConfirmingViewer(SimpleNamespace(back_off=back_off))
    move.add_back_off(viewer)
    assert asked == [False, True][: len(ends)]
    labels = [label for label, _ in viewer.questions]
    assert labels == ["Back off now", "Move 5 mm back"][: len(ends)]
    assert all("followed: &lt;b&gt;" in text for _, text in viewer.questions[1:])
    assert (len(viewer.answers), viewer.answers[-1][0]) == (len(ends), answer[0])
    assert answer[1] in viewer.answers[-1][1]


@given(st.lists(st.sets(st.sampled_from(["force", "hold", "stale"])), max_size=30))
def test_the_log_has_each_reason_once_for_each_occurrence(histories):
    """A lasting reason is one line; one that ends and returns is two; newest first."""
    log, expected = FaultLog(lambda: "now"), 0
    before: set[str] = set()
    for reasons in histories:
        trips = tuple(tripped(code, code) for code in sorted(reasons))
        log.saw(ArbiterStatus(state="HOLDING", trips=trips))
        log.saw(None)  # a missing status ends no reason
        expected += len(reasons - before)
        before = reasons
    assert len(log.newest()) == min(expected, FAULTS_KEPT)
    shown = log_text(log.newest())
    assert all(escape(FAULTS[one.trip.code].remedy) in shown for one in log.newest()[:SHOWN])


def test_the_questions_before_guiding_and_before_pressing_differ():
    """A user agrees to the motion that follows."""
    guide = guiding_question("position")
    assert "Hand guiding" in guide
    assert "presses" not in guide
    press = start_question(ForceStartRequest(mode="position", setpoint_N=15.0), 0.05)
    assert "<b>15 N</b>" in press
    assert "50 mm" in press
