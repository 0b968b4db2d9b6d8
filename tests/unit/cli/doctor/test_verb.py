"""Verb `forcemesh doctor`: exit codes, and its choice between link and bus."""

import json
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from typer.testing import CliRunner

from cli.__main__ import app
from cli.context import NO_ANSWER, NOT_WELL, OK, USAGE
from cli.doctor import link as doctor_link
from cli.doctor.link import VisitTimeouts
from cli.doctor.report import observe_cell
from common.bus.cell_bus import open_bus
from common.config.cell import CellConfig
from common.config.load import cell_hash, dump_cell, load_cell
from forcemesh import topics
from forcemesh.messages import Health, RobotState
from forcemesh.zenoh_settings import ENDPOINT_VARIABLE
from launch.processes import Supervisor
from launch.run_file import FOLDER_VARIABLE, new_run, write_run
from launch.started_process import ProcessSpec
from sim.controller.behaviour import Behaviour
from sim.controller.network import SocketNetwork
from tests.chaos.common_net import free_port
from tests.fakes.controller import RunningController
from tests.fakes.controller_talk import TEXT
from tools.tree import ROOT

pytestmark = pytest.mark.realtime

HUB = ProcessSpec("services.hub", ("hub",))
DEADLINE_S = 60.0
SHORT = VisitTimeouts(connect_s=0.5, hello_s=0.5, reports_s=0.5, watch_s=1.2, confirm_s=0.5)


@pytest.fixture
def cell_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Path]:
    """A function that makes a cell file on free ports, without a running cell."""
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path))
    monkeypatch.delenv(ENDPOINT_VARIABLE, raising=False)
    monkeypatch.setattr(doctor_link, "PATIENCE", SHORT)

    def make(port: int = 0, base: str = "demo-tcp") -> Path:
        changes: dict[str, object] = {
            "cell": "doctor", "bus.endpoint": f"tcp/127.0.0.1:{free_port()}"
        }  # fmt: skip
        if port:
            changes |= {"gateway.port": port, "gateway.position_per_mm": 50}
        path = tmp_path / "cell.yaml"
        path.write_text(dump_cell(load_cell(ROOT / "cells" / f"{base}.yaml", changes)))
        return path

    return make


def served() -> RunningController:
    """Return a controller with the shipped program, on a socket."""
    return RunningController(TEXT, behaviour=Behaviour(), network=SocketNetwork(port=0))


def run(path: Path) -> tuple[int, dict[str, str]]:
    """Run the verb; return its exit code and the result of each line."""
    result = CliRunner().invoke(app, ["doctor", "--json", "--cell", str(path)])
    report = json.loads(result.stdout)
    assert report["exit_code"] == result.exit_code
    return result.exit_code, {line["check"]: line["result"] for line in report["lines"]}


def test_a_healthy_controller_is_exit_code_0(cell_file: Callable[..., Path]) -> None:
    """The emulated controller with the shipped program."""
    with served() as controller:
        code, words = run(cell_file(controller.port))
    assert code == OK
    assert {check for check, word in words.items() if word == "SKIP"} == {
        "processes",
        "zenoh",
        "sensor",
    }
    assert "FAIL" not in words.values()
    assert words["pose"] == "PASS"


def test_a_cell_file_with_a_mistake_is_exit_code_2(tmp_path: Path) -> None:
    """There is only the line of the cell file; no other check runs."""
    path = tmp_path / "cell.yaml"
    path.write_text("cell: 7\n")
    assert run(path) == (USAGE, {"cell file": "FAIL"})


def test_no_reply_is_exit_code_4(cell_file: Callable[..., Path]) -> None:
    """A closed port, and a simulated cell that is not up; a named probe has its rows."""
    path = cell_file(free_port())
    (path.parent / "probe.yaml").write_text("results: {switch.qtool: {value: -1}}\n")
    path.write_text(path.read_text().replace("\nrobot:\n", "\nrobot:\n  probe: probe.yaml\n"))
    code, words = run(path)
    assert (words["QTOOL"], words["probe"]) == ("WARN", "WARN")
    assert (code, words["address"], words["pose"]) == (NO_ANSWER, "FAIL", "SKIP")
    code, words = run(cell_file(base="demo"))
    assert (code, words["bus"], words["address"]) == (NO_ANSWER, "FAIL", "SKIP")


