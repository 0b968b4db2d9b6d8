"""Packet page generator: write the packet table into controller/README.md."""

from pathlib import Path

from controller.packet_table import TABLE, PacketValues

PAGE = Path(__file__).resolve().parent.parent / "controller" / "README.md"
BEGIN, END = "<!-- packet table: made by `make readme` -->", "<!-- end of the packet table -->"


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


def with_table(text: str) -> str:
    """Return the page with the current table between its marks."""
    before, rest = text.split(BEGIN)
    after = rest.split(END)[1]
    return f"{before}{BEGIN}\n{packet_table()}\n{END}{after}"


def main() -> None:
    """Write the page."""
    PAGE.write_text(with_table(PAGE.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
