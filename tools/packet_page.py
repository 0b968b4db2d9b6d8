"""Packet page generator: the packet table, and what protocol plain lacks, into their pages."""

from pathlib import Path

from controller.packet_table import TABLE, PacketValues
from controller.plain import NOT_PROTECTED

_ROOT = Path(__file__).resolve().parent.parent


def packet_table() -> str:
    """Return the table as Markdown: a line for each command and report, or for each Param."""
    lines = ["| Com | name | Param | Vec |", "|---|---|---|---|"]
    for row in TABLE.values():
        params = row.params
        span = f"{params[0]}" if len(params) == 1 else f"{params[0]} to {params[-1]}"
        each = [str(param) for param in params] if len(row.vectors) > 1 else [span]
        for param, numbers in zip(each, row.vectors, strict=True):
            lines.append(f"| {int(row.com)} | {row.com.name} | {param} | {_vector(numbers)} |")
    return "\n".join(lines)


def _vector(numbers: PacketValues) -> str:
    return ", ".join([number.label for number in numbers] + ["0"] * (6 - len(numbers)))


def plain_table() -> str:
    """Return the table of the protections that plain.as lacks as Markdown."""
    rows = [f"| {row.ours} | {row.plain} |" for row in NOT_PROTECTED]
    return "\n".join(["| `forcemesh.as` | `plain.as` |", "|---|---|", *rows])


PAGES = {
    _ROOT / "controller" / "README.md": ("packet table", packet_table),
    _ROOT / "docs" / "controller.md": ("protocol plain", plain_table),
}


def written(page: Path) -> str:
    """Return the page with the current table between its marks."""
    name, table = PAGES[page]
    begin, end = f"<!-- {name}: made by `make readme` -->", f"<!-- end of the {name} -->"
    before, rest = page.read_text(encoding="utf-8").split(begin)
    after = rest.split(end)[1]
    return f"{before}{begin}\n{table()}\n{end}{after}"


def main() -> None:
    """Write the pages."""
    for page in PAGES:
        page.write_text(written(page), encoding="utf-8")


if __name__ == "__main__":
    main()
