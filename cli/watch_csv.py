"""Messages of a topic as a CSV file, one row each, with the columns of `forcemesh export`."""

import csv
import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TextIO

import msgspec

from cli.recording_tables import TIME
from forcemesh.clock import NS_PER_S
from forcemesh.errors import LostError
from services.recorder.layout import layout_of
from services.recorder.stamps import SequenceGaps

if TYPE_CHECKING:
    from common.bus.configured_cell import ConfiguredCell
    from forcemesh.messages import Message
    from forcemesh.topics import Topic

QUEUE = 4096  # messages that may wait: some seconds of the fastest topic
POLL_S = 0.01

Row = dict[str, Any]


class Written(NamedTuple):
    """Number of messages written, and of those that were published and did not arrive."""

    messages: int
    lost: int


def write_csv(
    client: "ConfiguredCell",
    topic: "Topic[Message]",
    path: Path,
    *,
    seconds: float | None,
    count: int | None,
    silence_s: float,
) -> Written:
    """Write every message of a topic, valid or not, until the duration or the number is reached.

    Args:
        client: A connected client.
        topic: The topic.
        path: A new file.
        seconds: Longest duration [s]; None: without end.
        count: Greatest number of messages; None: without end.
        silence_s: Longest wait for a message [s].

    Raises:
        FileExistsError: The file exists; it is kept.
        OSError: The file cannot be written.
        LostError: No message for `silence_s`; the messages before it are in the file.
        MessageError: A message is not of the topic's layout.
    """
    with path.open("x", newline="", encoding="utf-8") as stream:
        table, gaps, number = _Table(stream), SequenceGaps(), 0
        try:
            for row in _rows(client, topic, seconds=seconds, silence_s=silence_s):
                table.add(row)
                gaps.saw(0, row["epoch"], row["seq"])
                number += 1
                if number == count:
                    break
        except KeyboardInterrupt:
            pass  # the usual end
        finally:
            table.write()
    return Written(number, gaps.lost)


def _rows(
    client: "ConfiguredCell", topic: "Topic[Message]", *, seconds: float | None, silence_s: float
) -> Iterator[Row]:
    """Yield each message as a row."""
    source, clock = client.session.bus.tap(topic, QUEUE), client.session.clock
    layout = layout_of(topic)
    began_ns = received_ns = clock.now_ns()
    first_ns: int | None = None
    while seconds is None or clock.now_ns() - began_ns < seconds * NS_PER_S:
        if (data := source.take()) is None:
            if clock.now_ns() - received_ns > silence_s * NS_PER_S:
                raise LostError(f"nothing on {topic.key} for {silence_s:g} s")
            source.wait(POLL_S)
            continue
        received_ns = clock.now_ns()
        fields = msgspec.to_builtins(layout.change(layout.read(data)))
        first_ns = fields["stamp_ns"] if first_ns is None else first_ns
        time_s = (fields["stamp_ns"] - first_ns) / NS_PER_S
        yield {TIME: time_s, **dict(_cells(layout.schema, fields))}


def _cells(schema: dict[str, Any], value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield name and value of each column of a message; what it lacks is empty."""
    if schema["type"] == "object" and schema["properties"]:
        for name, inner in schema["properties"].items():
            part = None if value is None else value.get(name)
            yield from _cells(inner, part, f"{path}.{name}" if path else name)
    elif schema["type"] == "array" and schema["items"]["type"] == "number":
        yield from ((f"{path}.{index}", number) for index, number in enumerate(value or ()))
    elif isinstance(value, list | dict):
        yield path, json.dumps(value)  # of variable length: trips, texts
    else:
        yield path, value


class _Table:
    """Rows below the columns of the first valid message, which has all of its joints."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._writer: csv.DictWriter[str] | None = None
        self._waiting: list[Row] = []

    def add(self, row: Row) -> None:
        """Write a row, or keep it until the columns are known."""
        self._waiting.append(row)
        if self._writer is not None or row["valid"]:
            self.write()

    def write(self) -> None:
        """Write the rows that are kept."""
        if self._writer is None and self._waiting:
            self._writer = csv.DictWriter(self._stream, list(self._waiting[-1]), restval="")
            self._writer.writeheader()
        if self._writer is not None:
            self._writer.writerows(self._waiting)
        self._waiting = []
