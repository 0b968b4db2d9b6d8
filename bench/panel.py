"""Resource use of the panel, and its effect on the control loops: `python -m bench panel`.

A real cell presses with 10 N; its panel has no client, then one browser, then the browser
and four more websocket clients, of which one never reads. Without a graphics card a browser would
take both cores to render, so its scene is not drawn: only the panel is measured.
`python -m bench.panel --write` writes the table into docs/panel.md.
"""

import argparse
import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import msgspec.msgpack
import viser
from rich.console import Console
from rich.table import Table
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin, Subprotocol

from bench.panel_browser import one_browser
from bench.tables import on_screen
from common.bus.configured_cell import ConfiguredCell
from common.config.load import dump_cell, load_cell
from forcemesh.errors import ForcemeshError
from launch.processes import Supervisor

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "panel.md"
BEGIN, END = "<!-- made by `python -m bench.panel --write` -->", "<!-- end -->"
CONTROL = ("robot", "sensor", "wrench", "regulator", "arbiter")
PRESS_N = 10.0
PHASE_S, SETTLE_S = 20.0, 5.0
CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": (1.0, 0.0, 0.0, 0.0),
    "position": (1.0, 1.0, 1.0),
    "fov": 1.0,
    "near": 0.1,
    "far": 10.0,
    "image_height": 600,
    "image_width": 800,
    "look_at": (0.0, 0.0, 0.0),
    "up_direction": (0.0, 0.0, 1.0),
}


@dataclass(frozen=True, slots=True)
class Phase:
    """Measurements of one phase."""

    what: str
    cpu_percent: float | None  # of one core, by the panel's process
    kB_s: float | None  # to one websocket client that reads
    overdue: int  # periods missed by far, in reports of the control services
    missed: int  # control deadlines: each one makes the arm hold


def phases() -> list[Phase]:
    """Run them all."""
    with tempfile.TemporaryDirectory() as folder, ExitStack() as exits:
        path = _cell_file(Path(folder))
        os.environ["FORCEMESH_RUN_FOLDER"] = folder
        supervisor = exits.enter_context(Supervisor(load_cell(path), path, write_line=_quiet))
        supervisor.wait_ready(60.0)
        cell = exits.enter_context(ConfiguredCell(path, commander="operator", patience_s=10.0))
        cell.wait_ready()
        cell.tare()
        cell.arm()
        cell.force.press(PRESS_N)
        found = [_phase(cell, "no panel")]
        port = cell.config.panel.port
        pid = exits.enter_context(_panel(path, port))
        found.append(_phase(cell, "no client", pid=pid))
        exits.enter_context(one_browser(f"http://127.0.0.1:{port}/"))
        found.append(_phase(cell, "one browser", pid=pid))
        readers = [exits.enter_context(_client(port)) for _ in range(3)]
        exits.enter_context(_client(port, reads=False))
        what = "the same and four websocket clients, one of which never reads"
        found.append(_phase(cell, what, pid=pid, reader=readers[0]))
        return found


def table(found: list[Phase] | None = None) -> Table:
    """Return the phases as a table."""
    rows = map(_cells, phases() if found is None else found)
    return on_screen("the panel of a cell that presses", HEADS, rows)


HEADS = ("clients", "panel, % of a core", "kB/s to a reader", "late periods", "missed deadlines")


def _cells(phase: Phase) -> tuple[str, ...]:
    cpu = "" if phase.cpu_percent is None else f"{phase.cpu_percent:.1f}"
    traffic = "" if phase.kB_s is None else f"{phase.kB_s:.0f}"
    return (phase.what, cpu, traffic, str(phase.overdue), str(phase.missed))


