"""Verb `watch`: one topic decoded live or into a file, or all topics with rate and age."""

import difflib
import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from typer import Argument, Exit, Option, echo

from cli.context import CellOption, cell_of, exit_with_error
from forcemesh.clock import NS_PER_S
from forcemesh.messages import Message
from forcemesh.topics import TOPICS, Topic

if TYPE_CHECKING:
    from common.bus.configured_cell import ConfiguredCell
    from forcemesh.client import Feed, Received

SILENCE_S = 3.0  # the slowest topic comes four times a second
REFRESH_HZ = 10
TABLE_S = 0.5  # between two tables of all topics
FIRST_S = 1.0  # until the first one: a rate needs some messages


class WatchEnd(NamedTuple):
    """After how many messages or tables, and after what time, watching ends; None: never."""

    number: int | None
    seconds: float | None


def _topics(typed: str) -> list[str]:
    """Return the topics with a prefix, for the shell's completion."""
    return [topic.key for topic in TOPICS if topic.key.startswith(typed)]


def watch(
    topic: Annotated[
        str | None,
        Argument(
            metavar="[TOPIC]",
            help="As listed by `forcemesh topics`; default: all, with rate and age.",
            autocompletion=_topics,
        ),
    ] = None,
    *,
    count: Annotated[
        int | None,
        Option(min=1, help="End after this number of messages or tables."),
    ] = None,
    seconds: Annotated[
        float | None,
        Option(min=0.1, help="End after this time [s]."),
    ] = None,
    as_json: Annotated[
        bool, Option("--json", help="One JSON object per line, header and message merged.")
    ] = False,
    csv: Annotated[
        Path | None,
        Option(
            "--csv",
            metavar="FILE",
            help="Write every message of the topic into a new file, one row each.",
        ),
    ] = None,
    cell: CellOption = None,
) -> None:
    """Show the messages of a topic, or rate and age of all topics.

    It ends with Ctrl-C, or after --count or --seconds.
    """
    row = None if topic is None else find_topic(topic)
    if csv is not None and (row is None or as_json):
        exit_with_error("--csv FILE takes one topic, and no --json: watch wrench --csv FILE")
    end = WatchEnd(count, seconds)
    with cell_of(cell) as client:
        try:
            if row is None:
                _watch_all(client, end, as_json)
            elif csv is not None:
                _write_csv(client, row, csv, end)
            elif as_json:
                for received in _messages(client.feed(row), end):
                    fields = received.header.as_dict() | received.message.as_dict()
                    print(json.dumps(fields), flush=True)
            else:
                _show_topic(client.feed(row), end)
        except KeyboardInterrupt:
            raise Exit(0) from None


def find_topic(name: str) -> "Topic[Message]":
    """Return a topic by its name; an unknown name ends the verb with the nearest one."""
    rows = {topic.key: topic for topic in TOPICS}
    if name not in rows:
        matches = difflib.get_close_matches(name, rows, n=1, cutoff=0.4)
        hint = f"did you mean {matches[0]}?" if matches else f"choose from {', '.join(rows)}"
        exit_with_error(f"unknown topic {name!r}: {hint}")
    return rows[name]


def _messages(feed: "Feed[Message]", end: WatchEnd) -> "Iterator[Received[Message]]":
    for number, received in enumerate(feed.stream(seconds=end.seconds, silence_s=SILENCE_S), 1):
        yield received
        if number == end.number:
            return


def _write_csv(
    client: "ConfiguredCell", topic: "Topic[Message]", path: Path, end: WatchEnd
) -> None:
    from cli.recording_tables import write_csv

    try:
        written = write_csv(
            client, topic, path, seconds=end.seconds, count=end.number, silence_s=SILENCE_S
        )
    except FileExistsError:
        exit_with_error(f"{path} exists: choose the name of a new file")
    except OSError as error:
        exit_with_error(f"{path}: cannot be written: {error.strerror}")
    echo(f"{path}: {written.messages} messages of {topic.key}, {written.lost} lost")


# --- one topic ------------------------------------------------------------------------------------


