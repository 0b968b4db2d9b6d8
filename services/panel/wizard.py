"""The calibration wizard as the panel sees it: a child process that says where it is."""

import json
import subprocess
import sys
import threading
from collections import deque
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

# Named, not imported: a service knows nothing of the command line.
MODULE = "cli.calibration.panel_wizard"
ROOT = Path(__file__).resolve().parents[2]
ENDS_WITHIN_S = 5.0
NOTES = 40


@dataclass(slots=True)
class Progress:
    """What the child has said so far."""

    phase: str = "idle"  # idle, planning, asking, running, done, failed
    plan: str = ""
    share: float = 0.0
    text: str = ""
    left: dict[str, Any] = field(default_factory=dict)
    notes: deque[str] = field(default_factory=lambda: deque(maxlen=NOTES))

    def heard(self, said: dict[str, Any]) -> None:
        """Take one line of the child."""
        if "plan" in said:
            self.phase, self.plan = "asking", str(said["plan"])
        if "progress" in said:
            self.phase, self.share = "running", float(said["progress"])
            self.text = str(said.get("text", ""))
        if "left" in said:
            self.left = dict(said["left"])
        if "note" in said:
            self.notes.append(str(said["note"]))
        if "error" in said:
            self.notes.append(f"⚠ {said['error']}")
        if "end" in said:
            self.phase = "done" if said["end"] == 0 else "failed"


class Wizard:
    """At most one calibration of a cell at a time, whoever started it; everybody may watch it."""

    def __init__(self, cell_file: Path) -> None:
        """Start nothing."""
        self.progress = Progress()
        self._cell_file = cell_file
        self._child: subprocess.Popen[str] | None = None
        self._listener: threading.Thread | None = None
        self._lock = threading.Lock()

    def plan(self, *, poses: int, verify_poses: int, speed_mm_s: float) -> str:
        """Start the child, which plans and then waits for `go`; return why not, if not."""
        with self._lock:
            if self._child is not None and self._child.poll() is None:
                return "a calibration runs already"
            self.progress = Progress(phase="planning")
            options = ("--poses", poses, "--verify-poses", verify_poses, "--speed", speed_mm_s)
            words = ("-m", MODULE, "--cell", self._cell_file.resolve(), *options)
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

    def go(self) -> None:
        """Let the arm move."""
        self._write("go\n")

    def cancel(self) -> None:
        """Let the child end: before `go` nothing was moved, after it the arm holds."""
        with self._lock:
            child = self._child
        if child is not None and child.poll() is None:
            child.terminate()

    def wait(self, timeout_s: float) -> None:
        """Wait until the child has ended and all of its words are heard."""
        if self._listener is not None:
            self._listener.join(timeout_s)

    def close(self) -> None:
        """End the child, and give it the time to ask for a hold."""
        self.cancel()
        self.wait(ENDS_WITHIN_S)
        child = self._child
        if child is not None and child.poll() is None:
            child.kill()

    def _write(self, text: str) -> None:
        child = self._child
        if child is not None and child.stdin is not None and child.poll() is None:
            with suppress(OSError, ValueError):  # it may end this very moment
                child.stdin.write(text)
                child.stdin.flush()

    def _listen(self, child: "subprocess.Popen[str]") -> None:
        progress = self.progress
        for line in child.stdout or ():
            try:
                progress.heard(json.loads(line))
            except (ValueError, TypeError):
                progress.notes.append(line.rstrip())  # a traceback, say
        child.wait()
        for pipe in (child.stdin, child.stdout):
            if pipe is not None:
                pipe.close()
        if progress.phase not in {"done", "failed"}:
            progress.phase = "failed"
            progress.notes.append(f"the wizard ended, exit code {child.returncode}")