def _phase(
    cell: ConfiguredCell, what: str, *, pid: int | None = None, reader: "_Reader | None" = None
) -> Phase:
    """Measure the cell and the panel's process for one phase."""
    time.sleep(SETTLE_S)
    began_s, spent_s = time.monotonic(), _cpu_s(pid)
    bytes_before = reader.count if reader else 0
    overdue, missed = 0, 0
    while time.monotonic() - began_s < PHASE_S:
        time.sleep(1.0)  # services report once a second what they missed in it
        for role in CONTROL:
            overdue += getattr(cell.health(role).reading().message, "overruns", 0)
        if not cell.status().operational:
            missed += 1
            cell.clear()
            cell.arm("all")
            cell.force.press(PRESS_N)
    elapsed_s = time.monotonic() - began_s
    cpu = None if pid is None else 100.0 * (_cpu_s(pid) - spent_s) / elapsed_s
    traffic = (reader.count - bytes_before) / elapsed_s / 1e3 if reader else None
    return Phase(what, cpu, traffic, overdue, missed)


def _cpu_s(pid: int | None) -> float:
    """Return the processor time that a process has taken [s]."""
    if pid is None:
        return 0.0
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _cell_file(folder: Path) -> Path:
    port = _free_port()
    overrides = {
        "cell": f"bench-{port}",
        "bus.endpoint": f"tcp/127.0.0.1:{port}",
        "panel.port": _free_port(),
    }
    path = folder / "cell.yaml"
    path.write_text(dump_cell(load_cell(ROOT / "cells" / "demo.yaml", overrides)), encoding="utf-8")
    return path


def _free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as probe:
        return int(probe.getsockname()[1])


@contextmanager
def _panel(path: Path, port: int) -> Iterator[int]:
    """Run the panel; yield its process id once it answers."""
    command = [sys.executable, "-m", "services.panel", "--cell", str(path)]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL)
    try:
        give_up_s = time.monotonic() + 60.0
        while not _answers(port):
            if time.monotonic() > give_up_s or process.poll() is not None:
                raise ForcemeshError("the panel did not come up")
            time.sleep(0.2)
        yield process.pid
    finally:
        process.terminate()
        process.wait(30.0)


def _answers(port: int) -> bool:
    with suppress(OSError):
        status: int = urllib.request.urlopen(f"http://127.0.0.1:{port}/alive", timeout=2.0).status
        return status == 200
    return False


class _Reader(threading.Thread):
    """Reader thread that counts the received bytes."""

    def __init__(self, line: ClientConnection) -> None:
        super().__init__(daemon=True)
        self.count = 0
        self._line = line

    def run(self) -> None:
        with suppress(ConnectionClosed):
            for message in self._line:
                self.count += len(message)


@contextmanager
def _client(port: int, *, reads: bool = True) -> Iterator[_Reader]:
    """Connect a websocket client without a browser."""
    here = f"127.0.0.1:{port}"
    line = connect(
        f"ws://{here}",
        origin=Origin(f"http://{here}"),
        subprotocols=[Subprotocol(f"viser-v{viser.__version__}")],
        max_size=None,
        proxy=None,
    )
    reader = _Reader(line)
    try:
        line.send(msgspec.msgpack.encode(CAMERA))
        if reads:
            reader.start()
        yield reader
    finally:
        with suppress(OSError):
            line.close()


def _quiet(_who: str, _line: str) -> None:
    """Discard the output of the cell."""


def write(found: list[Phase], page: Path = PAGE) -> None:
    """Write the table into the page."""
    rows = [HEADS, tuple("---" for _ in HEADS), *(_cells(phase) for phase in found)]
    lines = "\n".join(f"| {' | '.join(row)} |" for row in rows)
    head, _, rest = page.read_text(encoding="utf-8").partition(BEGIN)
    page.write_text(f"{head}{BEGIN}\n\n{lines}\n\n{END}{rest.partition(END)[2]}", encoding="utf-8")


def main() -> None:
    """Measure; print, or write."""
    parser = argparse.ArgumentParser(prog="python -m bench.panel", description=__doc__)
    parser.add_argument("--write", action="store_true", help="write it into docs/panel.md")
    options = parser.parse_args()
    found = phases()
    Console().print(table(found))
    if options.write:
        write(found)


if __name__ == "__main__":
    main()
