"""Write the bus table of common/topics.py into README.md; `--check` only looks for it."""

import sys
from pathlib import Path

from common.topics import REQUESTS, TOPICS

README = Path(__file__).resolve().parent.parent / "README.md"
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


def main() -> int:
    """Write or check the page."""
    text = README.read_text(encoding="utf-8")
    wanted = with_table(text)
    if "--check" in sys.argv[1:]:
        return 0 if text == wanted else 1
    README.write_text(wanted, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
