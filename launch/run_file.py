"""Run file: record of the processes that a supervisor has started, kept current while it runs.

`forcemesh/<cell>.json` in XDG_RUNTIME_DIR, else `.run/<cell>.json` in the project's folder, else in
a private folder of the temporary directory. A folder that another user owns or may write is not
used. The file is removed when a cell ends normally, and kept after a death.
"""

import os
import stat
import tempfile
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import BaseModel, ValidationError

from forcemesh.errors import DataError
from launch.started_process import ROOT, ProcessExit, ProcessSpec

if TYPE_CHECKING:
    from common.config.cell import CellConfig

FOLDER_VARIABLE = "FORCEMESH_RUN_FOLDER"
MOST_DEATHS = 10  # of one process, kept in a run file
NOT_KEPT = {"calibration", "panel"}  # one changes while a cell is up, the other holds tokens


class ExitRecord(BaseModel):
    """Unexpected exit of a process: cause and time."""

    code: int  # as subprocess has it: negative is the number of the signal
    how: str  # "killed by SIGKILL", "exit code 2"
    at: str


class ProcessRecord(BaseModel):
    """Process and the roles that it implements."""

    roles: tuple[str, ...]
    module: str
    pid: int
    started_ticks: int | None  # distinguishes a process from a later one with the same pid
    ended: ExitRecord | None = None
    is_helper: bool = False  # its death does not end the cell
    deaths: tuple[ExitRecord, ...] = ()  # of its predecessors, the newest last

    @property
    def alive(self) -> bool:
        """Whether this process still runs."""
        return is_alive(self.pid, self.started_ticks)


class Run(BaseModel):
    """Run of one cell from its start to its end."""

    cell: str
    cell_file: str
    supervisor_pid: int
    supervisor_ticks: int | None
    started_at: str
    ended_at: str | None = None
    last_state: str = ""  # of the arbiter
    as_started: str = ""  # the cell as its processes have it, JSON; its file may change meanwhile
    processes: list[ProcessRecord] = []

    @property
    def live(self) -> bool:
        """Whether the supervisor that wrote this still runs."""
        return self.ended_at is None and is_alive(self.supervisor_pid, self.supervisor_ticks)

    def entry(self, role: str) -> ProcessRecord | None:
        """Return the process that implements a role, if this run has one."""
        return next((entry for entry in self.processes if role in entry.roles), None)

    # --- for its supervisor; every change is written at once --------------------------------------

    def add_process(self, process: ProcessSpec, pid: int) -> None:
        """Add a process; a restarted one replaces the one that died."""
        old = next((e for e in self.processes if e.roles == process.roles and e.ended), None)
        before = () if old is None or old.ended is None else (*old.deaths, old.ended)
        entry = ProcessRecord(
            roles=process.roles,
            module=process.module,
            pid=pid,
            started_ticks=start_ticks(pid),
            is_helper=process.is_helper,
            deaths=before[-MOST_DEATHS:],
        )
        self.processes = [*(each for each in self.processes if each is not old), entry]
        self.write()

    def add_exit(self, died: ProcessExit) -> None:
        """Record how a process ended."""
        for entry in self.processes:
            if entry.pid == died.pid:
                entry.ended = ExitRecord(code=died.code, how=died.cause, at=now())
        self.write()

    def set_state(self, state: str) -> None:
        """Record a change of the arbiter's state."""
        if state != self.last_state:
            self.last_state = state
            self.write()

    def end(self) -> None:
        """Keep the file as a record of deaths."""
        self.ended_at = now()
        self.write()

    def write(self) -> None:
        """Write the run file; a full disk is no reason to leave a cell without supervision."""
        with suppress(OSError, DataError):
            path = writable_folder() / f"{self.cell}.json"
            write_atomically(path, self.model_dump_json(indent=1) + "\n")

    def remove(self) -> None:
        """Remove the file of a cell that ended well."""
        for folder in folders():
            (folder / f"{self.cell}.json").unlink(missing_ok=True)


def new_run(cell: "CellConfig", cell_file: Path) -> Run:
    """Return the run that this process is about to supervise."""
    pid = os.getpid()
    return Run(
        cell=cell.cell,
        cell_file=str(cell_file),
        as_started=cell.model_dump_json(exclude=NOT_KEPT),
        supervisor_pid=pid,
        supervisor_ticks=start_ticks(pid),
        started_at=now(),
    )


def write_atomically(path: Path, text: str) -> None:
    """Replace a file atomically: readers see the old text or the new text."""
    draft = path.with_name(f"{path.name}.{os.getpid()}")
    draft.write_text(text, encoding="utf-8")
    draft.replace(path)


def read_run(cell: str) -> Run | None:
    """Return the newest run of a cell, or None when there is none that can be read."""
    return next((run for run in read_runs() if run.cell == cell), None)


def read_runs() -> list[Run]:
    """Return every run that has a file: live ones first, then the newest first."""
    runs = [_read(path) for folder in folders() for path in folder.glob("*.json")]
    found = sorted((run for run in runs if run), key=lambda run: run.started_at, reverse=True)
    return sorted(found, key=lambda run: not run.live)


def folders() -> list[Path]:
    """Return the possible folders of run files, without those that another user could change."""
    return [folder for folder in _candidates() if not _objection(folder)]


def writable_folder() -> Path:
    """Return the first writable folder for run files; create it if needed.

    Raises DataError when there is none that only this user can change.
    """
    reasons = []
    for folder in _candidates():
        try:
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        except OSError as error:
            reasons.append(f"{folder}: {error.strerror}")
            continue
        objection = _objection(folder)
        if not objection and os.access(folder, os.W_OK):
            return folder
        reasons.append(f"{folder}: {objection or 'not writable'}")
    text = "; ".join(reasons)
    raise DataError(f"no folder for run files ({text}): name one of yours with {FOLDER_VARIABLE}")


def _candidates() -> list[Path]:
    if named := os.environ.get(FOLDER_VARIABLE):
        return [Path(named)]
    runtime = Path(os.environ.get("XDG_RUNTIME_DIR") or "/nonexistent")
    temporary = Path(tempfile.gettempdir()) / f"forcemesh-{os.getuid()}"
    return [*([runtime / "forcemesh"] if runtime.is_dir() else []), ROOT / ".run", temporary]


def _objection(folder: Path) -> str:
    """Return why another user could change a folder or its link; empty if none can."""
    try:
        found, link = folder.stat(), folder.lstat()
    except OSError:
        return ""  # it is not there
    for owner in (link.st_uid, found.st_uid):
        if owner != os.getuid():
            return f"belongs to another user ({owner})"
    return "may be written by every user" if found.st_mode & stat.S_IWOTH else ""


def now() -> str:
    """Return the wall clock time as ISO 8601 text in UTC."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


def is_alive(pid: int, ticks: int | None) -> bool:
    """Tell whether a process runs and is the one that started at `ticks`; a zombie does not run."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    fields = _stat(pid)
    if fields is None:
        return True
    return fields[0] != "Z" and (ticks is None or int(fields[19]) == ticks)


def start_ticks(pid: int) -> int | None:
    """Return when a process started, in the kernel's ticks since boot; None if unknown."""
    fields = _stat(pid)
    return None if fields is None else int(fields[19])


def _stat(pid: int) -> list[str] | None:
    """Return the fields of /proc/PID/stat from the state on (proc(5): state is field 3)."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8")
    except OSError:
        return None
    return text.rpartition(")")[2].split()


def _read(path: Path) -> Run | None:
    try:
        return Run.model_validate_json(path.read_bytes())
    except (OSError, ValidationError):
        return None
