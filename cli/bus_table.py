"""Table of topics and requests with the rates of one cell."""

from typing import Any

from common.config.cell import CellConfig
from forcemesh.topics import REQUESTS, TOPICS


def bus_table(cell: CellConfig) -> dict[str, Any]:
    """Return the table as a dict for JSON."""
    return {
        "cell": cell.cell,
        "topics": [
            {
                "topic": topic.key,
                "key": f"{cell.cell}/{topic.key}",
                "message": topic.message.__name__,
                "writer": topic.writer,
                "readers": list(topic.readers),
                "rate_hz": cell.rate_hz(topic),
                "stale_after_s": cell.stale_after_s(topic),
                "qos": topic.qos,
                "summary": topic.summary,
            }
            for topic in TOPICS
        ],
        "requests": [
            {
                "request": request.key,
                "key": f"{cell.cell}/{request.key}",
                "message": request.message.__name__,
                "server": request.server,
                "summary": request.summary,
            }
            for request in REQUESTS
        ],
    }


def print_bus_table(cell: CellConfig) -> None:
    """Print the table on the terminal."""
    from rich.table import Table

    from cli.tables import print_table, table_console

    table = bus_table(cell)
    topics = Table("topic", "writer", "readers", "rate", "stale after", "summary", title="topics")
    for row in table["topics"]:
        topics.add_row(
            row["topic"],
            row["writer"],
            ", ".join(row["readers"]),
            f"{row['rate_hz']:g} Hz",
            f"{1e3 * row['stale_after_s']:.0f} ms",
            row["summary"],
        )
    requests = Table("request", "server", "summary", title="requests")
    for row in table["requests"]:
        requests.add_row(row["request"], row["server"], row["summary"])
    console = table_console()
    console.print(f"every key has the prefix [bold]{cell.cell}/[/bold]")
    print_table(console, topics)
    print_table(console, requests)
