"""`forcemesh up` with each kind of process killed: it restarts, held, and status names it."""

import os
import signal
import time
from functools import partial

import pytest

from cli.record import WITHOUT_VARIABLE
from common.bus.cell_bus import open_bus
from common.config.load import load_cell
from forcemesh import topics
from forcemesh.messages import MAY_MOVE
from forcemesh.requests import ArmRequest, Empty, ForceStartRequest
from launch.run_file import read_run
from tests.fakes.waiting import wait_until
from tests.scenario.test_calibrate_processes import wait_for
from tests.scenario.test_demo_processes import Watcher, status_of

PATIENCE_S = 60.0  # of the test: a loaded machine is slow to start processes
MODULES = {
    "hub": "services.hub", "robot": "sim.robot", "wrench": "services.wrench",
    "regulator": "services.regulator", "arbiter": "services.arbiter",
    "recorder": "services.recorder",
}  # fmt: skip

pytestmark = [pytest.mark.realtime, pytest.mark.long, pytest.mark.timeout(400)]


def pid_of(cell: str, role: str) -> int:
    """Return the process of a role in the run file; 0 while there is none."""
    entry = (run := read_run(cell)) and run.entry(role)
    return entry.pid if entry and entry.ended is None else 0


def is_replaced(name: str, role: str, old: int) -> bool:
    """Return whether another process has the role."""
    return pid_of(name, role) not in (0, old)


def press(bus) -> None:
    """Clear, arm and press, as a person does; a refused request is repeated."""
    give_up_s = time.monotonic() + PATIENCE_S
    for request, message in (
        (topics.CLEAR, Empty()),
        (topics.ARM, ArmRequest()),
        (topics.FORCE_START, ForceStartRequest(mode="position", setpoint_N=5.0)),
    ):
        while True:
            reply = bus.ask(request, message, 5.0)
            if reply.accepted or request is topics.CLEAR:
                break
            assert time.monotonic() < give_up_s, reply
            time.sleep(0.2)


def test_each_kind_of_process_comes_back_held_and_is_named(cell_file, start, monkeypatch):
    """Kill -9 in motion, one after the other: another process takes the role, a person arms."""
    monkeypatch.delenv(WITHOUT_VARIABLE, raising=False)
    cell = load_cell(cell_file)
    wait_for(start("-m", "cli", "up", "--cell", cell_file, "--no-panel"), "is up")
    with open_bus(cell, topics.CLIENT, patience_s=PATIENCE_S) as bus:
        watcher = Watcher(bus)
        for role in MODULES:
            wait_until(partial(pid_of, cell.cell, role), PATIENCE_S, f"{role} is started")
            victim = pid_of(cell.cell, role)
            if role != "recorder":
                press(bus)
            os.kill(victim, signal.SIGKILL)
            wait_until(partial(is_replaced, cell.cell, role, victim), PATIENCE_S, role)
            well = lambda: all(row["alive"] for row in status_of(cell_file)["services"])  # noqa: E731
            wait_until(well, PATIENCE_S, f"all alive after {role}")
            status = status_of(cell_file)
            if role != "recorder":
                assert status["state"] not in MAY_MOVE, (role, status)
            (death,) = (each for each in status["restarts"] if each["name"] == role)
            assert (death["times"], death["how"]) == (1, "killed by SIGKILL")
        press(bus)
        watcher.until(lambda: watcher.state() in MAY_MOVE)
