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
from pathlib import Path

from launch.started_process import ChildProcess
from tests.chaos.injector import NoEffectError, state_of

GROUPS = Path("/sys/fs/cgroup")
LIMIT_B = 48 << 20
FILLS_WITHIN_S = 10.0
POLL_S = 0.001
FIRST, LATER = (
    1000,
    -900,
)  # of oom_score_adj: the target is selected before the process that fills the memory
FILL = """
import os, sys
open(sys.argv[1], 'w').write(str(os.getpid()))
open('/proc/self/oom_score_adj', 'w').write(sys.argv[2])
kept = []
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


def exhaust(running: ChildProcess) -> int:
    """Exhaust the memory of a process; return when the kernel killed it (monotonic [ns]).

    Raises NoEffectError without control groups, or if the kernel killed another process.
    """
    with _group(f"forcemesh-chaos-{running.pid}") as group:
        _write(Path(f"/proc/{running.pid}/oom_score_adj"), FIRST)
        _write(group / "cgroup.procs", running.pid)
        words = [sys.executable, "-I", "-S", "-c", FILL, str(group / "cgroup.procs"), str(LATER)]
        fills = subprocess.Popen(words)
        try:
            give_up_s = time.monotonic() + FILLS_WITHIN_S
            while state_of(running.pid) not in ("", "Z"):
                if time.monotonic() > give_up_s or fills.poll() is not None:
                    raise NoEffectError(f"the kernel did not kill process {running.pid}")
                time.sleep(POLL_S)
            return time.monotonic_ns()
        finally:
            fills.kill()
            fills.wait()


@contextmanager
def _group(name: str) -> Iterator[Path]:
    """Create a group with a limit; remove it when it is empty."""
    limit = limit_file()
    if limit is None:
        raise NoEffectError("memory control groups need root")
    group = limit.parent / name
    group.mkdir()
    try:
        _write(group / limit.name, LIMIT_B)
        yield group
    finally:
        give_up_s = time.monotonic() + 1.0
        while group.exists() and time.monotonic() < give_up_s:
            with suppress(OSError):  # a killed process leaves the group with a short delay
                group.rmdir()
            time.sleep(POLL_S)


def _write(path: Path, number: int) -> None:
    path.write_text(str(number), encoding="ascii")
