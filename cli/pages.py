"""Self-contained HTML pages of the command line: tables, and figures as embedded SVG."""

import base64
from collections.abc import Iterable, Sequence
from io import BytesIO
from pathlib import Path

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from forcemesh.errors import DataError
from services.panel.markup import Html, html, joined

GREY = "#868e96"  # readable on white and on black


def write_page(page: Html, path: Path) -> None:
    """Write a page. Raises DataError when it cannot be written."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(str(page), encoding="utf-8")
    except OSError as error:
        raise DataError(f"{path}: cannot be written: {error.strerror}") from error


def table(head: Sequence[object], rows: Iterable[Sequence[object]]) -> Html:
    """Return a table; the first cell of each row is its heading."""
    lines = [joined(html("<th>{}</th>", cell) for cell in head)] if head else []
    for first, *others in rows:
        cells = joined(html("<td>{}</td>", cell) for cell in others)
        lines.append(html("<th>{}</th>{}", first, cells))
    return html("<table>{}</table>", joined((html("<tr>{}</tr>", line) for line in lines), "\n"))


def picture(text: str, figure: "Figure") -> Html:
    """Return a figure as an image with an alternative text; its letters are outlines."""
    out = BytesIO()
    with rc_context({"svg.hashsalt": "forcemesh"}):  # reproducible output
        figure.savefig(out, format="svg", metadata={"Date": None})
    data = base64.b64encode(out.getvalue()).decode()
    return html('<img alt="{}" src="data:image/svg+xml;base64,{}">', text, data)


def chart(title: str, x_label: str) -> tuple[Figure, Axes]:
    """Return an empty chart of the width of a page, for a light and a dark background."""
    figure = Figure(figsize=(9, 2.3), layout="constrained")
    figure.patch.set_alpha(0.0)
    axes = figure.subplots()
    axes.patch.set_alpha(0.0)
    axes.set_title(title, loc="left", fontsize=10, color=GREY)
    axes.set_xlabel(x_label, fontsize=8, color=GREY)
    axes.tick_params(which="both", colors=GREY, labelsize=8)
    axes.grid(visible=True, color=GREY, alpha=0.2, linewidth=0.5)
    axes.spines[:].set_visible(False)
    return figure, axes


def legend_above(axes: Axes) -> None:
    """Add a legend of one line above a chart, on the right."""
    axes.legend(
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=len(axes.get_legend_handles_labels()[1]),
        fontsize=8,
        frameon=False,
        labelcolor=GREY,
        borderaxespad=0.0,
    )
