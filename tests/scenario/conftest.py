"""A cell file for one test alone, and processes that end with their test."""

import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from cli.__main__ import app
from tests.chaos.common_net import free_port, make_cell
from tests.fakes.bench import HALF_RATES
from tests.repeats import real_time

ROOT = Path(__file__).parents[2]
PATIENCE_S = 60.0  # of the test, not of the cell: a loaded machine is slow to start processes

# A quarter of the demo's rates: the results of these tests do not depend on them, and two busy
# processors have the time for it. At full rate the cell needs most of both, and the kernel stops
# real time that needs 95 % of one for 50 ms: `make demo` and bench/ measure that.
LIGHT: dict[str, Any] = {
    "rates": {"robot_hz": 60, "sensor_hz": 120, "control_hz": 60},
    "deadlines": {"command_s": 0.4, "sensor_s": 0.4},
    "force.approach_m_s": 0.005,
}
# Half the demo's rates: a motion of 20 ms is measured in whole periods of the control.
HALF: dict[str, Any] = {
    "rates": HALF_RATES,
    "force.approach_m_s": 0.01,
}

HERE = Path(__file__).parent


@pytest.hookimpl(tryfirst=True)  # before -m selects
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run no test beside a cell in real processes: it needs most of a small machine."""
    for item in items:
        if item.path.is_relative_to(HERE) and real_time(item):
            item.add_marker(pytest.mark.alone)


Start = Callable[..., subprocess.Popen[str]]


@pytest.fixture
def cell_file(tmp_path, monkeypatch) -> Path:
    """The demo's cell, light, under a name, an endpoint and a run folder of this test alone."""
    monkeypatch.setenv("FORCEMESH_RUN_FOLDER", str(tmp_path))
    port = free_port()
    overrides = {"cell": f"demo-{port}", "bus.endpoint": f"tcp/127.0.0.1:{port}", **LIGHT}
    return make_cell("demo", tmp_path, overrides)[1]


@pytest.fixture
def tcp_cell_file(tmp_path, monkeypatch) -> Path:
    """The cell of gateway and emulated controller, light, on ports of this test alone."""
    monkeypatch.setenv("FORCEMESH_RUN_FOLDER", str(tmp_path))
    port = free_port()
    overrides = {
        "cell": f"tcp-{port}",
        "bus.endpoint": f"tcp/127.0.0.1:{port}",
        "gateway.port": free_port(),
        **LIGHT,
        "rates": {**LIGHT["rates"], "robot_hz": 40},
    }
    return make_cell("demo-tcp", tmp_path, overrides)[1]


@pytest.fixture
def tls_cell_file(tmp_path, monkeypatch) -> Path:
    """The demo's cell, light, with certificates of its own in `pki`, on a port of this test."""
    monkeypatch.setenv("FORCEMESH_RUN_FOLDER", str(tmp_path))
    overrides = {
        "cell": "secured",
        "bus.endpoint": f"tls/127.0.0.1:{free_port()}",
        "bus.tls": {"folder": str(tmp_path / "pki")},
        **LIGHT,
    }
    _, path = make_cell("demo", tmp_path, overrides)
    result = CliRunner().invoke(app, ["pki", "init", "--cell", str(path)])
    assert result.exit_code == 0, result.output
    return path


@contextmanager
def _ending(process: subprocess.Popen[str]) -> Iterator[None]:
    yield
    process.terminate()
    process.communicate(timeout=PATIENCE_S)


@pytest.fixture
def start() -> Iterator[Start]:
    """Start a Python process in the project's folder; it ends with the test."""
    with ExitStack() as exits:

        def run(*words: object) -> subprocess.Popen[str]:
            process = subprocess.Popen(
                [sys.executable, *(str(word) for word in words)],
                cwd=ROOT,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )
            exits.enter_context(_ending(process))
            return process

        yield run


def wait_for(process: subprocess.Popen[str], text: str) -> None:
    """Read the standard error of a process until a text is in it."""
    stream, progress = process.stderr, ""
    assert stream is not None
    while text not in progress:
        line = stream.readline()
        assert line, f"it ended without {text!r}: {progress}"
        progress += line
