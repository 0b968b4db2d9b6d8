"""Plots of a report as SVG for the page."""

import io
import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cli.report.data import ReportContent

# Title, unit, and the lines with their colours.
PLOTS: tuple[tuple[str, str, tuple[tuple[str, str], ...]], ...] = (
    ("Press force", "N", (("press", "#e03131"), ("set point", "#868e96"))),
    (
        "Force of the environment on the tool",
        "N",
        (("Fx", "#e8590c"), ("Fy", "#2f9e44"), ("Fz", "#1971c2")),
    ),
    ("Torque about the TCP", "N m", (("Mx", "#e8590c"), ("My", "#2f9e44"), ("Mz", "#1971c2"))),
    ("Tracking error", "mm", (("distance", "#7048e8"),)),
    ("Latency from sensor sample to robot", "ms", (("chain", "#0c8599"),)),
)
LABELS = {"press": "measured"}
GREY = "#868e96"


def plots_of(content: "ReportContent") -> list[str]:
    """Return one SVG for each plot with data."""
    import matplotlib as mpl

    mpl.use("Agg")
    drawn = []
    for title, unit, lines in PLOTS:
        available = [(name, colour) for name, colour in lines if name in content.series]
        if available:
            drawn.append(_plot(content, title, unit, available))
    return drawn


def _plot(content: "ReportContent", title: str, unit: str, lines: list[tuple[str, str]]) -> str:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 2.3), layout="constrained")
    figure.patch.set_alpha(0.0)
    axes = figure.subplots()
    axes.patch.set_alpha(0.0)
    for name, colour in lines:
        axes.plot(
            content.times_s,
            content.series[name],
            color=colour,
            linewidth=1.0,
            label=LABELS.get(name, name),
        )
    for stop in content.stops:
        axes.axvline(stop.at_s, color="#e03131", linewidth=1.0, linestyle=":")
    axes.set_xlim(0.0, max(content.duration_s, 1e-3))
    axes.set_title(f"{title} [{unit}]", loc="left", fontsize=10, color=GREY)
    axes.set_xlabel("time [s]", fontsize=8, color=GREY)
    axes.tick_params(colors=GREY, labelsize=8)
    axes.grid(visible=True, color=GREY, alpha=0.2, linewidth=0.5)
    for spine in axes.spines.values():
        spine.set_visible(False)
    if len(lines) > 1:
        axes.legend(
            loc="lower right",
            bbox_to_anchor=(1.0, 1.0),
            ncols=len(lines),
            fontsize=8,
            frameon=False,
            labelcolor=GREY,
            borderaxespad=0.0,
        )
    text = io.StringIO()
    figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
    svg = text.getvalue()
    return re.sub(r"<metadata>.*?</metadata>", "", svg[svg.index("<svg") :], flags=re.DOTALL)
