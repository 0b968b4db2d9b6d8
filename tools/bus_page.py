"""Write the bus table of forcemesh/topics.py into README.md."""

from pathlib import Path

from forcemesh.topics import REQUESTS, TOPICS

ROOT = Path(__file__).resolve().parent.parent
README = ROOT / "README.md"
BEGIN, END = "<!-- bus table: made by `make readme` -->", "<!-- end of the bus table -->"


def bus_table() -> str:
    """Return topics and requests as Markdown."""
    lines = ["| topic | written by | read by | rate | what |", "|---|---|---|---|---|"]
    for topic in TOPICS:
        readers = ", ".join(topic.readers)
        lines.append(
            f"| `{topic.key}` | {topic.writer} | {readers} | {topic.rate} | {topic.summary} |"
        )
    lines += ["", "| request | answered by | what |", "|---|---|---|"]
    for request in REQUESTS:
        lines.append(f"| `{request.key}` | {request.server} | {request.summary} |")
    return "\n".join(lines)


def with_table(text: str) -> str:
    """Return the page with the present table between its marks."""
    before, rest = text.split(BEGIN)
    after = rest.split(END)[1]
    return f"{before}{BEGIN}\n{bus_table()}\n{END}{after}"


def main() -> None:
    """Write the page."""
    README.write_text(with_table(README.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
