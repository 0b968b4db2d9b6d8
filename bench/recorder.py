"""Resource use and message loss of the recorder: in operation, and when killed.

The arm of a simulated cell presses while its recorder records; afterwards every message in the
files is counted. Then recorders are killed.
"""

import os
import random
import signal
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from bench.chain.cell import own_demo, running
from bench.chain.load import measured
from bench.harness import Options, Tables
from bench.results import Row
from common.bus.configured_cell import ConfiguredCell
from common.config.load import dump_cell
from forcemesh import topics
from forcemesh.requests import Empty, RecordRequest
from forcemesh.zenoh_settings import ENDPOINT_VARIABLE
from launch.started_process import ChildProcess, ProcessSpec, write_stderr_line
from services.recorder.reading import RecordedFile
from services.recorder.stamps import SequenceGaps

PRESS_N = 15.0
MINUTES, IDLE_S, WARM_UP_S, WITHIN_S = 10.0, 20.0, 2.0, 60.0
KILLS, KILL_AFTER_S = 5, (2.0, 4.0)
MOST_CPU_PCT, MOST_MISSING_S = 3.0, 1.0


class RecorderRig:
    """A cell that is up, and its recorder as a separate process."""

    def __init__(self, client: ConfiguredCell, file: Path, exits: ExitStack) -> None:
        self.client, self.folder = client, file.parent
        self._file, self._exits = file, exits
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

    def record(self) -> None:
        """Start a recording."""
        self.client.ask(topics.RECORD_START, RecordRequest(), answer_s=WITHIN_S)

    def cpu_pct(self, duration_s: float) -> float:
        """Return the processor load of the recorder over a duration [%]."""
        pids = {"recorder": self.recorder.pid}
        return measured(pids, lambda: time.sleep(duration_s))["recorder"].cpu_pct


@contextmanager
def started() -> Iterator[RecorderRig]:
    """A cell and a recorder in a temporary folder."""
    os.environ.pop(ENDPOINT_VARIABLE, None)
    with tempfile.TemporaryDirectory() as folder, ExitStack() as exits:
        cell, file = own_demo("bench", {"recorder.folder": folder}), Path(folder, "cell.yaml")
        file.write_text(dump_cell(cell), encoding="utf-8")
        yield RecorderRig(exits.enter_context(running(cell, file)), file, exits)


def recorded(minutes: float) -> Iterator[Row]:
    """Record a working cell for a duration, and count the messages in the files."""
    with started() as here:
        here.client.arm(within_s=WITHIN_S)
        here.client.force.press(PRESS_N, within_s=WITHIN_S)
        idle_pct = here.cpu_pct(IDLE_S)
        here.record()
        time.sleep(WARM_UP_S)
        cpu_pct = here.cpu_pct(60.0 * minutes)
        load, is_pressing = os.getloadavg()[1], here.client.status().state == "ACTIVE"
        statm = Path(f"/proc/{here.recorder.pid}/statm").read_text(encoding="ascii")
        reply = here.client.ask(topics.RECORD_STOP, Empty(), answer_s=WITHIN_S).text
        files = sorted(here.folder.glob("*.mcap"))
        messages, lost = counted(files)
        size_B, own_count = sum(path.stat().st_size for path in files), int(reply.split()[-2])
    memory_B = int(statm.split()[1]) * os.sysconf("SC_PAGE_SIZE")
    yield _row("duration", minutes, "min")
    yield _row("messages a second", messages / (60.0 * minutes + WARM_UP_S), "")
    yield _row("messages lost", lost, "", "0", met=lost == 0)
    yield _row("messages lost by its own count", own_count, "", "0", met=own_count == 0)
    is_light = cpu_pct < MOST_CPU_PCT
    yield _row("processor time while recording", cpu_pct, "% of a core", "< 3", met=is_light)
    yield _row("processor time without a recording", idle_pct, "% of a core")
    yield _row("memory of the process", memory_B / 1e6, "MB")
    yield _row("size of a message in the file", size_B / max(messages, 1), "B")
    yield _row("load of the machine in this time", load, f"on {os.cpu_count()} cores")
    yield _row("arm pressing until the end", "yes" if is_pressing else "no", "", "yes",
               met=is_pressing)  # fmt: skip


def counted(files: list[Path]) -> tuple[int, int]:
    """Return the number of messages in files, and of those missing by their sequence numbers."""
    gaps, messages = SequenceGaps(), 0
    places = {topic.key: place for place, topic in enumerate(topics.TOPICS)}
    for path in files:
        for message in RecordedFile(path).messages():
            gaps.saw(places[message.topic], message.fields["epoch"], message.fields["seq"])
            messages += 1
    return messages, gaps.lost


def missing_s() -> Iterator[float]:
    """Kill recorders at random times; yield the missing end of each recording [s]."""
    with started() as here:
        for number in range(KILLS):
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
            yield (killed_ns - max(stamps_ns, default=began_ns)) / 1e9


def measure(options: Options) -> Tables:
    """Record for ten minutes, then kill recorders."""
    rows = [*recorded(options.minutes or MINUTES)]
    longest_s = max(missing_s())
    text, is_short = f"missing after kill -9, {KILLS} times", longest_s < MOST_MISSING_S
    return {"recorder": [*rows, _row(text, longest_s, "s", "< 1", met=is_short)]}


def _row(
    quantity: str, value: float | str, unit: str, limit: str = "", *, met: bool | None = None
) -> Row:
    return {"quantity": quantity, "measured": value, "unit": unit, "limit": limit, "met": met}
