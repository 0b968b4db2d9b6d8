"""The verb `watch`: one topic, decoded, live."""

import json
import sys
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cli.context import NO_ANSWER, USAGE, CellOption, client_of, fail

if TYPE_CHECKING:
    from common.codec import Header
    from common.endpoints import Reader
    from common.messages import Message
    from common.topics import Topic

POLL_S = 0.001
SILENCE_S = 3.0  # the slowest topic comes once a second
REFRESH_HZ = 10


def watch(
    topic: Annotated[str, typer.Argument(metavar="TOPIC", help="As `forcemesh topics` lists it.")],
    count: Annotated[
        int | None, typer.Option(min=1, help="End after so many messages.", show_default=False)
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="One JSON object a line, header and message flat.")
    ] = False,
    cell: CellOption = None,
) -> None:
    """Show what is said on a topic until Ctrl-C, or so many messages."""
    row = find_topic(topic)
    with client_of(cell) as (_, bus):
        reader = bus.reader(row)
        try:
            if as_json:
                for header, message in messages(reader, count):
                    sys.stdout.write(json.dumps(header.model_dump() | message.model_dump()) + "\n")
                    sys.stdout.flush()
            else:
                _show(reader, count)
        except KeyboardInterrupt:
            raise typer.Exit(0) from None


def find_topic(name: str) -> "Topic[Message]":
    """Return a row of the bus; an unknown name ends the verb with the nearest one."""
    import difflib

    from common.topics import TOPICS

    rows = {topic.key: topic for topic in TOPICS}
    if name not in rows:
        near = difflib.get_close_matches(name, rows, n=1, cutoff=0.4)
        hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(rows)}"
        fail(f"no topic is called {name!r}: {hint}", USAGE)
    return rows[name]


def messages(reader: "Reader[Message]", count: int | None) -> "Iterator[tuple[Header, Message]]":
    """Yield each message that comes; end the verb after a silence."""
    heard_s = time.monotonic()
    last = 0
    while count is None or last < count:
        reading = reader.read(time.monotonic_ns())
        if reader.counters.received > last and reading.header and reading.message:
            last, heard_s = reader.counters.received, time.monotonic()
            yield reading.header, reading.message
        elif time.monotonic() - heard_s > SILENCE_S:
            why = reader.counters.last_error or "is its writer alive?"
            fail(f"nothing on {reader.topic.key} for {SILENCE_S:g} s: {why}", NO_ANSWER)
        else:
            time.sleep(POLL_S)


def _show(reader: "Reader[Message]", count: int | None) -> None:
    """Keep one table up to date: fields, rate and age."""
    from rich.console import Console
    from rich.live import Live

    started_s, seen, shown_s = time.monotonic(), 0, 0.0
    console = Console()
    with Live(console=console, auto_refresh=False) as live:
        for header, message in messages(reader, count):
            seen, now_s = seen + 1, time.monotonic()
            if now_s - shown_s >= 1.0 / REFRESH_HZ or seen == count:
                shown_s = now_s
                rate_hz = (seen - 1) / (now_s - started_s) if seen > 1 else 0.0
                table = _table(reader, header, message, rate_hz=rate_hz)
                live.update(table, refresh=console.is_terminal or seen == count)


def _table(
    reader: "Reader[Message]", header: "Header", message: "Message", *, rate_hz: float
) -> Any:
    from rich.table import Table

    age_ms = (time.monotonic_ns() - header.stamp_ns) / 1e6
    caption = f"seq {header.seq}, {rate_hz:.1f} Hz, written {age_ms:.1f} ms ago"
    table = Table("field", "value", title=reader.topic.key, caption=caption)
    for name, value in message.model_dump().items():
        table.add_row(name, _text(value))
    return table


def _text(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, tuple | list):
        return "  ".join(_text(item) for item in value)
    if isinstance(value, dict):
        return "\n".join(f"{key}: {_text(item)}" for key, item in value.items())
    return str(value)
