"""The live plots: some times a second, and only while somebody looks."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import viser
from viser import uplot

from services.panel.history import WINDOW_S, History, Series, Span
from services.panel.readout import ERRORS, FORCES, LATENCIES, TORQUES

PERIOD_S = 0.2
HEIGHT = 118
BRIDGED_S = 0.5  # the longest gap that a line crosses
OUTSIDE = -1e6  # of every axis
TICKS_APART = 16  # at least, up an axis [px]: a plot of this height has room for three or four
MARGIN = 1.4  # so that the last number of an axis is not cut off

# The same hue means the same axis in every plot, and in the scene: x red, y green, z blue.
RED, GREEN, BLUE, ORANGE, GREY = "#e8590c", "#2f9e44", "#1c7ed6", "#f08c00", "#868e96"
COLOURS = {
    "press": "#1971c2",
    "set point": ORANGE,
    "Fx": "#e03131aa",
    "Fy": "#2f9e44aa",
    "Fz": "#4dabf7aa",
    "Mx": "#e03131",
    "My": "#2f9e44",
    "Mz": "#1c7ed6",
    "wanted": ORANGE,
    "x": "#e03131",
    "y": "#2f9e44",
    "z": "#1c7ed6",
    "distance": GREY,
    "chain": "#7048e8",
}
WIDE, DASHED = {"press", "chain"}, {"set point", "wanted"}


@dataclass(frozen=True, slots=True)
class Kind:
    """One plot."""

    title: str
    names: tuple[str, ...]
    least: float  # of the axis, to either side of zero
    signed: bool = True


KINDS = (
    Kind("Force [N]", FORCES, 5.0),
    Kind("Torque [N m]", TORQUES, 0.5),
    Kind("Measured from commanded [mm]", ERRORS, 0.5),
    Kind("Sensor sample to robot [ms]", LATENCIES, 5.0, signed=False),
)


class Plots:
    """All plots of a page, in a panel of their own."""

    def __init__(self, server: viser.ViserServer, history: History) -> None:
        """Add the panel; it is docked at the left, and a section of the sheet on a phone."""
        self._history = history
        self._panel = server.gui.add_panel()
        self._spans = {kind: Span(kind.least, signed=kind.signed) for kind in KINDS}
        data = {kind: history.series(kind.names, 0.0) for kind in KINDS}
        with self._panel.add_tab("Plots", viser.Icon.CHART_LINE):
            self._handles = {
                kind: server.gui.add_uplot(
                    data[kind],
                    tuple(series(name) for name in ("t", *kind.names)),
                    title=kind.title,
                    scales=scales(self._spans[kind]),
                    axes=(axis("s"), axis()),
                    legend=uplot.Legend(show=len(kind.names) > 1, live=False),
                    height=HEIGHT,
                )
                for kind in KINDS
            }
        self._panel.dock_left()
        self._panel.set_width(380)

    def draw(self, now_s: float) -> None:
        """Send what the history holds."""
        for kind, handle in self._handles.items():
            times_s, *lines = self._history.series(kind.names, now_s)
            if self._spans[kind].take(tuple(lines)):
                handle.scales = scales(self._spans[kind])
            handle.data = (times_s, *(broken(times_s, line) for line in lines))


def broken(times_s: Series, line: Series) -> Series:
    """Return a line that leaves the plot in its gaps: the page would draw straight across them.

    A gap of a moment is bridged: not each sample knows each number.
    """
    shown = line.copy()
    known = np.flatnonzero(np.isfinite(line))
    for last, first in pairwise(known):
        if times_s[first] - times_s[last] > BRIDGED_S:
            shown[last + 1 : first] = OUTSIDE
    return shown


def scales(span: Span) -> dict[str, uplot.Scale]:
    """Return both axes; a plot that ranges by itself gives up at the first gap."""
    return {
        "x": uplot.Scale(time=False, auto=False, range=(-WINDOW_S, 0.0)),
        "y": uplot.Scale(auto=False, range=(MARGIN * span.low, MARGIN * span.high)),
    }


def series(name: str) -> uplot.Series:
    """Return how a line looks."""
    if name == "t":
        return uplot.Series(label="t")
    colour = COLOURS[name]
    line = uplot.Series(label=name, stroke=colour, width=2.2 if name in WIDE else 1.2)
    if name in DASHED:
        line["dash"] = (6, 4)
    return line


def axis(label: str = "") -> uplot.Axis:
    """Return an axis that can be read on light and on dark."""
    shown = uplot.Axis(stroke="#8b95a1", grid=uplot.Axis_Grid(stroke="#8b95a133", width=1))
    if not label:
        shown["size"], shown["space"] = 46, TICKS_APART
    return shown
