"""`forcemesh status` on real processes: a running hub, and a killed one."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from cli.status import DOWN, CellStatus, cell_status, describe_number, is_well
from common.config.cell import CellConfig
from common.config.load import dump_cell
from forcemesh import topics
from forcemesh.errors import ForcemeshError
from launch.processes import Supervisor
from launch.run_file import read_run
from launch.started_process import ProcessSpec
from tools.tree import ROOT

HUB = ProcessSpec("services.hub", ("hub",))
SLEEPER = ProcessSpec("test", ("wrench",), (sys.executable, "-c", "import time; time.sleep(600)"))

pytestmark = pytest.mark.processes


def faults(status: CellStatus) -> dict[str, str]:
    """Return the fault of each role."""
    return {row["name"]: row["fault"] for row in status["services"]}


def test_a_killed_hub_is_named_without_a_bus(cell: CellConfig) -> None:
    """Each role has its state; of a killed hub run file and kernel name the signal in 2 s."""
    with Supervisor(cell, processes=[HUB, SLEEPER]) as supervisor:
        before = cell_status(cell, read_run(cell.cell))
        assert [row["name"] for row in before["services"]] == list(topics.ROLES)
        assert (before["state"], is_well(before)) == (DOWN, False)
        assert faults(before)["hub"] == ""
        assert "runs, but no health for" in faults(before)["wrench"]
        assert faults(before)["arbiter"].startswith("no health for")
        run = read_run(cell.cell)
        assert run is not None
        os.kill(run.processes[0].pid, signal.SIGKILL)
        while not supervisor.died:
            time.sleep(0.005)
        started_s = time.monotonic()
        status = cell_status(cell, read_run(cell.cell))
        assert time.monotonic() - started_s < 2.0
        assert faults(status)["hub"] == "killed by SIGKILL"
        assert "runs, but no hub responds" in faults(status)["wrench"]
    after = cell_status(cell, read_run(cell.cell))
    assert faults(after)["hub"] == "killed by SIGKILL"
    assert faults(after)["wrench"] == "stopped because of hub: killed by SIGKILL"
    assert after["state"] == DOWN


def test_a_second_hub_on_the_endpoint_is_reported_and_nothing_else_is_started(
    cell: CellConfig,
) -> None:
    """Otherwise two arbiters would command one arm."""
    other = cell.model_copy(update={"cell": "other"})
    with (
        Supervisor(cell, processes=[HUB]),
        pytest.raises(ForcemeshError, match=r"hub .*exit code 2.*cannot listen"),
        Supervisor(other, processes=[HUB, SLEEPER]),
    ):
        pass
    run = read_run("other")
    assert run is not None
    assert [entry.roles for entry in run.processes] == [("hub",)]


def test_a_requested_hold_is_well_and_one_by_a_limit_is_not(cell: CellConfig) -> None:
    """Scripts depend on this result."""
    status = cell_status(cell, None) | {"state": "HOLDING", "services": []}
    for code, well in (("hold", True), ("force", False)):
        trips: list[dict[str, object]] = [{"code": code, "text": "why"}]
        assert is_well(CellStatus(**(status | {"trips": trips}))) is well


def test_a_health_check_covers_one_role(cell: CellConfig, tmp_path: Path) -> None:
    """Containers run it: 0 while the health of the role is fresh, 1 otherwise."""
    path = tmp_path / "cell.yaml"
    path.write_text(dump_cell(cell))
    command = [sys.executable, "-m", "cli", "status", "--json", "--cell", str(path), "--service"]
    with Supervisor(cell, path, processes=[HUB]):
        well, silent, helper = (
            subprocess.run([*command, role], cwd=ROOT, capture_output=True, text=True, check=False)
            for role in ("hub", "arbiter", "recorder")
        )
    assert (well.returncode, silent.returncode, helper.returncode) == (0, 1, 1)
    assert json.loads(well.stdout)["name"] == "hub"
    assert json.loads(silent.stdout)["alive"] is False
    assert json.loads(helper.stdout)["name"] == "recorder"


def test_the_suffix_of_a_name_is_its_unit() -> None:
    """Seconds as milliseconds, hertz as per second, fractions as percent."""
    trip = "network round trip (median) 12.3 ms"
    assert describe_number("framed_round_trip_p50_s", 0.0123) == trip
    assert describe_number("sender_hz", 40.04) == "reports of the controller 40.0 /s"
    assert describe_number("monitor_speed_fraction", 0.1) == "monitor speed 10.0 %"
    assert describe_number("odd", 3.0) == "odd 3"
