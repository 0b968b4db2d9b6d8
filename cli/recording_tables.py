"""Tables of a recording or of a topic: a column for each number or text in a message."""

import csv
import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from common.bus.configured_cell import ConfiguredCell
from forcemesh.clock import NS_PER_S
from forcemesh.errors import DataError, LostError
from forcemesh.messages import Message
from forcemesh.topics import Topic
from services.recorder.layout import layout_of
from services.recorder.reading import RecordedFile, RecordedMessage
from services.recorder.stamps import SequenceGaps

Row = dict[str, Any]
TIME = "time_s"  # since the first message of the recording

STATE, WRENCH, ACTION = "observation.state", "observation.wrench", "action"
STATE_NAMES = tuple(f"joint_{number}_rad" for number in range(1, 7))
WRENCH_NAMES = ("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")
ACTION_NAMES = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
DONE = "next.done"
LEARNED = ("wrench", "robot/command", "robot/state")
QUEUE = 4096  # messages that may wait: some seconds of the fastest topic
POLL_S = 0.01


def flat_fields(fields: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield every scalar value with its dotted path."""
    if isinstance(fields, dict):
        for name, value in fields.items():
            yield from flat_fields(value, f"{path}.{name}" if path else name)
    elif isinstance(fields, list | tuple):
        for index, value in enumerate(fields):
            yield from flat_fields(value, f"{path}.{index}")
    else:
        yield path, fields


def shortened(value: Any, longest: int) -> str:
    """Return a value as text of at most so many characters, dots in place of the rest."""
    text = str(value)
    return text if len(text) <= longest else f"{text[: longest - 3]}..."


def first_ns(read: "RecordedFile") -> int:
    """Return when a recording begins. Raise DataError when it is empty."""
    begin = min((message.at_ns for message in read.messages()), default=None)
    if begin is None:
        raise DataError(f"{read.path}: the recording contains no message")
    return begin


def rows_of(messages: "Iterable[RecordedMessage]", begin_ns: int) -> list[Row]:
    """Return the rows of one topic; a value that a message lacks is left out of its row."""
    return [
        {TIME: (each.at_ns - begin_ns) / NS_PER_S, **dict(flat_fields(each.fields))}
        for each in messages
    ]


def learning_rows(read: "RecordedFile") -> list[Row]:
    """Return one row per robot/state, in the form for learning from demonstration.

    The state is the joint angles, the wrench is the newest at that time, the action is the flange
    pose commanded at that time, or without a command the measured pose. Rows before the first
    wrench are left out.
    """
    rows: list[Row] = []
    wrench: list[float] | None = None
    action: list[float] | None = None
    start_ns = 0
    used = [
        message
        for message in read.messages()
        if message.topic in LEARNED and message.fields.get("valid", True)
    ]
    for message in sorted(used, key=lambda each: each.at_ns):
        fields = message.fields
        if message.topic == "wrench":
            wrench = [*fields["force_N"].values(), *fields["torque_Nm"].values()]
        elif message.topic == "robot/command":
            pose = fields.get("pose")
            action = _pose(pose) if pose is not None else None
        elif wrench is not None:
            start_ns = start_ns or message.at_ns
            rows.append(
                {
                    STATE: [float(angle) for angle in fields["joint_rad"]],
                    WRENCH: wrench,
                    ACTION: action or _pose(fields),
                    "timestamp": (message.at_ns - start_ns) / NS_PER_S,
                    "frame_index": len(rows),
                    "episode_index": 0,
                    "index": len(rows),
                    "task_index": 0,
                    DONE: False,
                }
            )
    if not rows:
        raise DataError(f"{read.path}: the recording lacks robot/state or wrench")
    rows[-1][DONE] = True
    return rows


def _pose(fields: Any) -> list[float]:
    return [*fields["position_m"].values(), *fields["orientation_xyzw"].values()]


# --- a topic of a cell that is up -----------------------------------------------------------------


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
        writer: csv.DictWriter[str] | None = None
        waiting: list[Row] = []
        gaps, number = SequenceGaps(), 0

        def write_waiting() -> None:
            nonlocal writer
            if writer is None and waiting:
                writer = csv.DictWriter(stream, list(waiting[-1]), restval="")
                writer.writeheader()
            if writer is not None:
                writer.writerows(waiting)
            waiting.clear()

        try:
            for row in _rows(client, topic, seconds=seconds, silence_s=silence_s):
                waiting.append(row)
                # The first valid message has all joints of the arm: it gives the columns.
                if writer is not None or row["valid"]:
                    write_waiting()
                gaps.saw(0, row["epoch"], row["seq"])
                number += 1
                if number == count:
                    break
        except KeyboardInterrupt:
            pass  # the usual end
        finally:
            write_waiting()
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
