"""Clock faults in a pressing cell: expected is no effect, or a hold with a named cause.

`python -m tests.chaos.clocks [--only jump]`. Exit codes: 0 passed,
1 failed, 77 not testable on this machine (it needs root for time namespaces, and a C compiler).
"""

import argparse
import os
import shutil
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

from common.config.cell import CellConfig
from common.runtime.realtime import take_realtime_priority
from forcemesh import topics
from forcemesh.errors import ForcemeshError
from launch.processes import processes_of
from launch.started_process import ProcessSpec
from sim.robot.trace import VARIABLE as TRACE
from tests.chaos.common_net import CellUnderTest, child, free_port, make_cell, running_cell, table
from tests.chaos.network_judge import GroundTruthTrace
from tests.chaos.network_lab import CANNOT_RUN
from tests.chaos.network_play import environment
from tests.chaos.witness import STALL_S, Witness, witness

PRESS_N = 10.0
SETTLE_S, WATCH_S = 2.0, 2.0
JUMPS_S = (-3600, 3600)
AHEAD_S = 100_000  # offset of one process's clock to the others
ROLES = [role for role in topics.ROLES if role not in ("hub", "sensor")]
JUMPED_M_S = 0.02  # above the speed of a pressing flange
LIBRARY = "libforcemesh-wall-clock.so"
SOURCE = Path(__file__).with_name("clocks_wall.c")
SHIFT = struct.Struct("@l")  # format of the file that the library maps
HEAD = ("clock", "proof", "outcome", "force N", "fastest mm/s", "witness ms", "")


@dataclass(frozen=True, slots=True)
class ClockCase:
    """One clock fault and its outcome."""

    clock: str
    proof: str
    outcome: str
    force_N: float
    fastest_m_s: float
    witness_s: float
    mistakes: tuple[str, ...]

    def cells(self) -> tuple[object, ...]:
        """Return the cells of a table row."""
        return (
            self.clock, self.proof, self.outcome, f"{self.force_N:.1f}",
            f"{self.fastest_m_s * 1e3:.1f}", f"{self.witness_s * 1e3:.0f}",
            "; ".join(self.mistakes) or "ok",
        )  # fmt: skip


def why_not() -> str:
    """Return why clock faults are not possible on this machine; empty if they are."""
    if os.geteuid() != 0:
        return "time namespaces need root"
    if not Path("/proc/self/ns/time").exists() or not shutil.which("unshare"):
        return "the kernel has no time namespaces, or unshare (util-linux) is missing"
    return "" if shutil.which("cc") else "a C compiler is missing: apt-get install gcc libc6-dev"


class ClockFaultObserver:
    """Observer of a pressing cell during a clock fault."""

    def __init__(self, cell: CellUnderTest, truth: GroundTruthTrace, idle: Witness) -> None:
        """Start to press."""
        self.cell, self._truth, self._idle = cell, truth, idle
        cell.tare()
        cell.make_ready()
        cell.press(PRESS_N)
        time.sleep(SETTLE_S)
        self._mark, self._began_ns = truth.mark(), time.monotonic_ns()

    def result(self, clock: str, proof: str) -> ClockCase:
        """Observe the cell for a while; return the outcome."""
        time.sleep(WATCH_S)
        cell, mistakes = self.cell, []
        _, speeds = self._truth.speeds(self._mark)
        fastest_m_s = float(speeds.max(initial=0.0))
        idle_s = self._idle.worst_s(self._began_ns, time.monotonic_ns())
        force_N, causes = cell.force_N, cell.causes()
        on = cell.state == "ACTIVE"
        if not proof:
            mistakes.append("the clock did not move")
        if fastest_m_s > JUMPED_M_S:
            mistakes.append("the arm jumped")
        if on and abs(force_N - PRESS_N) > 2.0:
            mistakes.append("the force is another one")
        if not on and not causes:
            mistakes.append("held without a name for it")
        if not on and idle_s < STALL_S:
            mistakes.append(f"held: {causes}")
        outcome = "no effect" if on else f"held: {causes}"
        return ClockCase(clock, proof, outcome, force_N, fastest_m_s, idle_s, tuple(mistakes))


