"""`forcemesh up` with each kind of process killed: it restarts, held, and status names it."""

import os
import signal
from functools import partial

import pytest

from cli.record import WITHOUT_VARIABLE
from common.bus.cell_bus import open_bus
from common.config.load import load_cell
from forcemesh import topics
from forcemesh.messages import MAY_MOVE
from launch.run_file import read_run
from tests.chaos.common_net import CellUnderTest
from tests.fakes.waiting import wait_until
from tests.scenario.conftest import wait_for
from tests.scenario.test_demo_processes import status_of

PATIENCE_S = 60.0  # of the test: a loaded machine is slow to start processes
PRESS_N = 5.0
ROLES = ("hub", "robot", "wrench", "regulator", "arbiter", "recorder")

pytestmark = [pytest.mark.realtime, pytest.mark.long, pytest.mark.timeout(400)]


def pid_of(cell: str, role: str) -> int:
    """Return the process of a role in the run file; 0 while there is none."""
    entry = (run := read_run(cell)) and run.entry(role)
    return entry.pid if entry and entry.ended is None else 0


def is_replaced(name: str, role: str, old: int) -> bool:
    """Return whether another process has the role."""
    return pid_of(name, role) not in (0, old)


def test_each_kind_of_process_comes_back_held_and_is_named(cell_file, start, monkeypatch):
    """Kill -9 in motion, one after the other: another process takes the role, a person arms."""
    monkeypatch.delenv(WITHOUT_VARIABLE, raising=False)
    cell = load_cell(cell_file)
    wait_for(start("-m", "cli", "up", "--cell", cell_file, "--no-panel"), "is up")
    with open_bus(cell, topics.CLIENT, patience_s=PATIENCE_S) as bus:
        client = CellUnderTest(cell, bus)
        for role in ROLES:
            wait_until(partial(pid_of, cell.cell, role), PATIENCE_S, f"{role} is started")
            victim = pid_of(cell.cell, role)
            if role != "recorder":
                client.make_ready()
                client.press(PRESS_N)
            os.kill(victim, signal.SIGKILL)
            wait_until(partial(is_replaced, cell.cell, role, victim), PATIENCE_S, role)
            well = lambda: all(row["alive"] for row in status_of(cell_file)["services"])  # noqa: E731
            wait_until(well, PATIENCE_S, f"all alive after {role}")
            status = status_of(cell_file)
            if role != "recorder":
                assert status["state"] not in MAY_MOVE, (role, status)
            (death,) = (each for each in status["restarts"] if each["name"] == role)
            assert (death["times"], death["how"]) == (1, "killed by SIGKILL")
        client.make_ready()
        client.press(PRESS_N)
        client.until(lambda: client.state in MAY_MOVE, "force feedback", PATIENCE_S)
