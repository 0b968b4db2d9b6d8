"""Calibration wizard of the panel: a child process that reports its progress as JSON lines."""

import json
import subprocess
import sys
import threading
from collections import deque
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

# Named, not imported: a service does not depend on the command line.
MODULE = "cli.calibration.panel_wizard"
ROOT = Path(__file__).resolve().parents[2]
WIZARD_ENDS_WITHIN_S = 5.0
NOTES = 40


@dataclass(slots=True)
class Progress:
    """Progress of the child process so far."""

    phase: str = "idle"  # idle, planning, asking, running, done, failed
    plan: str = ""
    share: float = 0.0
    text: str = ""
    left: dict[str, Any] = field(default_factory=dict)
    notes: deque[str] = field(default_factory=lambda: deque(maxlen=NOTES))

    def update(self, line: dict[str, Any]) -> None:
        """Update from one decoded line of the child."""
        if "plan" in line:
            self.phase, self.plan = "asking", str(line["plan"])
        if "progress" in line:
            self.phase, self.share = "running", float(line["progress"])
            self.text = str(line.get("text", ""))
        if "left" in line:
            self.left = dict(line["left"])
        if "note" in line:
            self.notes.append(str(line["note"]))
        if "error" in line:
            self.notes.append(f"⚠ {line['error']}")
        if "end" in line:
            self.phase = "done" if line["end"] == 0 else "failed"


class WizardProcess:
    """Runner of at most one calibration at a time; every page shows its progress."""

    def __init__(self, cell_file: Path) -> None:
        """Prepare; no process is started."""
        self.progress = Progress()
        self.cell_file = cell_file
        self._child: subprocess.Popen[str] | None = None
        self._listener: threading.Thread | None = None
        self._lock = threading.Lock()

    def plan(self, *, poses: int, verify_poses: int, speed_mm_s: float) -> str:
        """Start the child, which plans, then waits for `go`; return the refusal, else empty."""
        with self._lock:
            if self._child is not None and self._child.poll() is None:
                return "a calibration is already running"
            self.progress = Progress(phase="planning")
            options = ("--poses", poses, "--verify-poses", verify_poses, "--speed", speed_mm_s)
            words = ("-m", MODULE, "--cell", self.cell_file.resolve(), *options)
            self._child = subprocess.Popen(
                [sys.executable, *(str(word) for word in words)],
                cwd=ROOT,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                start_new_session=True,
            )
            self._listener = threading.Thread(target=self._listen, args=[self._child], daemon=True)
            self._listener.start()
        return ""

    def start(self) -> None:
        """Confirm the plan: the arm may move."""
        child = self._child
        if child is not None and child.stdin is not None and child.poll() is None:
            with suppress(OSError, ValueError):  # the child may be ending
                child.stdin.write("go\n")
                child.stdin.flush()

    def cancel(self) -> None:
        """Terminate the child: before `go` nothing has moved, after it the arm holds."""
        with self._lock:
            child = self._child
        if child is not None and child.poll() is None:
            child.terminate()

    def wait(self, timeout_s: float) -> None:
        """Wait until the child has ended and its output is read."""
        if self._listener is not None:
            self._listener.join(timeout_s)

    def close(self) -> None:
        """Terminate the child; allow it time to request a hold."""
        self.cancel()
        self.wait(WIZARD_ENDS_WITHIN_S)
        child = self._child
        if child is not None and child.poll() is None:
            child.kill()

    def _listen(self, child: "subprocess.Popen[str]") -> None:
        progress = self.progress
        for line in child.stdout or ():
            try:
                progress.update(json.loads(line))
            except (ValueError, TypeError):
                progress.notes.append(line.rstrip())  # for example a traceback
        child.wait()
        for pipe in (child.stdin, child.stdout):
            if pipe is not None:
                pipe.close()
        if progress.phase not in {"done", "failed"}:
            progress.phase = "failed"
            progress.notes.append(f"the wizard ended, exit code {child.returncode}")
