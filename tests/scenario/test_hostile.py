"""A hostile client with Zenoh and MessagePack alone against a running cell, in processes."""

import ast
import json
import subprocess
import sys
from pathlib import Path

import pytest

from common.config.load import load_cell

pytestmark = [
    pytest.mark.judged_once,
    pytest.mark.realtime,
    pytest.mark.processes,
    pytest.mark.timeout(1800),
]

ROOT = Path(__file__).parents[2]


def test_no_hostile_request_or_message_ends_a_process_or_moves_a_held_arm(cell_file: Path) -> None:
    """Every process continues, a held arm rests, every hold works. `make hostile` sends 10 000."""
    count, name = 400, load_cell(cell_file).cell
    command = [sys.executable, "-m", "tools.hostile", "--up", str(cell_file), "--cell", name]
    command += ["--count", str(count)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    found = json.loads(done.stdout)
    assert found["sent"] == count
    assert found["processes_ended"] == found["unforeseen_errors"] == []
    assert found["moved_while_held_rad"] < 1e-3
    assert found["holds_that_worked"] == found["holds"] > count // 100
    assert found["late_executed"] == 0
    assert found["force_owned"] > 0
    assert found["force_taken_over"] == 0
    assert found["replies"]["late"] > 0
    assert found["times_armed"] > 0
    assert found["replies"]["malformed"] > count // 10


def test_a_recording_played_back_moves_nothing(cell_file: Path) -> None:
    """Neither an armed cell, nor a robot that has known no arbiter: `make hostile` runs it too."""
    command = [sys.executable, "-m", "tools.playback", str(cell_file)]
    command += ["--cell", load_cell(cell_file).cell]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    found = json.loads(done.stdout)
    assert {"idle", "goal"} <= found["permitted"].keys()
    assert "no_lease" in found["robot_alone"]["holds"]


def test_the_hostile_client_imports_nothing_of_forcemesh() -> None:
    """Its knowledge of the cell could be read in the documentation."""
    tree = ast.parse((ROOT / "tools" / "hostile.py").read_text(encoding="utf-8"))
    names = {
        name.partition(".")[0]
        for node in ast.walk(tree)
        if isinstance(node, ast.Import | ast.ImportFrom)
        for name in ([node.module or ""] if isinstance(node, ast.ImportFrom) else
                     [alias.name for alias in node.names])
    }  # fmt: skip
    assert names - set(sys.stdlib_module_names) == {"zenoh", "msgpack"}
