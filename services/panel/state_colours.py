"""Colours of the arbiter's states, for the panel, for reports and for the terminal. Pure.

The state's word is always shown in its colour. Every two colours differ in lightness or along the
axis blue to yellow, so that they are distinguishable with any colour blindness; a test computes it.
"""

from typing import NamedTuple


class StateColour(NamedTuple):
    """Colours of one state, as CSS."""

    background: str
    text: str


STATE_COLOURS: dict[str, StateColour] = {
    "BOOT": StateColour("#868e96", "#000000"),
    "IDLE": StateColour("#f1f3f5", "#212529"),
    "ARMED": StateColour("#ffd43b", "#000000"),  # may move
    "SETTLING": StateColour("#74c0fc", "#000000"),
    "ACTIVE": StateColour("#1864ab", "#ffffff"),  # moves
    "STOPPING": StateColour("#f76707", "#000000"),
    "HOLDING": StateColour("#ffa8a8", "#000000"),
    "FAULT": StateColour("#b01030", "#ffffff"),
}
NO_STATE = StateColour(
    "#000000", "#ffffff"
)  # the cell or its arbiter is not received, or its state is unknown
