"""Memory exhaustion: the kernel's OOM killer ends a process in a memory control group.

A second process fills the group's memory; the OOM score makes the kernel select the target. Needs
root and memory control groups, as a container's `mem_limit` does.
"""

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from common.runtime.realtime import PRIORITY
from launch.started_process import ChildProcess
from tests.chaos.injector import NoEffectError, state_of

GROUPS = Path("/sys/fs/cgroup")
LIMIT_MB, FILLED_MB = 48, 32
FILLS_WITHIN_S = 10.0
POLL_S = 0.001
FIRST, LATER = (
    1000,
    -900,
)  # of oom_score_adj: the target is selected before the process that fills the memory
# The rest is filled at the priority of the cell, which is below that of the witness.
FILL = """
import os, sys
open(sys.argv[1], 'w').write(str(os.getpid()))
open('/proc/self/oom_score_adj', 'w').write(sys.argv[2])
os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(int(sys.argv[4])))
kept = [b'x' * (1 << 20) for _ in range(int(sys.argv[3]))]
print('filled', flush=True)
sys.stdin.readline()
while True:
    kept.append(b'x' * (1 << 20))
"""


def limit_file() -> Path | None:
    """Return the path of a group's limit below the folder of groups; None without groups."""
    for folder, name in ((GROUPS / "memory", "memory.limit_in_bytes"), (GROUPS, "memory.max")):
        controllers = folder / "cgroup.subtree_control"
        has_limit = (folder / name).exists() or (
            controllers.exists() and "memory" in controllers.read_text(encoding="utf-8")
        )
        if has_limit and os.access(folder, os.W_OK) and os.geteuid() == 0:
            return folder / name
    return None


@dataclass(frozen=True, slots=True)
class FilledGroup:
    """A control group, and the process that has filled most of its memory and waits."""

    folder: Path
    fills: "subprocess.Popen[str]"

    def exhaust(self, running: ChildProcess) -> tuple[int, int]:
        """Exhaust the memory of a process; return when it began, and when the kernel had killed it.

        Both monotonic [ns]. In between, a tenth of a second, the process becomes slow.
        Raises NoEffectError if the kernel does not kill it.
        """
        _write(Path(f"/proc/{running.pid}/oom_score_adj"), FIRST)
        began_ns = time.monotonic_ns()
        _write(self.folder / "cgroup.procs", running.pid)
        assert self.fills.stdin is not None
        self.fills.stdin.write("\n")
        self.fills.stdin.flush()
        give_up_s = time.monotonic() + FILLS_WITHIN_S
        while state_of(running.pid) not in ("", "Z"):
            if time.monotonic() > give_up_s or self.fills.poll() is not None:
                raise NoEffectError(f"the kernel did not kill process {running.pid}")
            time.sleep(POLL_S)
        return began_ns, time.monotonic_ns()


@contextmanager
def filled_group() -> Iterator[FilledGroup]:
    """Create a group and fill most of its memory, before the arm moves: it takes a second.

    Raises NoEffectError without control groups.
    """
    with _group(f"forcemesh-chaos-{os.getpid()}") as folder:
        words = [sys.executable, "-I", "-S", "-c", FILL, str(folder / "cgroup.procs")]
        words += [str(number) for number in (LATER, FILLED_MB, PRIORITY)]
        pipe = subprocess.PIPE
        with subprocess.Popen(words, stdin=pipe, stdout=pipe, text=True) as fills:
            try:
                assert fills.stdout is not None
                if fills.stdout.readline() != "filled\n":
                    raise NoEffectError("the group could not be filled")
                yield FilledGroup(folder, fills)
            finally:
                fills.kill()


@contextmanager
def _group(name: str) -> Iterator[Path]:
    """Create a group with a limit; remove it when it is empty."""
    limit = limit_file()
    if limit is None:
        raise NoEffectError("memory control groups need root")
    group = limit.parent / name
    group.mkdir()
    try:
        _write(group / limit.name, LIMIT_MB << 20)
        yield group
    finally:
        give_up_s = time.monotonic() + 1.0
        while group.exists() and time.monotonic() < give_up_s:
            with suppress(OSError):  # a killed process leaves the group with a short delay
                group.rmdir()
            time.sleep(POLL_S)


def _write(path: Path, number: int) -> None:
    path.write_text(str(number), encoding="ascii")
