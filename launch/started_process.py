"""Child process: its output with its name as prefix, and its exit."""

import os
import signal
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from forcemesh.topics import ROLES

ROOT = Path(__file__).resolve().parent.parent
LAUNCHER = Path(__file__).with_name("child.py")
DRAIN_S = 0.05
COLOURS = {"up": 1} | {role: 32 + number for number, role in enumerate(ROLES)}

WriteLine = Callable[[str, str], None]  # name, one line


@dataclass(frozen=True, slots=True)
class ProcessSpec:
    """Row of a cell's process table."""

    module: str
    roles: tuple[str, ...]
    argv: tuple[str, ...] = ()  # instead of `python -m module --cell FILE`
    arguments: tuple[str, ...] = ()  # between the module and --cell
    is_helper: bool = False  # its death neither ends the cell nor holds the arm

    @property
    def name(self) -> str:
        """First role, which names the process."""
        return self.roles[0]


@dataclass(frozen=True, slots=True)
class ProcessExit:
    """Unexpected exit of a process."""

    process: ProcessSpec
    pid: int
    code: int
    last_output: str = ""

    @property
    def cause(self) -> str:
        """Cause of the exit: a signal or an exit code."""
        if self.code >= 0:
            return f"exit code {self.code}"
        try:
            return f"killed by {signal.Signals(-self.code).name}"
        except ValueError:
            return f"killed by signal {-self.code}"

    def __str__(self) -> str:
        roles = " and ".join(self.process.roles)
        output = f", last output: {self.last_output}" if self.last_output else ""
        return f"{roles} ({self.process.module}, pid {self.pid}): {self.cause}{output}"


class ChildProcess:
    """Child process in a process group of its own, so that Ctrl-C reaches its supervisor only.

    It stays in its supervisor's session: Linux divides the processor between sessions, and a
    process alone in one was seen to wait for 0.1 s (docs/decisions.md).
    """

    def __init__(self, process: ProcessSpec, cell_file: Path, write_line: WriteLine) -> None:
        """Start the process. It dies with the calling thread."""
        self.process = process
        self._write_line = write_line
        self._lines: deque[str] = deque(maxlen=1)
        command = process.argv or (
            sys.executable,
            "-m",
            process.module,
            *process.arguments,
            "--cell",
            str(cell_file),
        )
        self._popen = subprocess.Popen(
            [sys.executable, "-I", "-S", str(LAUNCHER), str(os.getpid()), *command],
            cwd=ROOT,
            env=os.environ | {"PYTHONUNBUFFERED": "1"},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            process_group=0,
        )
        self.pid = self._popen.pid
        self._pump = threading.Thread(target=self._pump_lines, daemon=True)
        self._pump.start()

    def ended(self) -> ProcessExit | None:
        """Return how it ended, or None while it runs."""
        code = self._popen.poll()
        if code is None:
            return None
        self._pump.join(DRAIN_S)
        last_output = self._lines[-1] if self._lines and code > 0 else ""
        return ProcessExit(self.process, self.pid, code, last_output)

    def terminate(self) -> None:
        """Send SIGTERM to the process and its children."""
        self._signal(signal.SIGTERM)

    def finish(self, patience_s: float) -> None:
        """Wait for its end, then kill the rest of its group."""
        with suppress(subprocess.TimeoutExpired):
            self._popen.wait(max(patience_s, 0.0))
        self._signal(signal.SIGKILL)
        self._popen.wait()
        self._pump.join(DRAIN_S)

    def _signal(self, number: signal.Signals) -> None:
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(self.pid, number)

    def _pump_lines(self) -> None:
        stream = self._popen.stdout
        if stream is None:
            return
        with stream:
            for raw in stream:
                line = raw.decode("utf-8", "replace").rstrip()
                if line:
                    self._lines.append(line)
                    self._write_line(self.process.name, line)


def write_stderr_line(name: str, line: str) -> None:
    """Write a line with a coloured name as prefix; one write, so that lines never mix.

    `sys.stderr` is looked up each time: a live display replaces it.
    """
    prefix = f"{name:>9} | "
    if sys.stderr.isatty() and "NO_COLOR" not in os.environ:
        prefix = f"\x1b[{COLOURS.get(name, 0)}m{prefix}\x1b[0m"
    sys.stderr.write(f"{prefix}{line}\n")
    sys.stderr.flush()
