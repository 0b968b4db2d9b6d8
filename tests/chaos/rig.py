"""Test rig: processes of a cell that can be stopped and started individually, and a witness."""

import time
from contextlib import ExitStack
from pathlib import Path

from common.config.cell import CellConfig
from common.config.load import dump_cell, load_cell
from launch.processes import processes_of
from launch.run_file import FOLDER_VARIABLE, Run, new_run
from launch.started_process import ROOT, ChildProcess, ProcessExit
from sim.robot.trace import VARIABLE as TRACE_VARIABLE
from sim.robot.trace import Records, read_trace
from tests.chaos.cases import CellName
from tests.chaos.common_net import environment, free_port
from tests.chaos.witness import Witness, witness

FILES = {"sim": "demo.yaml", "tcp": "demo-tcp.yaml"}
# A soft plate: force changes take centimetres of travel, so faults occur in motion.
PLATE_N_M = 2000.0
END_WITHIN_S = 3.0


def chaos_cell(name: CellName) -> CellConfig:
    """Return a demo cell with a soft plate and private ports."""
    bus = free_port()
    overrides: dict[str, object] = {
        "limits.move_rise_N": 40.0,  # the phase `retreat` begins with a move that presses 25 N
        "cell": f"chaos-{bus}",
        "bus.endpoint": f"tcp/127.0.0.1:{bus}",
        "sim.stiffness_N_m": PLATE_N_M,
    }
    if name == "tcp":
        overrides["gateway.port"] = free_port()
    return load_cell(ROOT / "cells" / FILES[name], overrides)


class Rig:
    """Running cell without a supervisor: an ended process stays ended until `start`.

    Enter it in the main thread: the processes die with the thread that started them.
    """

    def __init__(self, cell: CellConfig, folder: Path) -> None:
        """Prepare a run; its files are written to `folder`."""
        self.cell = cell
        self.running: dict[str, ChildProcess] = {}
        self.witness: Witness  # valid inside the block
        self._folder = folder
        self._file = folder / "cell.yaml"
        self._processes = {process.name: process for process in processes_of(cell)}
        self._exits = ExitStack()
        self._log: Run | None = None

    def __enter__(self) -> "Rig":
        """Start the witnesses and every process, the hub first."""
        self._file.write_text(dump_cell(self.cell), encoding="utf-8")
        run, trace = str(self._folder), str(self._folder / "trace")
        self._exits.enter_context(environment(**{FOLDER_VARIABLE: run, TRACE_VARIABLE: trace}))
        self._exits.callback(self._end_all)
        self.witness = self._exits.enter_context(witness(self._folder))
        self.start(*self._processes)
        return self

    def __exit__(self, *_: object) -> None:
        """End all processes."""
        self._exits.close()

    def name_of(self, role: str) -> str:
        """Return the name of the process that implements a role."""
        return next(name for name, each in self._processes.items() if role in each.roles)

    def others_than(self, *names: str) -> list[str]:
        """Return the names of all processes but these."""
        return [name for name in self._processes if name not in names]

    def start(self, *names: str) -> None:
        """Start processes that are not running, and record it in the run file."""
        for name in names:
            if name in self.running:
                self.running.pop(name).finish(0.0)
            self.running[name] = ChildProcess(self._processes[name], self._file, _discard)
        self._log_anew()

    def end(self, *names: str) -> None:
        """Kill processes, as kill -9 does."""
        for name in names:
            self.running[name].finish(0.0)

    def note_deaths(self) -> list[ProcessExit]:
        """Record ended processes in the run file, as a supervisor does; return them."""
        ended_now = [ended for each in self.running.values() if (ended := each.ended())]
        for each in ended_now:
            if self._log is not None:
                self._log.add_exit(each)
        return ended_now

    def trace_since(self, since_ns: int) -> Records:
        """Return the trace of the arm since a time."""
        records = read_trace(self._folder / "trace")
        return records[records["at_ns"] >= since_ns]

    def _log_anew(self) -> None:
        """Start a new run file: it lists each process once, and a restart is a new process."""
        self._log = new_run(self.cell, self._file)
        for running in self.running.values():
            self._log.add_process(running.process, running.pid)

    def _end_all(self) -> None:
        give_up_s = time.monotonic() + END_WITHIN_S
        for running in reversed(self.running.values()):
            running.terminate()
        for running in reversed(self.running.values()):
            running.finish(give_up_s - time.monotonic())
        if self._log is not None:
            self._log.remove()


def _discard(_name: str, _line: str) -> None:
    """Drop a line of output: the run file and the trace have what is judged."""
