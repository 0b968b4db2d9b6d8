"""Resource use and message loss of the recorder: in operation, and when killed.

`python -m bench.recorder --minutes 10 --write`: the arm of the simulated cell presses while its
recorder records; afterwards every message in the files is counted. Then recorders are killed.
"""

import argparse
import os
import random
import signal
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

from common.bus.configured_cell import ConfiguredCell as Client
from common.config.load import dump_cell, load_cell
from forcemesh import topics
from forcemesh.requests import Empty, RecordRequest
from forcemesh.zenoh_settings import ENDPOINT_VARIABLE
from launch.processes import Supervisor
from launch.started_process import ChildProcess, ProcessSpec, write_stderr_line
from services.recorder.reading import RecordedFile
from services.recorder.stamps import SequenceGaps
from tests.chaos.common_net import free_port

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "recordings.md"
BEGIN, END = "<!-- measured: python -m bench.recorder --minutes 10 --write -->", "<!-- end -->"
PRESS_N = 15.0
KILLS = 5
KILL_AFTER_S = (2.0, 4.0)
WARM_UP_S = 2.0
MOST_CPU_PCT = 3.0
MOST_MISSING_S = 1.0
WITHIN_S = 60.0
TICKS_HZ = os.sysconf("SC_CLK_TCK")


@dataclass(slots=True)
class RecordingRun:
    """Measurements of a recording."""

    minutes: float
    messages: int  # found in the files
    lost: int  # from gaps in the sequence numbers in the files
    lost_reported: int  # by the recorder's own count
    cpu_pct: float  # of one core, while it records
    idle_cpu_pct: float  # without a recording
    memory_MB: float  # of the process
    file_MB: float
    files: int
    pressed: bool  # the arm pressed until the end
    load: float  # mean number of runnable tasks

    @property
    def good(self) -> bool:
        """Whether the limits are met."""
        return self.lost == self.lost_reported == 0 and self.cpu_pct < MOST_CPU_PCT


