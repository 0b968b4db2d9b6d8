"""Tables of the results in README.md and docs/: `python -m bench --render`.

A page shows a table in a block that names it, `<!-- measured over-tcp.bears -->` to
`<!-- end of over-tcp.bears -->`; the renderer writes the rows and the stamp of the result.
"""

import re
from collections.abc import Iterator
from pathlib import Path

from bench.results import RESULTS, ROOT, Cell, Table, read
from tools.figures import check_sum, pages

BLOCK = re.compile(
    r"<!-- measured (?P<name>(?P<result>[\w-]+)\.(?P<table>[\w-]+))[^\n]*-->\n"
    r"(?:.*?\n)??<!-- end of (?P=name) -->",
    re.DOTALL,
)
UNITS = {
    "core_pct": "% of a core", "pct": "%", "N_m": "N/m", "N_s": "N/s", "mm_s": "mm/s",
    "m_s2": "m/s²", "mN_m": "mN m", "kB_s": "kB/s", "N": "N", "mm": "mm", "deg": "degrees",
    "us": "us", "ms": "ms", "s": "s", "tau": "tau", "hz": "Hz", "mJ": "mJ", "MB": "MB",
    "rms_N": "N rms",
}  # fmt: skip
WORDS = {True: "yes", False: "**no**", None: "-"}


def heading(column: str) -> str:
    """Return the heading of a column: its name, with the unit in brackets."""
    for unit in sorted(UNITS, key=len, reverse=True):
        if column.endswith(f"_{unit}"):
            return f"{column.removesuffix(f'_{unit}').replace('_', ' ')} [{UNITS[unit]}]"
    return column.replace("_", " ")


def as_markdown(shown: Table) -> str:
    """Return a table of a page."""
    body = [
        [_cell(cell, form) for cell, form in zip(row, shown.columns.values(), strict=True)]
        for row in shown.rows
    ]
    ruler = ["---:" if form else "---" for form in shown.columns.values()]
    lines = [list(map(heading, shown.columns)), ruler, *body]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _cell(cell: Cell, form: str) -> str:
    if cell is None or isinstance(cell, bool):
        return WORDS[cell]
    return cell.replace("|", "/") if isinstance(cell, str) else format(cell, form)


def rendered(text: str, folder: Path = RESULTS) -> str:
    """Return a page with its blocks as the results are."""

    def block(found: re.Match[str]) -> str:
        result, name = read(found["result"], folder), found["name"]
        shown = as_markdown(result.tables[found["table"]])
        stamp = f"at {result.commit or 'unknown'}, {result.date}, check {check_sum(shown)}"
        mark = f"<!-- measured {name} by `{result.command}` {stamp} -->"
        return f"{mark}\n{shown}\n<!-- end of {name} -->"

    return BLOCK.sub(block, text)


def differing(root: Path = ROOT) -> Iterator[tuple[Path, str]]:
    """Yield the pages that do not show what the results are, and what they should be."""
    for page in pages(root):
        old = page.read_text(encoding="utf-8")
        new = rendered(old, root / "docs" / "results")
        if new != old:
            yield page, new