def pressing(
    exits: ExitStack, processes: Sequence[ProcessSpec], cell: CellConfig, path: Path
) -> ClockFaultObserver:
    """Start a cell and let it press."""
    trace = path.parent / "trace.bin"
    exits.enter_context(environment(TRACE, str(trace)))
    idle = exits.enter_context(witness(path.parent))
    return ClockFaultObserver(
        exits.enter_context(running_cell(cell, path, processes)), GroundTruthTrace(trace), idle
    )


def new_cell(folder: Path, name: str) -> tuple[CellConfig, Path]:
    """Write the demo cell under a separate name."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    return make_cell("demo", folder, {"cell": name, "bus.endpoint": endpoint})


def wall_clock_jumps() -> Iterator[ClockCase]:
    """Step the wall clock of every process of the cell, both directions, while it presses."""
    with ExitStack() as exits:
        folder = Path(exits.enter_context(tempfile.TemporaryDirectory(prefix="forcemesh-clock-")))
        shift, library = folder / "shift", folder / LIBRARY
        shift.write_bytes(SHIFT.pack(0))
        build = (str(shutil.which("cc")), "-shared", "-fPIC", "-O1", "-o", str(library))
        subprocess.run([*build, str(SOURCE)], check=True)
        exits.enter_context(environment("FORCEMESH_WALL_SHIFT", str(shift)))
        exits.enter_context(environment("LD_PRELOAD", str(library)))
        cell, path = new_cell(folder, "wall-clock")
        watch = pressing(exits, processes_of(cell), cell, path)
        for jump_s in JUMPS_S:
            with shift.open("r+b") as file:  # in place: the file is memory-mapped
                file.write(SHIFT.pack(jump_s))
            yield watch.result(f"wall clock {jump_s:+d} s", _shifted_by(jump_s, watch))


def _shifted_by(jump_s: int, watch: ClockFaultObserver) -> str:
    """Verify that every process has the library loaded and that a probe process sees the step."""
    pids = set(watch.cell.pids().values())
    maps = [Path(f"/proc/{pid}/maps").read_text(encoding="utf-8") for pid in pids]
    with child("tests.chaos.clocks_probe") as probe:
        probe_s = float((probe.stdout.readline() if probe.stdout else "") or "nan")
    offset_s = probe_s - time.time()
    whole = len(pids) >= len(ROLES) and all(LIBRARY in each for each in maps)
    return (
        f"{len(pids)} processes, {offset_s:+.0f} s" if whole and abs(offset_s - jump_s) < 5 else ""
    )


def monotonic_differs(role: str) -> ClockCase:
    """Run one process with a monotonic clock far ahead of the others."""
    with ExitStack() as exits:
        folder = Path(exits.enter_context(tempfile.TemporaryDirectory(prefix="forcemesh-clock-")))
        cell, path = new_cell(folder, f"clock-{role}")
        ahead = (str(shutil.which("unshare")), "--time", "--monotonic", str(AHEAD_S),
                 "--kill-child", "--fork")  # fmt: skip
        processes = [
            replace(
                process,
                argv=(*ahead, sys.executable, "-m", process.module, "--cell", str(path)),
            )
            if process.name == role
            else process
            for process in processes_of(cell)
        ]
        watch = pressing(exits, processes, cell, path)
        pid = watch.cell.pids().get(role, os.getpid())
        own = Path(f"/proc/{pid}/ns/time").readlink() != Path("/proc/self/ns/time").readlink()
        return watch.result(f"{role} {AHEAD_S:+d} s", "own time namespace" if own else "")


def main() -> int:
    """Run, print the table, return the exit code."""
    parser = argparse.ArgumentParser(prog="tests.chaos.clocks", description=__doc__)
    parser.add_argument("--only", choices=("jump", *ROLES), help="this case alone")
    only = parser.parse_args().only
    if reason := why_not():
        print(f"NOTHING WAS TESTED: {reason}", file=sys.stderr)
        return CANNOT_RUN
    take_realtime_priority()
    cases: list[ClockCase] = []
    try:
        if only in (None, "jump"):
            cases += wall_clock_jumps()
        cases += [monotonic_differs(role) for role in ROLES if only in (None, role)]
    except ForcemeshError as error:
        print(f"the harness failed: {error}", file=sys.stderr)
        return 1
    print(table("Clocks that jump or differ", HEAD, [case.cells() for case in cases]))
    return 1 if any(case.mistakes for case in cases) else 0


if __name__ == "__main__":
    sys.exit(main())
