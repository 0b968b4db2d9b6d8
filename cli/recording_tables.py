"""Tables of a recording: one per topic, with a column for each number or text in it."""

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

from forcemesh.clock import NS_PER_S
from forcemesh.errors import DataError

if TYPE_CHECKING:
    from services.recorder.reading import RecordedFile, RecordedMessage

Row = dict[str, Any]
TIME = "time_s"  # since the first message of the recording

STATE, WRENCH, ACTION = "observation.state", "observation.wrench", "action"
STATE_NAMES = tuple(f"joint_{number}_rad" for number in range(1, 7))
WRENCH_NAMES = ("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")
ACTION_NAMES = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
DONE = "next.done"


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


def first_ns(read: "RecordedFile") -> int:
    """Return when a recording begins. Raise DataError when it is empty."""
    begin = min((message.at_ns for message in read.messages()), default=None)
    if begin is None:
        raise DataError(f"{read.path}: the recording contains no message")
    return begin


def table_of(messages: "Iterable[RecordedMessage]", begin_ns: int) -> tuple[list[str], list[Row]]:
    """Return columns and rows of one topic; a value that a message lacks is left out of its row."""
    rows = [
        {TIME: (each.at_ns - begin_ns) / NS_PER_S, **dict(flat_fields(each.fields))}
        for each in messages
    ]
    columns: dict[str, None] = {}
    for row in rows:
        columns.update(dict.fromkeys(row))
    return list(columns), rows


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
    for message in sorted(_learning_messages(read), key=lambda each: each.at_ns):
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


def _learning_messages(read: "RecordedFile") -> "list[RecordedMessage]":
    plotted = ("wrench", "robot/command", "robot/state")
    return [
        message
        for message in read.messages()
        if message.topic in plotted and message.fields.get("valid", True)
    ]


def _pose(fields: Any) -> list[float]:
    return [*fields["position_m"].values(), *fields["orientation_xyzw"].values()]
