"""Run log: keeps the run file of one cell current while its supervisor runs."""

import threading
from contextlib import suppress
from pathlib import Path

from common.config.cell import CellConfig
from launch.run_file import (
    ExitRecord,
    ProcessRecord,
    Run,
    new_run,
    now,
    remove_run,
    start_ticks,
    write_run,
)
from launch.started_process import ProcessExit, ProcessSpec

MOST_DEATHS = 10  # of one process, kept in a run file


class RunLog:
    """Writer of the run file; writes every change at once, thread-safe."""

    def __init__(self, cell: CellConfig, cell_file: Path) -> None:
        """Begin a run; nothing is written before the first process."""
        self._run: Run = new_run(cell, cell_file)
        self._lock = threading.Lock()
        self._closed = False

    def add_process(self, process: ProcessSpec, pid: int, *, is_helper: bool = False) -> None:
        """Add a process; a restarted one replaces the one that died."""
        old = next((e for e in self._run.processes if e.roles == process.roles and e.ended), None)
        before = () if old is None or old.ended is None else (*old.deaths, old.ended)
        entry = ProcessRecord(
            roles=process.roles,
            module=process.module,
            pid=pid,
            started_ticks=start_ticks(pid),
            is_helper=is_helper,
            deaths=before[-MOST_DEATHS:],
        )
        with self._lock:
            rest = [each for each in self._run.processes if each is not old]
            self._put(processes=[*rest, entry])

    def add_exit(self, died: ProcessExit) -> None:
        """Record how a process ended."""
        end = ExitRecord(code=died.code, how=died.cause, at=now())
        with self._lock:
            self._put(
                processes=[
                    entry.model_copy(update={"ended": end}) if entry.pid == died.pid else entry
                    for entry in self._run.processes
                ]
            )

    def set_state(self, state: str) -> None:
        """Record a change of the arbiter's state."""
        with self._lock:
            if state != self._run.last_state:
                self._put(last_state=state)

    def close(self, *, keep: bool) -> None:
        """End the run: remove its file, or keep it as a record of deaths."""
        with self._lock:
            if keep:
                self._put(ended_at=now())
            else:
                remove_run(self._run)
            self._closed = True

    def _put(self, **update: object) -> None:
        if self._closed:  # a sidecar may end after the cell
            return
        self._run = self._run.model_copy(update=update)
        with suppress(OSError):  # a full disk is no reason to leave a cell without supervision
            write_run(self._run)
