"""The panel's tab of digital signals: table, words, buttons of permitted outputs only."""

from types import SimpleNamespace
from typing import Any

import pytest

from common.bus.configured_cell import ConfiguredCell
from common.config.load import load_cell
from forcemesh.errors import BusError
from forcemesh.messages import RobotSignals
from services.panel.tabs import all_tabs, signals
from services.panel.viewer import Viewer
from tests.fakes.bench import CELL, DEMO, HALF_RATES
from tests.fakes.lab import Lab
from tests.fakes.signals import ALL_OFF, FOLLOWING

NAMED_CELL = load_cell(DEMO, {**FOLLOWING, "rates": HALF_RATES})


class Element(SimpleNamespace):
    """An element of a form."""

    def on_click(self, action: Any) -> None:
        """Keep the action."""
        self.click = action


class Gui:
    """A form that keeps its elements."""

    def __init__(self) -> None:
        """Start empty."""
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


class Confirming(Viewer):
    """A viewer whose person confirms at once."""

    def confirm_and_do(self, what: str, text: Any, label: str, action: Any) -> None:
        """Execute it, and keep what was asked."""
        self.client.asked.append((what, str(text), label))
        action(self.watch.client)


def viewer_of(cell: Any, client: Any) -> Any:
    """Return a viewer with a form of our own."""
    browser: Any = SimpleNamespace(gui=Gui(), asked=[])
    unused: Any = None
    watch: Any = SimpleNamespace(client=client)
    return Confirming(client=browser, watch=watch, cell=cell, wizard=unused, log=unused)


def test_a_cell_without_signals_has_a_sentence() -> None:
    """And no button; a refresh leaves it."""
    viewer = viewer_of(CELL, None)
    signals.build(viewer)(None)  # type: ignore[arg-type]
    assert "names no signals" in viewer.gui.texts[0].content
    assert "<code>signals</code>" in viewer.gui.texts[0].content
    assert viewer.gui.buttons == {}


def test_the_tab_shows_the_state_and_switches_what_is_permitted() -> None:
    """A button for each output of the operator; it confirms, switches, and changes its label."""
    lab = Lab(NAMED_CELL)
    client = ConfiguredCell(NAMED_CELL, bus=lab.cell.client, commander="operator")
    viewer = viewer_of(NAMED_CELL, client)
    refresh: Any = signals.build(viewer)
    assert list(viewer.gui.buttons) == ["gripper_close: switch", "lamp: switch"]
    client.signals.read()
    refresh(None)
    button = viewer.gui.buttons["lamp: switch"]
    assert (button.label, button.disabled) == ("lamp: switch on", False)
    button.click(None)
    client.signals.wait("part", timeout_s=1.0)
    refresh(None)
    assert button.label == "lamp: switch off"
    assert viewer.gui.texts[0].content.count("● on") == 2  # the lamp, and the part follows it
    (what, text, label) = viewer.client.asked[0]
    assert (what, label) == ("Switch lamp on", "Switch on")
    assert "may move" in text


class Unreachable:
    """A client without a connection."""

    @property
    def signals(self) -> Any:
        """Fail as a feed does that cannot be opened."""
        raise BusError("no hub")


def test_without_a_state_nothing_can_be_switched() -> None:
    """The state is unknown, the buttons are disabled, a late click does nothing."""
    viewer = viewer_of(NAMED_CELL, Unreachable())
    refresh: Any = signals.build(viewer)
    refresh(None)
    assert viewer.gui.texts[0].content.count("unknown") == 1 + len(ALL_OFF)
    assert all(button.disabled for button in viewer.gui.buttons.values())
    viewer.gui.buttons["lamp: switch"].click(None)
    assert viewer.client.asked == []


@pytest.mark.parametrize(
    ("state", "shown"),
    [
        (None, "unknown"),
        (RobotSignals(), "unknown"),
        (RobotSignals(on={"lamp": True}), "<b>● on</b>"),
        (RobotSignals(on={"lamp": False}), "○ off"),
    ],
)
def test_a_state_has_its_word(state: RobotSignals | None, shown: str) -> None:
    """Never on or off when it was not received."""
    assert signals.word(state, "lamp") == shown


def test_the_tab_is_one_of_the_panels() -> None:
    """It is there once."""
    assert [tab.label for tab in all_tabs()].count("Signals") == 1