def _show_topic(feed: "Feed[Message]", end: WatchEnd) -> None:
    """Show one table live: fields, rate and age."""
    from rich.live import Live

    from cli.tables import table_console

    started_s, count, shown_s = time.monotonic(), 0, 0.0
    console = table_console()
    with Live(console=console, auto_refresh=False) as live:
        for received in _messages(feed, end):
            count, now_s = count + 1, time.monotonic()
            if now_s - shown_s >= 1.0 / REFRESH_HZ or count == end.number:
                shown_s = now_s
                rate_hz = (count - 1) / (now_s - started_s) if count > 1 else 0.0
                # Without a terminal rich prints the last table when it ends.
                live.update(
                    _message_table(feed, received, rate_hz=rate_hz), refresh=console.is_terminal
                )


def _message_table(feed: "Feed[Message]", received: "Received[Message]", *, rate_hz: float) -> Any:
    from rich.table import Table

    age_ms = (time.monotonic_ns() - received.header.stamp_ns) / 1e6
    rate = f"{rate_hz:.1f} Hz, " if rate_hz else ""  # one message has none
    caption = f"seq {received.header.seq}, {rate}published {age_ms:.1f} ms ago"
    table = Table(title=feed.topic.key, caption=caption)
    for name in ("field", "value"):
        table.add_column(name, overflow="fold")  # nothing is cut
    for name, value in received.message.as_dict().items():
        table.add_row(name, _value_text(value))
    return table


def _value_text(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, tuple | list):
        return "  ".join(_value_text(item) for item in value)
    if isinstance(value, dict):
        return "\n".join(f"{key}: {_value_text(item)}" for key, item in value.items())
    return str(value)


# --- all topics -----------------------------------------------------------------------------------


def _watch_all(client: "ConfiguredCell", end: WatchEnd, as_json: bool) -> None:
    from rich.live import Live

    from cli.tables import table_console

    feeds = [client.feed(topic) for topic in TOPICS]
    _receive(client, feeds, FIRST_S)
    clock, console, shown = client.session.clock, table_console(), 0
    began_ns = clock.now_ns()
    with Live(console=console, auto_refresh=False) as live:
        while shown != end.number:
            rows, shown = [_topic_row(client, feed) for feed in feeds], shown + 1
            if as_json:
                print(json.dumps({"topics": rows}), flush=True)
            else:
                live.update(_topic_table(client, rows), refresh=console.is_terminal)
            if end.seconds is not None and clock.now_ns() - began_ns >= end.seconds * NS_PER_S:
                return
            if shown != end.number:
                _receive(client, feeds, TABLE_S)


def _receive(client: "ConfiguredCell", feeds: "list[Feed[Any]]", for_s: float) -> None:
    """Receive for a while: the rates are computed from the messages received."""
    clock = client.session.clock
    end_ns = clock.now_ns() + round(for_s * 1e9)
    while clock.now_ns() < end_ns:
        for feed in feeds:
            feed.reading()
        clock.sleep_s(0.1)


def _topic_row(client: "ConfiguredCell", feed: "Feed[Message]") -> dict[str, Any]:
    reading = feed.reading()
    rate_hz, occasional = feed.rate_hz, feed.topic.occasional
    return {
        "topic": feed.topic.key,
        "writer": feed.topic.writer,
        "rate_hz": None if rate_hz is None else round(rate_hz, 1),
        "expected_hz": None if occasional else client.config.rate_hz(feed.topic),
        "age_s": None if reading.message is None else round(reading.age_s, 4),
        "stale_after_s": None if occasional else client.config.stale_after_s(feed.topic),
        "seq": None if reading.header is None else reading.header.seq,
        "fault": "" if occasional and reading.silent else reading.fault,
    }


def _topic_table(client: "ConfiguredCell", rows: list[dict[str, Any]]) -> Any:
    from rich.table import Table

    table = Table(title=f"cell {client.config.cell}")
    table.add_column("topic", overflow="fold")  # a name is never cut
    for name in ("writer", "rate", "expected", "age", "stale after"):
        table.add_column(name, no_wrap=True)
    table.add_column("fault")
    for row in rows:
        colour = "red" if row["fault"] else "green"
        table.add_row(
            f"[{colour}]{row['topic']}[/]",
            row["writer"],
            "-" if row["rate_hz"] is None else f"{row['rate_hz']:.1f} Hz",
            "-" if row["expected_hz"] is None else f"{row['expected_hz']:g} Hz",
            "-" if row["age_s"] is None else f"{1e3 * row['age_s']:.1f} ms",
            "-" if row["stale_after_s"] is None else f"{1e3 * row['stale_after_s']:.0f} ms",
            row["fault"],
        )
    return table
