"""A robot that the cell does not start: any process that publishes what the table asks of it."""

import subprocess
import sys
from pathlib import Path

import pytest

from common.bus.cell_bus import open_bus
from forcemesh import topics
from launch.processes import Supervisor
from tests.chaos.common_net import ROOT, CellUnderTest, free_port, make_cell
from tests.scenario.conftest import LIGHT, PATIENCE_S

pytestmark = pytest.mark.processes

EXTERNAL = {"roles.robot": "external", "roles.sensor": "external"}
# Stands for the program of another author: it plays both roles, and no table names it.
PROGRAM = """
from common.runtime.service import main
from sim.robot.service import SimRobot
main(("robot", "sensor"), SimRobot)
"""


def test_another_process_plays_the_robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With it the cell is ready and the arm moves; when it ends the arbiter reports a fault."""
    monkeypatch.setenv("FORCEMESH_RUN_FOLDER", str(tmp_path))
    port = free_port()
    places = {"cell": f"external-{port}", "bus.endpoint": f"tcp/127.0.0.1:{port}"}
    cell, path = make_cell("demo", tmp_path, EXTERNAL | places | LIGHT)
    with Supervisor(cell, path) as supervisor, open_bus(cell, topics.CLIENT) as bus:
        robot = subprocess.Popen([sys.executable, "-c", PROGRAM, "--cell", path], cwd=ROOT)
        try:
            supervisor.wait_ready(PATIENCE_S)
            client = CellUnderTest(cell, bus)
            client.until(lambda: client.pids().get("robot") == robot.pid, "health of the robot")
            client.make_ready()
            target_m = client.height_m() - 0.005
            client.move_to(target_m, 0.05)
            client.until(lambda: abs(client.height_m() - target_m) < 1e-4, "the target")
        finally:
            robot.terminate()
            robot.wait(PATIENCE_S)
        client.until(lambda: client.state == "FAULT", "the fault of a lost robot")
