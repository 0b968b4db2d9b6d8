"""The ladder of docs/connect-your-kawasaki.md on an emulated controller, two mistakes included.

Every process is real: controller with sensor over TCP and RDT, cell, verb. The cell file is that of
a real arm; the emulator has a file of its own.
"""

import re
import subprocess
from pathlib import Path

import pytest
import yaml

from common.config.evidence import read_evidence
from common.config.load import dump_cell, load_cell
from tests.chaos.common_net import free_port, make_cell
from tests.scenario.conftest import ROOT, Start, wait_for

PATIENCE_S = 240.0  # of the test, not of the cell: a loaded machine is slow
STEP_MS = "0.125"
TRIES, LOADED = 4, "reduce the load of this machine"  # the remedy of a tuning that does not repeat

pytestmark = [pytest.mark.realtime, pytest.mark.long, pytest.mark.ladder, pytest.mark.timeout(900)]


class Bench:
    """A controller and a PC with one cell file, and a person who types."""

    def __init__(self, folder: Path, start: Start) -> None:
        """Write the cell file with a payload that is 0.4 kg too heavy."""
        self._start, self._folder = start, folder
        self.controller: subprocess.Popen[str] | None = None
        self.cell: subprocess.Popen[str] | None = None
        hub, robot, sensor, page = (free_port() for _ in range(4))
        overrides = {
            "cell": f"bringup-{hub}",
            "bus.endpoint": f"tcp/127.0.0.1:{hub}",
            "gateway.port": robot,
            "sensor.port": sensor,
            "sensor.page_port": page,
            "rates": {"robot_hz": 40, "sensor_hz": 250, "control_hz": 125},
            "deadlines": {"command_s": 0.8, "sensor_s": 0.8},
            "limits.speed_m_s": 0.6,
            "force.approach_m_s": 0.003,
            "calibration": None,
            "recorder.folder": str(folder / "recordings"),
        }
        self.emulator_file = make_cell("demo-netft", folder, overrides)[1]
        self.file = folder / "lab.yaml"
        text = dump_cell(load_cell(self.emulator_file, {"payload.mass_kg": 1.4}))
        self.file.write_text(text + "calibration: lab-calibration.yaml\n")
        self.change("sim", "netft", value=False)

    def change(self, section: str, key: str = "", *, value: object) -> None:
        """Edit the cell file."""
        tree = yaml.safe_load(self.file.read_text())
        if key:
            tree[section][key] = value
        else:
            tree[section] = value
        self.file.write_text(yaml.safe_dump(tree, sort_keys=False))

    def execute(self, program: Path, *, speed: int, until: str) -> None:
        """Load and execute a program on the controller, at a monitor speed [%]."""
        self.stop(self.controller)
        self.controller = self._start(
            "-m", "sim.controller", program, "--cell", self.emulator_file, "--speed", speed,
            "--step-ms", STEP_MS,
        )  # fmt: skip
        assert self.controller.stdout is not None
        while until not in (line := self.controller.stdout.readline()):
            assert line, self.controller.communicate()

    def start_cell(self) -> None:
        """Start the cell anew, as the page requires after each change of its file."""
        self.stop(self.cell)
        self.cell = self._start("-m", "cli", "up", "--no-panel", "--cell", self.file)
        wait_for(self.cell, "is up")

    @staticmethod
    def stop(process: subprocess.Popen[str] | None) -> None:
        """End a process and wait for its end."""
        if process is not None:
            process.terminate()
            process.communicate(timeout=PATIENCE_S)

    def bringup(self, *, fails_at: str = "") -> str:
        """Walk; return what is printed. Again where tune reports other work."""
        for tries_left in reversed(range(TRIES)):
            walk = self._start("-m", "cli", "bringup", "--yes", "--cell", self.file)
            printed, wrong = walk.communicate(timeout=PATIENCE_S)
            if LOADED not in printed or not tries_left:
                return self._judged(walk, printed, wrong, fails_at)
        raise AssertionError  # the last try returns

    @staticmethod
    def _judged(walk: subprocess.Popen[str], printed: str, wrong: str, fails_at: str) -> str:
        assert walk.returncode == (1 if fails_at else 0), printed + wrong
        if fails_at:
            assert f"\nFAIL {fails_at}: " in printed, printed + wrong
        return printed


def test_the_ladder_is_walked_by_its_page_and_finds_two_mistakes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, start: Start
) -> None:
    """Halved monitor speed at the doctor, wrong payload at the axes; then every step passes."""
    monkeypatch.setenv("FORCEMESH_RUN_FOLDER", str(tmp_path))
    monkeypatch.delenv("FORCEMESH_NO_RECORDER", raising=False)
    bench, controller = Bench(tmp_path, start), ROOT / "controller"
    permitted = tmp_path / "fmprobe.as"  # as after fp.ok=1 at the terminal
    permitted.write_text((controller / "fmprobe.as").read_text().replace("fp.ok=0 ;", "fp.ok=1 ;"))
    bench.execute(permitted, speed=100, until="stage.a  1")
    assert "robot.probe" in bench.bringup(fails_at="start")
    bench.change("robot", "probe", value="probe.yaml")

    bench.execute(controller / "forcemesh.as", speed=50, until="listening on")
    printed = bench.bringup(fails_at="doctor")
    assert "50 %; robot.delay_s was measured at 100 %" in printed
    bench.execute(controller / "forcemesh.as", speed=100, until="listening on")
    assert "the cell is not up" in bench.bringup(fails_at="jog")

    bench.start_cell()
    printed = bench.bringup(fails_at="axes")
    weighed = re.search(r"the tool weighs ([\d.]+) kg, but the cell file says 1.4 kg", printed)
    assert weighed is not None
    assert float(weighed[1]) == pytest.approx(1.0, abs=0.01)
    bench.change("payload", "mass_kg", value=1.0)
    assert "changed since the cell was started" in bench.bringup(fails_at="axes")
    bench.start_cell()
    assert "tuning" in bench.bringup(fails_at="press")
    bench.change("tuning", value="tuning.yaml")
    bench.start_cell()
    assert "all steps have passed" in bench.bringup()
    steps = read_evidence(bench.file).steps
    assert all(step.passed_at for step in steps.values())
    assert steps["press"].numbers["mean_N"] == pytest.approx(5.0, abs=0.5)
    assert steps["calibrate"].numbers["mass_kg"] == pytest.approx(1.0, abs=0.02)
    assert list((tmp_path / "recordings").glob("*bringup*.mcap"))

    bench.change("gateway", "host", value="localhost")
    shown = start("-m", "cli", "bringup", "--status", "--cell", bench.file)
    printed, _ = shown.communicate(timeout=PATIENCE_S)
    assert shown.returncode == 1
    assert "next: network" in printed
