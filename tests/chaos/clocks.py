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
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from common.config.cell import CellConfig
from forcemesh import topics
from launch.processes import processes_of
from tests.chaos.common_net import CellUnderTest, environment, make_cell, run_guarded, table
from tests.chaos.network_judge import GroundTruthTrace
from tests.chaos.network_lab import CANNOT_RUN
from tests.chaos.network_trials import observed_cell
from tests.chaos.witness import STALL_S, Witness

PRESS_N = 10.0
SETTLE_S, WATCH_S = 2.0, 2.0
JUMPS_S = (-3600, 3600)
AHEAD_S = 100_000  # offset of one process's clock to the others
ROLES = [role for role in topics.ROLES if role not in ("hub", "sensor")]
JUMPED_M_S = 0.02  # above the speed of a pressing flange
LIBRARY = "libforcemesh-wall-clock.so"
SOURCE = Path(__file__).with_name("clocks_wall.c")
SHIFT = struct.Struct("@l")  # format of the file that the library maps
Row = tuple[str, ...]
OK = "ok"
HEAD = ("clock", "proof", "outcome", "force N", "fastest mm/s", "witness ms", "")


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

    def result(self, clock: str, proof: str) -> Row:
        """Observe the cell for a while; return a row of the table."""
        time.sleep(WATCH_S)
        cell = self.cell
        _, speeds = self._truth.speeds(self._mark)
        fastest_m_s = float(speeds.max(initial=0.0))
        idle_s = self._idle.worst_s(self._began_ns, time.monotonic_ns())
        force_N, causes, on = cell.force_N, cell.causes(), cell.state == "ACTIVE"
        rules = (
            (not proof, "the clock did not move"),
            (fastest_m_s > JUMPED_M_S, "the arm jumped"),
            (on and abs(force_N - PRESS_N) > 2.0, "the force is another one"),
            (not on and not causes, "held without a name for it"),
            (not on and idle_s < STALL_S, f"held: {causes}"),
        )
        outcome = "no effect" if on else f"held: {causes}"
        numbers = (f"{force_N:.1f}", f"{fastest_m_s * 1e3:.1f}", f"{idle_s * 1e3:.0f}")
        mistakes = "; ".join(text for broken, text in rules if broken)
        return clock, proof, outcome, *numbers, mistakes or OK


def new_cell(exits: ExitStack, name: str) -> tuple[CellConfig, Path]:
    """Write the demo cell under a separate name into a folder of its own."""
    folder = exits.enter_context(tempfile.TemporaryDirectory(prefix="forcemesh-clock-"))
    return make_cell("demo", Path(folder), {"cell": name})


def wall_clock_jumps() -> Iterator[Row]:
    """Step the wall clock of every process of the cell, both directions, while it presses."""
    with ExitStack() as exits:
        cell, path = new_cell(exits, "wall-clock")
        shift, library = path.with_name("shift"), path.with_name(LIBRARY)
        shift.write_bytes(SHIFT.pack(0))
        build = (str(shutil.which("cc")), "-shared", "-fPIC", "-O1", "-o", str(library))
        subprocess.run([*build, str(SOURCE)], check=True)
        preloaded = environment(FORCEMESH_WALL_SHIFT=str(shift), LD_PRELOAD=str(library))
        exits.enter_context(preloaded)
        observed = exits.enter_context(observed_cell(cell, path, processes_of(cell)))
        watch = ClockFaultObserver(*observed)
        for jump_s in JUMPS_S:
            with shift.open("r+b") as file:  # in place: the file is memory-mapped
                file.write(SHIFT.pack(jump_s))
            yield watch.result(f"wall clock {jump_s:+d} s", _shifted_by(jump_s, watch))


def _shifted_by(jump_s: int, watch: ClockFaultObserver) -> str:
    """Verify that every process has the library loaded and that a probe process sees the step."""
    pids = set(watch.cell.pids().values())
    maps = [Path(f"/proc/{pid}/maps").read_text(encoding="utf-8") for pid in pids]
    probe = (sys.executable, "-I", "-S", "-c", "import time; print(time.time())")
    done = subprocess.run(probe, capture_output=True, text=True, check=True)
    offset_s = float(done.stdout) - time.time()
    whole = len(pids) >= len(ROLES) and all(LIBRARY in each for each in maps)
    is_shifted = whole and abs(offset_s - jump_s) < 5
    return f"{len(pids)} processes, {offset_s:+.0f} s" if is_shifted else ""


def monotonic_differs(role: str) -> Row:
    """Run one process with a monotonic clock far ahead of the others."""
    with ExitStack() as exits:
        cell, path = new_cell(exits, f"clock-{role}")
        ahead = (str(shutil.which("unshare")), "--time", "--monotonic", str(AHEAD_S),
                 "--kill-child", "--fork", sys.executable, "-m")  # fmt: skip
        processes = {process.name: process for process in processes_of(cell)}
        argv = (*ahead, processes[role].module, "--cell", str(path))
        processes[role] = replace(processes[role], argv=argv)
        observed = exits.enter_context(observed_cell(cell, path, [*processes.values()]))
        watch = ClockFaultObserver(*observed)
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
    return run_guarded(lambda: play(only))


def play(only: str | None) -> int:
    """Run the cases, print the table, return the exit code."""
    rows = [*wall_clock_jumps()] if only in (None, "jump") else []
    rows += [monotonic_differs(role) for role in ROLES if only in (None, role)]
    print(table("Clocks that jump or differ", HEAD, rows))
    return 1 if any(row[-1] != OK for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
