"""Memory is locked where the machine allows it; health reports whether it is."""

import subprocess
import sys
from pathlib import Path

import pytest

from common.runtime import realtime
from common.runtime.service import HealthReporter
from forcemesh import topics
from tests.fakes.bench import CELL
from tests.fakes.cellmates import Cellmates

LOCKS = """
import resource, sys
from pathlib import Path
if sys.argv[1] == "limited":
    resource.setrlimit(resource.RLIMIT_MEMLOCK, (65536, 65536))
from common.runtime import realtime
from forcemesh import topics
if sys.argv[1] == "limited":
    realtime._may_lock_without_limit = lambda: False
print(realtime.lock_memory(), realtime.is_memory_locked())
block = bytearray(50_000_000)  # a limit that is too small would end the process here
locked = [line for line in Path("/proc/self/status").read_text().splitlines() if "VmLck" in line]
print(int(locked[0].split()[1]) > 0)
"""


@pytest.mark.parametrize("limit", ["limited", "as it is"])
def test_memory_is_locked_or_reported_as_unlocked(limit: str) -> None:
    """With too small a limit nothing is locked, and nothing fails later for lack of memory."""
    done = subprocess.run(
        [sys.executable, "-c", LOCKS, limit],
        cwd=Path(__file__).parents[4],
        capture_output=True,
        text=True,
        check=True,
    )
    printed, found = done.stdout.splitlines()
    assert printed in ("True True", "False False")
    assert found == printed.split()[0]
    if limit == "limited":
        assert printed == "False False"


@pytest.mark.parametrize("locked", [True, False])
def test_health_reports_whether_memory_is_locked(
    locked: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Next to the report of real-time priority."""
    monkeypatch.setattr(realtime, "_locked", locked)
    cell = Cellmates()
    reader = cell.client.reader(topics.HEALTH["arbiter"])
    HealthReporter(cell._bus("arbiter"), CELL).stepped(cell.clock.now_ns(), 0.0, cell.service)
    message = reader.read(cell.clock.now_ns()).message
    assert message is not None
    assert message.counters["memory_locked"] == int(locked)
