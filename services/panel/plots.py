"""Live plots of force, torque, position error and latency; updated while a page is open."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import viser
from viser import uplot

from services.panel.history import HISTORY_WINDOW_S, PlotHistory, Series, Span
from services.panel.readout import ERRORS, FORCES, LATENCIES, TORQUES

PLOT_PERIOD_S = 0.2
PLOT_HEIGHT = 118
BRIDGED_S = 0.5  # longest gap that a line bridges
OUTSIDE = -1e6  # outside the range of every axis
LABEL_SIZE, TIME_SIZE = 18, 30  # of the time axis [px]: its label, its ticks with their numbers
TICKS_APART = 16  # least distance of two ticks [px]: this plot height fits three or four
PLOT_MARGIN = 1.4  # keeps the last tick label inside the plot

# The same hue means the same axis in every plot, and in the scene: x red, y green, z blue.
ORANGE, GREY = "#f08c00", "#868e96"
COLOURS = {
    "press": "#1971c2",
    "set point": ORANGE,
    "Fx": "#e03131aa",
    "Fy": "#2f9e44aa",
    "Fz": "#4dabf7aa",
    "Mx": "#e03131",
    "My": "#2f9e44",
    "Mz": "#1c7ed6",
    "target": ORANGE,
    "x": "#e03131",
    "y": "#2f9e44",
    "z": "#1c7ed6",
    "distance": GREY,
    "chain": "#7048e8",
}
LABELS = {"press": "normal force"}  # where the legend has another name than the readout
WIDE, DASHED = {"press", "chain"}, {"set point", "target"}


@dataclass(frozen=True, slots=True)
class PlotKind:
    """Title, series and axis range of one plot."""

    title: str
    names: tuple[str, ...]
    least: float  # smallest half range of the axis
    signed: bool = True


KINDS = (
    PlotKind("Force [N]", FORCES, 5.0),
    PlotKind("Torque [N m]", TORQUES, 0.5),
    PlotKind("Position error [mm]", ERRORS, 0.5),
    PlotKind("Latency, sensor to robot [ms]", LATENCIES, 5.0, signed=False),
)


class Plots:
    """Plots of a page, in their own panel."""

    def __init__(self, server: viser.ViserServer, history: PlotHistory) -> None:
        """Add the panel, docked at the left; on a phone it is a section of the sheet."""
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
                    axes=(axis("time [s]"), axis()),
                    legend=uplot.Legend(show=len(kind.names) > 1, live=False),
                    height=PLOT_HEIGHT,
                )
                for kind in KINDS
            }
        self._panel.dock_left()
        self._panel.set_width(380)

    def draw(self, now_s: float) -> None:
        """Send the buffered samples to the plots."""
        for kind, handle in self._handles.items():
            times_s, *lines = self._history.series(kind.names, now_s)
            if self._spans[kind].take(tuple(lines)):
                handle.scales = scales(self._spans[kind])
            handle.data = (times_s, *(broken(times_s, line) for line in lines))


def broken(times_s: Series, line: Series) -> Series:
    """Return a line that leaves the plot range in its gaps; uPlot would draw across them.

    Gaps up to BRIDGED_S stay bridged: not every sample has every value.
    """
    shown = line.copy()
    known = np.flatnonzero(np.isfinite(line))
    for last, first in pairwise(known):
        if times_s[first] - times_s[last] > BRIDGED_S:
            shown[last + 1 : first] = OUTSIDE
    return shown


def scales(span: Span) -> dict[str, uplot.Scale]:
    """Return the scales of both axes; uPlot's automatic range fails at a gap."""
    return {
        "x": uplot.Scale(time=False, auto=False, range=(-HISTORY_WINDOW_S, 0.0)),
        "y": uplot.Scale(auto=False, range=(PLOT_MARGIN * span.low, PLOT_MARGIN * span.high)),
    }


def series(name: str) -> uplot.Series:
    """Return the line style of a series."""
    if name == "t":
        return uplot.Series(label="t")
    colour = COLOURS[name]
    line = uplot.Series(
        label=LABELS.get(name, name), stroke=colour, width=2.2 if name in WIDE else 1.2
    )
    if name in DASHED:
        line["dash"] = (6, 4)
    return line


def axis(label: str = "") -> uplot.Axis:
    """Return an axis with colours that suit the light and the dark theme."""
    shown = uplot.Axis(stroke="#8b95a1", grid=uplot.Axis_Grid(stroke="#8b95a133", width=1))
    if label:
        shown["label"], shown["labelSize"], shown["size"] = label, LABEL_SIZE, TIME_SIZE
    else:
        shown["size"], shown["space"] = 46, TICKS_APART
    return shown
