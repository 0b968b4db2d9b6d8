"""Tabs of the panel: their texts, fields, questions and requests, on a form without a browser."""

from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import pytest

from common.bus.configured_cell import ConfiguredCell
from common.config.cell import CellConfig
from common.config.load import load_cell
from forcemesh.errors import RefusedError
from forcemesh.faults import tripped
from forcemesh.messages import Trip
from services.panel.tabs import move, signals
from services.panel.viewer import RequestOutcome, Viewer
from tests.fakes.bench import CELL, DEMO, HALF_RATES
from tests.fakes.lab import Lab
from tests.fakes.signals import ALL_OFF, FOLLOWING


class Element(SimpleNamespace):
    """An element of a form."""

    def on_click(self, action: Any) -> None:
        """Keep the action."""
        self.click = action


class Gui:
    """A form that keeps its elements."""

    def __init__(self) -> None:
        self.texts: list[Element] = []
        self.buttons: dict[str, Element] = {}

    def add_html(self, content: str) -> Element:
        """Add a text."""
        self.texts.append(Element(content=content))
        return self.texts[-1]

    def add_button(self, label: str, *, disabled: bool = False, **_: Any) -> Element:
        """Add a button, found by its first label."""
        self.buttons[label] = Element(label=label, disabled=disabled)
        return self.buttons[label]

    @contextmanager
    def add_folder(self, _label: str, **_style: Any) -> Iterator[None]:
        """Add the elements of a folder to the form."""
        yield


class ConfirmingViewer(Viewer):
    """A viewer whose person confirms every question at once; it keeps questions and answers."""

    def __init__(self, client: Any = None, cell: CellConfig = CELL, cell_file: Any = None) -> None:
        browser, watch = SimpleNamespace(gui=Gui()), SimpleNamespace(client=client)
        wizard, log = SimpleNamespace(cell_file=cell_file), None
        parts: dict[str, Any] = {"client": browser, "watch": watch, "wizard": wizard, "log": log}
        super().__init__(cell=cell, **parts)
        self.form: Gui = browser.gui
        self.questions: list[tuple[str, str]] = []  # label and text
        self.answers: list[tuple[str, str]] = []

    def confirm(self, what: str, text: Any, label: str, action: Any, **_: Any) -> None:
        """Confirm the question."""
        self.questions.append((label, f"{what}: {text}"))
        action()

    def show(self, what: str, answer: RequestOutcome) -> None:
        """Keep the answer."""
        self.answers.append((answer.word, answer.text))


# --- force ----------------------------------------------------------------------------------------

# --- back off -------------------------------------------------------------------------------------

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
    viewer.form.buttons["Back off"].click(None)
    assert asked == [False, True][: len(ends)]
    labels = [label for label, _ in viewer.questions]
    assert labels == ["Back off now", "Move 5 mm back"][: len(ends)]
    assert all("followed: &lt;b&gt;" in text for _, text in viewer.questions[1:])
    assert (len(viewer.answers), viewer.answers[-1][0]) == (len(ends), answer[0])
    assert answer[1] in viewer.answers[-1][1]


# --- calibrate: the bring-up ladder ---------------------------------------------------------------

# --- record ---------------------------------------------------------------------------------------

# --- signals --------------------------------------------------------------------------------------

NAMED_CELL = load_cell(DEMO, {**FOLLOWING, "rates": HALF_RATES})


def test_the_tab_shows_the_state_and_switches_what_is_permitted() -> None:
    """A button for each output of the operator; it confirms, switches, and changes its label."""
    lab = Lab(NAMED_CELL)
    client = ConfiguredCell(NAMED_CELL, bus=lab.cell.client, commander="operator")
    viewer = ConfirmingViewer(client, NAMED_CELL)
    refresh: Any = signals.build(viewer)
    assert list(viewer.form.buttons) == ["gripper_close: switch", "lamp: switch"]
    client.signals.read()
    refresh(None)
    button = viewer.form.buttons["lamp: switch"]
    assert (button.label, button.disabled) == ("lamp: switch on", False)
    button.click(None)
    client.signals.wait("part", timeout_s=1.0)
    refresh(None)
    assert button.label == "lamp: switch off"
    shown = viewer.form.texts[0].content
    assert shown.count("● on") == 2  # the lamp, and the part follows it
    assert shown.count("○ off") == len(ALL_OFF) - 2
    ((label, text),) = viewer.questions
    assert label == "Switch on"
    assert text.startswith("Switch lamp on: ")
    assert "may move" in text