def test_while_the_cell_is_up_the_controller_is_not_contacted(
    cell_file: Callable[..., Path],
) -> None:
    """With the run file of a live supervisor there is no second client, even without a hub."""
    with served() as controller:
        path = cell_file(controller.port)
        write_run(new_run(load_cell(path), path))  # this test is the supervisor
        code, words = run(path)
        assert (code, words["bus"], "address" in words) == (NO_ANSWER, "FAIL", False)
        assert controller.machine.tcp.sockets == ()


@pytest.mark.processes
def test_a_running_cell_is_observed_on_its_bus(cell_file: Callable[..., Path]) -> None:
    """Without a run file the publisher of robot/health reveals that the controller is in use."""
    with served() as controller, ExitStack() as stack:
        path = cell_file(controller.port)
        cell = load_cell(path)
        other = cell.model_copy(update={"cell": "other"})
        stack.enter_context(Supervisor(other, processes=[HUB]))
        stack.enter_context(publishing_robot(cell))
        found = observe_cell(cell, watch_s=1.0)
        assert found is not None
        assert found.robot is not None
        assert found.robot.numbers == {"sender_hz": 40.0}
        assert found.state is not None
        assert found.stream_hz["wrench"] is None
        assert found.stream_hz["robot/state"] == pytest.approx(50.0, rel=0.5)
        fresh = {
            role
            for role, reading in found.roles.items()
            if not reading.silent and getattr(reading.message, "config_hash", "") == cell_hash(cell)
        }
        assert fresh == {"robot"}
        code, words = run(path)
        assert (code, words["address"], words["process robot"]) == (NOT_WELL, "SKIP", "PASS")
        assert (words["sender"], words["link"]) == ("SKIP", "FAIL")
        assert controller.machine.tcp.sockets == ()


@contextmanager
def publishing_robot(cell: CellConfig) -> Iterator[None]:
    """Publish as a robot 50 times a second."""
    stop = threading.Event()

    def publish() -> None:
        with open_bus(cell, "robot") as bus:
            health = bus.publisher(topics.HEALTH["robot"])
            state = bus.publisher(topics.ROBOT_STATE)
            while not stop.wait(0.02):
                health.put(Health(config_hash=cell_hash(cell), numbers={"sender_hz": 40.0}))
                state.put(RobotState())

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


@pytest.mark.processes
def test_the_verb_visits_the_supplied_program(cell_file: Callable[..., Path]) -> None:
    """Two processes: the emulated controller at 10 % monitor speed, and the command."""
    words = ["-m", "sim.controller", "controller/forcemesh.as", "--port", "0", "--speed", "10"]
    with subprocess.Popen(
        [sys.executable, *words, "--step-ms", "0.125"], cwd=ROOT, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        port = 0
        while not port:
            line = process.stdout.readline()
            assert line
            port = int(line.split()[-1]) if "listening on" in line else 0
        done = subprocess.run(
            [sys.executable, "-m", "cli", "doctor", "--cell", str(cell_file(port))],
            cwd=ROOT,
            capture_output=True,
            text=True,
            timeout=DEADLINE_S,
            check=False,
        )
        process.terminate()
        process.communicate(timeout=DEADLINE_S)
    results = {" ".join(line.split()[1:3]): line.split()[0] for line in done.stdout.splitlines()}
    assert done.returncode == OK, done.stdout + done.stderr
    assert (results["pose 0.000"], results["motor power"], results["left behind"]) == ("PASS",) * 3
    assert results["monitor speed"] == "WARN"
    assert "0 failed" in done.stdout
