"""Live plots of force, torque, position error and latency: values, axes and lines.

The values of the last seconds are in a ring buffer with fixed memory.
"""

from collections.abc import Mapping
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import viser
from viser import uplot

from services.panel.readout import ERRORS, FORCES, LATENCIES, TORQUES

Series = npt.NDArray[np.float64]

HISTORY_WINDOW_S = 20.0
HISTORY_POINTS = 400  # most points of a plot; one each 50 ms
PLOT_ROOM = 0.4  # share of an axis range below which the range shrinks
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
# Colours of the axes that suit the light and the dark theme.
STROKE, GRID = "#8b95a1", uplot.Axis_Grid(stroke="#8b95a133", width=1)
PLOT_AXES = (
    uplot.Axis(stroke=STROKE, grid=GRID, label="time [s]", labelSize=LABEL_SIZE, size=TIME_SIZE),
    uplot.Axis(stroke=STROKE, grid=GRID, size=46, space=TICKS_APART),
)
LABELS = {"press": "normal force"}  # where the legend has another name than the readout
WIDE, DASHED = {"press", "chain"}, {"set point", "target"}


class PlotKind(NamedTuple):
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


class PlotHistory:
    """Ring buffer of samples of named values; a missing value is a gap (NaN)."""

    def __init__(self, names: tuple[str, ...], points: int = HISTORY_POINTS) -> None:
        """Create an empty buffer."""
        self._names = names
        self._samples = np.full((points, 1 + len(names)), np.nan)  # the newest one is the last
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def add(self, time_s: float, values: Mapping[str, float]) -> None:
        """Add a sample, overwriting the oldest one when full; missing names are gaps."""
        self._samples[:-1] = self._samples[1:]
        self._samples[-1] = (time_s, *(values.get(name, np.nan) for name in self._names))
        self._count = min(self._count + 1, len(self._samples))

    def series(self, names: tuple[str, ...], now_s: float) -> tuple[Series, ...]:
        """Return times relative to now [s], oldest first, and the named values, of equal length.

        At least two samples are returned, as a plot needs two; absent ones are gaps.
        """
        if self._count < 2:
            edge = np.array([-HISTORY_WINDOW_S, 0.0])
            return (edge, *(np.full(2, np.nan) for _ in names))
        times_s, *columns = self._samples[-self._count :].T
        named = dict(zip(self._names, columns, strict=True))
        return (times_s - now_s, *(named[name] for name in names))

    def clear(self) -> None:
        """Remove all samples: data before a pause does not continue after it."""
        self._count = 0


class Span:
    """Range of a plot axis: round numbers, changed only when the data no longer fits.

    The hysteresis keeps the axis readable.
    """

    def __init__(self, least: float, *, signed: bool = True) -> None:
        """Start with a range above the noise; an unsigned range starts at zero."""
        self._least, self._signed = least, signed
        self.low, self.high = -least if signed else 0.0, least

    def take(self, lines: tuple[Series, ...]) -> bool:
        """Fit the range to these values; return whether it changed."""
        known = np.concatenate([line[np.isfinite(line)] for line in lines] or [np.zeros(1)])
        low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 0.0)
        span = (-self._round(-low) if self._signed or low < 0.0 else 0.0, self._round(high))
        too_small = low < self.low or high > self.high
        too_large = span[1] - span[0] < PLOT_ROOM * (self.high - self.low)
        if not (too_small or too_large):
            return False
        changed = span != (self.low, self.high)
        self.low, self.high = span
        return changed

    def _round(self, extent: float) -> float:
        """Return the smallest of 1, 2, 5 times a power of ten above an extent."""
        extent = max(1.05 * extent, self._least)
        power: float = 10.0 ** np.floor(np.log10(extent))
        return next(step * power for step in (1.0, 2.0, 5.0, 10.0) if step * power >= extent)


class Plots:
    """Plots of a page, in their own panel."""

    def __init__(self, server: viser.ViserServer, history: PlotHistory) -> None:
        """Add the panel, docked at the left; on a phone it is a section of the sheet."""
        self._history = history
        self._panel = server.gui.add_panel()
        self._spans = {kind: Span(kind.least, signed=kind.signed) for kind in KINDS}
        with self._panel.add_tab("Plots", viser.Icon.CHART_LINE):
            self._handles = {
                kind: server.gui.add_uplot(
                    history.series(kind.names, 0.0),
                    tuple(series(name) for name in ("t", *kind.names)),
                    title=kind.title,
                    scales=scales(self._spans[kind]),
                    axes=PLOT_AXES,
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
