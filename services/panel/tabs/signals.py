"""Signals tab: state of the digital signals that the cell file names, a button for each output.

An output has a button if the cell file permits an operator to set it. A click is confirmed: what
the output drives may move.
"""

from functools import partial

import viser

from common.config.signals import SignalSection
from forcemesh.bus import Reading
from forcemesh.client import Cell
from forcemesh.errors import BusError
from forcemesh.messages import RobotSignals
from services.panel.markup import Html, html, joined, paragraphs
from services.panel.tabs import Refresh, Tab
from services.panel.viewer import Prose, Viewer, put
from services.panel.watch import Snapshot

NONE_NAMED = html("<p>The cell file names no signals (section <code>signals</code>).</p>")
HELD = "While the robot holds, only outputs with while_held in the cell file are switched."


def build(viewer: Viewer) -> Refresh:
    """Fill the tab."""
    named = viewer.cell.signals
    now = Prose(viewer.gui, paragraphs("…") if named else NONE_NAMED)
    settable = [name for name, signal in named.items() if "operator" in signal.set_by]
    buttons = {
        name: viewer.button(f"{name}: switch", partial(toggle, viewer, name), disabled=True)
        for name in settable
    }

    def refresh(_snapshot: Snapshot) -> None:
        if not named:
            return
        reading = received(viewer)
        state = None if reading is None else reading.fresh
        now.show(table(named, state, "no data" if reading is None else reading.fault))
        for name, button in buttons.items():
            put(button, disabled=state is None or name not in state.on)
            if state is not None:
                put(button, label=f"{name}: switch {opposite(state, name)}")

    return refresh


def toggle(viewer: Viewer, name: str) -> None:
    """Ask for confirmation, then switch an output to the other state."""
    reading = received(viewer)
    state = None if reading is None else reading.fresh
    if state is None or name not in state.on:
        return  # the button is disabled with the next refresh
    word = opposite(state, name)

    def switch(cell: Cell) -> str:
        return cell.signals.set(name, word == "on").text

    text = paragraphs(f"Switches {name} {word}. What it drives may move.", HELD)
    viewer.confirm_and_do(f"Switch {name} {word}", text, f"Switch {word}", switch)


def received(viewer: Viewer) -> Reading[RobotSignals] | None:
    """Return the newest reading of the signals, None without a connection."""
    try:
        return viewer.watch.client.signals.feed.reading()
    except BusError:
        return None


def opposite(state: RobotSignals, name: str) -> str:
    """Return the word of the state that a signal does not have."""
    return "off" if state.on.get(name) else "on"


def table(named: dict[str, SignalSection], state: RobotSignals | None, fault: str) -> Html:
    """Return the signals as a table; their state is unknown without a valid message."""
    rows = [
        html("<tr><td>{}</td><td>{}</td><td>{}</td></tr>", name, signal.label, word(state, name))
        for name, signal in named.items()
    ]
    body = html("<table>{}</table>", joined(rows))
    return body if state is not None else html("{}{}", paragraphs(f"⚠ unknown: {fault}"), body)


def word(state: RobotSignals | None, name: str) -> Html:
    """Return the state of one signal."""
    if state is None or name not in state.on:
        return html("unknown")
    return html("<b>● on</b>") if state.on[name] else html("○ off")


TAB = Tab(75, "Signals", viser.Icon.TOGGLE_LEFT, build)