class RecorderRig:
    """A pressing cell, and its recorder as a separate process."""

    def __init__(self, folder: Path, exits: ExitStack) -> None:
        """Start both."""
        endpoint = f"tcp/127.0.0.1:{free_port()}"
        settings = {"cell": "bench", "bus.endpoint": endpoint, "recorder.folder": str(folder)}
        self.cell = load_cell(ROOT / "cells" / "demo.yaml", settings)
        self.folder, self._file = folder, folder / "cell.yaml"
        self._file.write_text(dump_cell(self.cell), encoding="utf-8")
        supervisor = exits.enter_context(Supervisor(self.cell, self._file))
        supervisor.wait_ready(WITHIN_S)
        self.client = exits.enter_context(Client(self.cell, commander="operator", patience_s=5.0))
        self._exits = exits
        self.recorder = self.start()

    def start(self) -> ChildProcess:
        """Start a recorder and wait for its health message."""
        process = ProcessSpec("services.recorder", ("recorder",))
        self.recorder = ChildProcess(process, self._file, write_stderr_line)
        self._exits.callback(self.recorder.finish, 3.0)
        give_up_s = time.monotonic() + WITHIN_S
        health = self.client.feed(topics.HEALTH["recorder"])
        while getattr(health.reading().fresh, "pid", None) != self.recorder.pid:
            if time.monotonic() > give_up_s:
                raise TimeoutError("no health message from the recorder")
            time.sleep(0.05)
        return self.recorder

    def press(self) -> None:
        """Let the arm press, so that the messages contain motion."""
        self.client.wait_ready(WITHIN_S)
        self.client.arm(within_s=WITHIN_S)
        self.client.force.press(PRESS_N, within_s=WITHIN_S)

    def record(self) -> None:
        """Start a recording."""
        self.client.ask(topics.RECORD_START, RecordRequest(), answer_s=WITHIN_S)

    def cpu_s(self) -> float:
        """Return the processor time of the recorder so far [s]."""
        fields = Path(f"/proc/{self.recorder.pid}/stat").read_text(encoding="ascii").split()
        return (int(fields[13]) + int(fields[14])) / TICKS_HZ

    def cpu_pct(self, duration_s: float) -> float:
        """Return the processor load of the recorder over a duration [%]."""
        before_s, began_s = self.cpu_s(), time.monotonic()
        time.sleep(duration_s)
        return 100.0 * (self.cpu_s() - before_s) / (time.monotonic() - began_s)

    def memory_MB(self) -> float:
        """Return the resident memory of the recorder's process."""
        pages = int(Path(f"/proc/{self.recorder.pid}/statm").read_text(encoding="ascii").split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


@contextmanager
def rig() -> Iterator[RecorderRig]:
    """A cell and a recorder in a temporary folder."""
    os.environ.pop(ENDPOINT_VARIABLE, None)
    with tempfile.TemporaryDirectory() as folder, ExitStack() as exits:
        yield RecorderRig(Path(folder), exits)


def measure_recording(minutes: float) -> RecordingRun:
    """Record a working cell for a duration, and count the messages in the files."""
    with rig() as here:
        here.press()
        idle_pct = here.cpu_pct(min(60.0 * minutes, 20.0))
        here.record()
        time.sleep(WARM_UP_S)
        cpu_pct = here.cpu_pct(60.0 * minutes)
        memory_MB, load = here.memory_MB(), os.getloadavg()[1]
        pressed = here.client.status().state == "ACTIVE"
        reply = here.client.ask(topics.RECORD_STOP, Empty(), answer_s=WITHIN_S).text
        files = sorted(here.folder.glob("*.mcap"))
        numbering, messages = SequenceGaps(), 0
        places = {topic.key: place for place, topic in enumerate(topics.TOPICS)}
        for path in files:
            for message in RecordedFile(path).messages():
                numbering.saw(places[message.topic], message.fields["epoch"], message.fields["seq"])
                messages += 1
        return RecordingRun(
            minutes=minutes,
            messages=messages,
            lost=numbering.lost,
            lost_reported=int(reply.split()[-2]),
            cpu_pct=cpu_pct,
            idle_cpu_pct=idle_pct,
            memory_MB=memory_MB,
            file_MB=sum(path.stat().st_size for path in files) / 1e6,
            files=len(files),
            pressed=pressed,
            load=load,
        )


def measure_kills(count: int = KILLS) -> list[float]:
    """Kill recorders at random times; return the missing end of each recording [s]."""
    missing = []
    with rig() as here:
        for number in range(count):
            if number:
                here.start()
            here.record()
            began_ns = time.time_ns()
            time.sleep(random.uniform(*KILL_AFTER_S))  # noqa: S311 - no secret
            killed_ns = time.time_ns()
            os.kill(here.recorder.pid, signal.SIGKILL)
            here.recorder.finish(1.0)
            newest = max(here.folder.glob("*.mcap"), key=lambda path: path.stat().st_mtime_ns)
            stamps_ns = (
                message.at_ns for message in RecordedFile(newest).messages("sensor/wrench")
            )
            last_ns = max(stamps_ns, default=began_ns)
            missing.append((killed_ns - last_ns) / 1e9)
    return missing


def rows(worked: RecordingRun, missing: list[float]) -> list[tuple[str, str, str]]:
    """Return the measurements: name, value, limit or detail."""
    per_s = worked.messages / (60.0 * worked.minutes + WARM_UP_S)
    per_message_B = 1e6 * worked.file_MB / max(worked.messages, 1)
    return [
        ("recorded", f"{worked.minutes:g} min, {worked.messages} messages", f"{per_s:.0f} per s"),
        ("lost", f"{worked.lost} ({worked.lost_reported} by its own count)", "0"),
        ("processor time while recording", f"{worked.cpu_pct:.2f} % of a core", "< 3 %"),
        ("processor time without a recording", f"{worked.idle_cpu_pct:.2f} % of a core", ""),
        ("memory of the process", f"{worked.memory_MB:.0f} MB", ""),
        ("files", f"{worked.files}, {worked.file_MB:.1f} MB", f"{per_message_B:.0f} B a message"),
        ("load of the machine in this time", f"{worked.load:.1f} on {os.cpu_count()} cores", ""),
        ("arm pressing until the end", "yes" if worked.pressed else "no", "yes"),
        (
            f"missing after kill -9, {len(missing)} times",
            f"{max(missing):.2f} s at most",
            f"< {MOST_MISSING_S:g} s",
        ),
    ]


def table(minutes: float = 1.0) -> Table:
    """Measure, and return the table."""
    return _table(rows(measure_recording(minutes), measure_kills()))


def _table(measured: list[tuple[str, str, str]]) -> Table:
    shown = Table(
        "quantity", "measured", "limit, or detail", title="recorder", title_justify="left"
    )
    for row in measured:
        shown.add_row(*row)
    return shown


def write(measured: list[tuple[str, str, str]]) -> None:
    """Write the numbers into docs/recordings.md."""
    lines = ["| quantity | measured | limit, or detail |", "|---|---|---|"]
    lines += [f"| {' | '.join(row)} |" for row in measured]
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    _, _, after = rest.partition(END)
    text = "\n".join(lines)
    PAGE.write_text(f"{before}{BEGIN}\n{text}\n{END}{after}", encoding="utf-8")


def main() -> int:
    """Measure, print, and write if requested; return 1 if a limit is not met."""
    parser = argparse.ArgumentParser(prog="python -m bench.recorder", description=__doc__)
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--write", action="store_true", help="into docs/recordings.md")
    given = parser.parse_args()
    worked, missing = measure_recording(given.minutes), measure_kills()
    measured = rows(worked, missing)
    Console().print(_table(measured))
    if given.write:
        write(measured)
    return 0 if worked.good and max(missing) < MOST_MISSING_S else 1


if __name__ == "__main__":
    raise SystemExit(main())
