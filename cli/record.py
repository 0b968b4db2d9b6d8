"""Verbs `record ...`: requests to the recorder, which `up` and `demo` start as a helper."""

from typing import Annotated

from typer import Argument, Exit, Option, Typer

from cli.context import NOT_WELL, OK, CellOption, JsonOption, cell_of, print_reply
from forcemesh import topics
from forcemesh.errors import NotValidError
from forcemesh.messages import RecorderStatus
from forcemesh.requests import Empty, RecordRequest

WITHOUT_VARIABLE = "FORCEMESH_NO_RECORDER"
RECORDER_REPLY_S = 15.0  # it first writes its buffer, on a busy machine

record = Typer(
    no_args_is_help=True, help="Record every topic of a cell that is up, as an MCAP file."
)

NoRecorder = Annotated[
    bool,
    Option("--no-recorder", envvar=WITHOUT_VARIABLE, help="Do not start the recorder."),
]


@record.command("start")
def record_start(
    label: Annotated[str, Argument(help="Part of the file name.")] = "",
    *,
    past: Annotated[
        bool, Option("--past", help="Include the minutes in the recorder's ring buffer.")
    ] = False,
    cell: CellOption = None,
) -> None:
    """Record until `record stop`; a file at its size limit is followed by the next one."""
    with cell_of(cell) as client:
        request = RecordRequest(label=label[:100], past=past)
        print_reply(client.ask(topics.RECORD_START, request, answer_s=RECORDER_REPLY_S))


@record.command("stop")
def record_stop(cell: CellOption = None) -> None:
    """End the recording; print its content and the lost messages."""
    with cell_of(cell) as client:
        print_reply(client.ask(topics.RECORD_STOP, Empty(), answer_s=RECORDER_REPLY_S))


@record.command("status")
def record_status(as_json: JsonOption = False, cell: CellOption = None) -> None:
    """Show the recording, the lost messages, and the length of the ring buffer."""
    with cell_of(cell) as client:
        feed = client.feed(topics.RECORDER_STATUS)
        try:
            status = feed()
        except NotValidError:
            status = feed.reading().message or topics.RECORDER_STATUS.message()
    print(status.as_json() if as_json else status_text(status))
    raise Exit(OK if status.valid else NOT_WELL)


def status_text(status: "RecorderStatus") -> str:
    """Return the recorder's status as a few lines of text."""
    lines = [f"fault: {status.reason}"] if status.reason else []
    if status.recording:
        cause = "" if status.cause == "asked" else f" because of {status.cause}"
        lines.append(f"recording{cause} for {status.recorded_s:.0f} s to {status.file}")
    else:
        lines.append("not recording" + (f"; last: {status.file}" if status.file else ""))
    if status.file:
        size_MB = status.file_bytes / 1e6
        lines.append(f"{status.messages} messages, {status.lost} lost, file of {size_MB:.1f} MB")
    memory_MB, free_GB = status.memory_bytes / 1e6, status.free_bytes / 1e9
    lines.append(
        f"ring buffer: {status.memory_s:.0f} s ({memory_MB:.1f} MB); {free_GB:.1f} GB free"
    )
    return "\n".join(lines)
