"""The heartbeat of a process, and the shell that judges it for a container's health check."""

import os
import subprocess
from pathlib import Path

import pytest

from common.runtime.heartbeat import Heartbeat, line, since_boot_s

ROOT = Path(__file__).resolve().parents[4]
SCRIPT = ROOT / "common" / "runtime" / "alive.sh"


def judged(file: Path, *words: str, timeout_s: float = 10.0) -> tuple[int, str]:
    """Return the exit code of the check and its output."""
    done = subprocess.run(
        ["/bin/sh", str(SCRIPT), *words], env={**os.environ, "FORCEMESH_HEARTBEAT": str(file)},
        capture_output=True, text=True, check=False, timeout=timeout_s,
    )  # fmt: skip
    return done.returncode, done.stdout.strip()


@pytest.mark.parametrize(("age_s", "code"), [(0, 0), (4, 0), (7, 1), (1000, 1)])
def test_a_process_that_hangs_is_not_well(tmp_path: Path, age_s: int, code: int) -> None:
    """The age is printed; a heartbeat within five seconds is fresh, and gives no output."""
    (tmp_path / "alive").write_bytes(line(since_boot_s() - age_s, ""))
    found, output = judged(tmp_path / "alive")
    assert found == code
    assert ("the process hangs" in output, output != "") == (code == 1, code == 1)


@pytest.mark.parametrize("fault", ["stale: no wrench for 0.3 s", "$(touch x) `id` \\ * \n %s", "é"])
def test_a_fault_is_printed_and_never_executed(tmp_path: Path, fault: str) -> None:
    """Whatever the words are: one line, and no command of the shell's."""
    Heartbeat(tmp_path / "alive").beat(1, fault)
    code, output = judged(tmp_path / "alive")
    assert code == 1
    assert output.split()[0] in (fault.split(maxsplit=1)[0], "?", "??")
    assert list(tmp_path.iterdir()) == [tmp_path / "alive"]


def test_it_beats_once_a_second_and_at_once_with_another_fault(tmp_path: Path) -> None:
    """A loop that runs a thousand times a second writes once."""
    heartbeat, file = Heartbeat(tmp_path / "alive"), tmp_path / "alive"

    def changed(now_ns: int, fault: str) -> bool:
        file.write_bytes(b"old")
        heartbeat.beat(now_ns, fault)
        return not file.read_bytes().startswith(b"old")

    assert changed(0, "")
    assert not changed(999_999_999, "")
    assert changed(1_000_000_000, "")
    assert changed(1_000_000_001, "stale")
    assert not changed(1_000_000_002, "stale")
