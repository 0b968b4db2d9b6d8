"""Bus page generator: write the tables of forcemesh/topics.py into docs/bus.md."""

from pathlib import Path

from forcemesh.topics import REQUESTS, TOPICS

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "bus.md"
BEGIN, END = "<!-- bus table: made by `make readme` -->", "<!-- end of the bus table -->"


def bus_table() -> str:
    """Return topics and requests as Markdown."""
    lines = [
        "| topic | writer | readers | rate | deadline | content |",
        "|---|---|---|---|---|---|",
    ]
    for topic in TOPICS:
        readers = ", ".join(topic.readers)
        rate, deadline = ("-", "-") if topic.occasional else (topic.rate, topic.deadline)
        row = (f"`{topic.key}`", topic.writer, readers, rate, deadline, topic.summary)
        lines.append(f"| {' | '.join(row)} |")
    lines += ["", "| request | server | effect |", "|---|---|---|"]
    for request in REQUESTS:
        lines.append(f"| `{request.key}` | {request.server} | {request.summary} |")
    return "\n".join(lines)


def with_table(text: str) -> str:
    """Return the page with the current tables between its marks."""
    before, rest = text.split(BEGIN)
    after = rest.split(END)[1]
    return f"{before}{BEGIN}\n{bus_table()}\n{END}{after}"


def main() -> None:
    """Write the page."""
    PAGE.write_text(with_table(PAGE.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
