"""Self-contained HTML pages of the command line: tables, and figures as embedded SVG."""

import base64
from collections.abc import Iterable, Sequence
from io import BytesIO
from pathlib import Path

from matplotlib import rc_context
from matplotlib.figure import Figure

from forcemesh.errors import DataError
from services.panel.markup import Html, html, joined


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
