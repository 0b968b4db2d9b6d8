"""Verb `watch`: one topic decoded live, or all topics with rate and age."""

import json
import sys
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cli.context import USAGE, CellOption, cell_of, exit_with_error

if TYPE_CHECKING:
    from common.bus.configured_cell import ConfiguredCell
    from forcemesh.client import Feed, Received
    from forcemesh.messages import Message
    from forcemesh.topics import Topic

SILENCE_S = 3.0  # the slowest topic comes four times a second
REFRESH_HZ = 10
TABLE_S = 0.5  # between two tables of all topics
FIRST_S = 1.0  # until the first one: a rate needs some messages


def _topics(typed: str) -> list[str]:
    """Return the topics with a prefix, for the shell's completion."""
    from forcemesh.topics import TOPICS

    return [topic.key for topic in TOPICS if topic.key.startswith(typed)]


def watch(
    topic: Annotated[
        str | None,
        typer.Argument(
            metavar="[TOPIC]",
            help="As listed by `forcemesh topics`; default: all, with rate and age.",
            autocompletion=_topics,
            show_default=False,
        ),
    ] = None,
    count: Annotated[
        int | None,
        typer.Option(
            min=1, help="End after this number of messages or tables.", show_default=False
        ),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="One JSON object per line, header and message merged.")
    ] = False,
    cell: CellOption = None,
) -> None:
    """Show the messages of a topic, or rate and age of all topics, until Ctrl-C or --count."""
    row = None if topic is None else find_topic(topic)
    with cell_of(cell) as client:
        try:
            if row is None:
                _watch_all(client, count, as_json)
            elif as_json:
                for heard in _messages(client.feed(row), count):
                    fields = heard.header.model_dump() | heard.message.model_dump()
                    sys.stdout.write(json.dumps(fields) + "\n")
                    sys.stdout.flush()
            else:
                _show(client.feed(row), count)
        except KeyboardInterrupt:
            raise typer.Exit(0) from None


def find_topic(name: str) -> "Topic[Message]":
    """Return a topic by its name; an unknown name ends the verb with the nearest one."""
    import difflib

    from forcemesh.topics import TOPICS

    rows = {topic.key: topic for topic in TOPICS}
    if name not in rows:
        near = difflib.get_close_matches(name, rows, n=1, cutoff=0.4)
        hint = f"did you mean {near[0]}?" if near else f"choose from {', '.join(rows)}"
        exit_with_error(f"unknown topic {name!r}: {hint}", USAGE)
    return rows[name]


def _messages(feed: "Feed[Message]", count: int | None) -> "Iterator[Received[Message]]":
    for number, heard in enumerate(feed.stream(silence_s=SILENCE_S), 1):
        yield heard
        if number == count:
            return


# --- one topic ------------------------------------------------------------------------------------


def _show(feed: "Feed[Message]", count: int | None) -> None:
    """Show one table live: fields, rate and age."""
    from rich.console import Console
    from rich.live import Live

    started_s, seen, shown_s = time.monotonic(), 0, 0.0
    console = Console()
    with Live(console=console, auto_refresh=False) as live:
        for heard in _messages(feed, count):
            seen, now_s = seen + 1, time.monotonic()
            if now_s - shown_s >= 1.0 / REFRESH_HZ or seen == count:
                shown_s = now_s
                rate_hz = (seen - 1) / (now_s - started_s) if seen > 1 else 0.0
                table = _table(feed, heard, rate_hz=rate_hz)
                live.update(table, refresh=console.is_terminal or seen == count)


def _table(feed: "Feed[Message]", heard: "Received[Message]", *, rate_hz: float) -> Any:
    from rich.table import Table

    age_ms = (time.monotonic_ns() - heard.header.stamp_ns) / 1e6
    rate = f"{rate_hz:.1f} Hz, " if rate_hz else ""  # one message has none
    caption = f"seq {heard.header.seq}, {rate}published {age_ms:.1f} ms ago"
    table = Table("field", "value", title=feed.topic.key, caption=caption)
    for name, value in heard.message.model_dump().items():
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


# --- all topics -----------------------------------------------------------------------------------


def _watch_all(client: "ConfiguredCell", count: int | None, as_json: bool) -> None:
    from rich.console import Console
    from rich.live import Live

    from forcemesh.topics import TOPICS

    feeds = [client.feed(topic) for topic in TOPICS]
    _look(client, feeds, FIRST_S)
    console, shown = Console(), 0
    with Live(console=console, auto_refresh=False) as live:
        while count is None or shown < count:
            rows, shown = [_row(client, feed) for feed in feeds], shown + 1
            if as_json:
                sys.stdout.write(json.dumps({"topics": rows}) + "\n")
                sys.stdout.flush()
            else:
                live.update(_rows(client, rows), refresh=console.is_terminal or shown == count)
            if shown != count:
                _look(client, feeds, TABLE_S)


def _look(client: "ConfiguredCell", feeds: "list[Feed[Any]]", for_s: float) -> None:
    """Receive for a while: the rates are computed from the messages received."""
    clock = client.session.clock
    end_ns = clock.now_ns() + round(for_s * 1e9)
    while clock.now_ns() < end_ns:
        for feed in feeds:
            feed.reading()
        clock.sleep_s(0.1)


def _row(client: "ConfiguredCell", feed: "Feed[Message]") -> dict[str, Any]:
    reading = feed.reading()
    rate_hz = feed.rate_hz
    return {
        "topic": feed.topic.key,
        "writer": feed.topic.writer,
        "rate_hz": None if rate_hz is None else round(rate_hz, 1),
        "expected_hz": client.config.rate_hz(feed.topic),
        "age_s": None if reading.message is None else round(reading.age_s, 4),
        "stale_after_s": client.config.stale_after_s(feed.topic),
        "seq": None if reading.header is None else reading.header.seq,
        "fault": reading.fault,
    }


def _rows(client: "ConfiguredCell", rows: list[dict[str, Any]]) -> Any:
    from rich.table import Table

    table = Table(title=f"cell {client.config.cell}")
    for name in ("topic", "writer", "rate", "expected", "age", "stale after"):
        table.add_column(name, no_wrap=True)
    table.add_column("fault")
    for row in rows:
        colour = "red" if row["fault"] else "green"
        table.add_row(
            f"[{colour}]{row['topic']}[/]",
            row["writer"],
            "-" if row["rate_hz"] is None else f"{row['rate_hz']:.1f} Hz",
            f"{row['expected_hz']:g} Hz",
            "-" if row["age_s"] is None else f"{1e3 * row['age_s']:.1f} ms",
            f"{1e3 * row['stale_after_s']:.0f} ms",
            row["fault"],
        )
    return table
