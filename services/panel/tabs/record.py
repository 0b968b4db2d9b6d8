"""Record tab: start and stop a recording, status of the recorder."""

import viser

from forcemesh import topics
from forcemesh.client import Cell
from forcemesh.errors import BusError
from forcemesh.messages import RecorderStatus
from forcemesh.requests import Empty, RecordRequest
from services.panel.markup import Html, html, paragraphs
from services.panel.tabs import Refresh, Tab
from services.panel.viewer import Prose, Viewer, put
from services.panel.watch import Snapshot

RECORDER_REPLY_S = 15.0  # the recorder writes pending data before it replies
NO_RECORDER = "⚠ no data from the recorder: `forcemesh up` starts it; `forcemesh status` shows more"


def build(viewer: Viewer) -> Refresh:
    """Fill the tab."""
    gui = viewer.gui
    now = Prose(gui, paragraphs("…"))
    label = gui.add_text("Label", "", hint="Part of the file name.")
    past = gui.add_checkbox("Include ring buffer", initial_value=False)

    def begin(cell: Cell) -> str:
        request = RecordRequest(label=label.value[:100], past=past.value)
        return cell.ask(topics.RECORD_START, request, answer_s=RECORDER_REPLY_S).text

    def end(cell: Cell) -> str:
        return cell.ask(topics.RECORD_STOP, Empty(), answer_s=RECORDER_REPLY_S).text

    start = viewer.button(
        "Start recording", lambda: viewer.do("Record", begin), icon=viser.Icon.PLAYER_RECORD
    )
    stop = viewer.button(
        "Stop recording",
        lambda: viewer.do("Stop recording", end),
        icon=viser.Icon.PLAYER_STOP,
        disabled=True,
    )

    def refresh(_snapshot: Snapshot) -> None:
        status = recorder_status(viewer)
        now.show(words(status))
        records = status is not None and status.recording
        asked = status is not None and records and status.cause == "asked"
        put(start, disabled=asked or status is None)
        put(stop, disabled=not records)

    return refresh


def recorder_status(viewer: Viewer) -> RecorderStatus | None:
    """Return the recorder's status, None while none is received."""
    try:
        reading = viewer.watch.client.feed(topics.RECORDER_STATUS).reading()
    except BusError:
        return None
    return None if reading.silent else reading.message


def words(status: RecorderStatus | None) -> Html:
    """Return the recorder's status as text."""
    if status is None:
        return paragraphs(NO_RECORDER)
    lines: list[Html | str] = [f"⚠ {status.reason}"] if status.reason else []
    file = status.file.rpartition("/")[2]
    if status.recording:
        asked = status.cause == "asked"
        why = html("") if asked else html(", started by <code>{}</code>", status.cause)
        lines.append(html("<b>● recording</b> for {} s{}", f"{status.recorded_s:.0f}", why))
    else:
        lines.append("not recording")
    if file:
        lines.append(
            html("<code>{}</code>: {} messages, {} lost", file, status.messages, status.lost)
        )
    lines.append(
        f"Ring buffer: {status.memory_s:.0f} s, written to a file when the arm is stopped. "
        f"Free disk space: {status.free_bytes / 1e9:.1f} GB."
    )
    return paragraphs(*lines)


TAB = Tab(80, "Record", viser.Icon.PLAYER_RECORD, build)
