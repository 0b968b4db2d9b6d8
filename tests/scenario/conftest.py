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
HERE = Path(__file__).parent


@pytest.hookimpl(tryfirst=True)  # before -m selects
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run no test beside a cell in real processes: it needs most of a small machine."""
    for item in items:
        if item.path.is_relative_to(HERE) and real_time(item):
            item.add_marker(pytest.mark.alone)


Start = Callable[..., subprocess.Popen[str]]


def alone(name: str, tmp_path: Path, scheme: str, **more: Any) -> Path:
    """Return the file of a light cell on a port and in a run folder of this test alone."""
    port = free_port()
    places = {"cell": f"{name}-{port}", "bus.endpoint": f"{scheme}/127.0.0.1:{port}"}
    return make_cell(name, tmp_path, places | LIGHT | more)[1]


@pytest.fixture
def cell_file(tmp_path, monkeypatch) -> Path:
    """The demo's cell."""
    monkeypatch.setenv("FORCEMESH_RUN_FOLDER", str(tmp_path))
    return alone("demo", tmp_path, "tcp")


@pytest.fixture
def tcp_cell_file(tmp_path, monkeypatch) -> Path:
    """The cell of gateway and emulated controller."""
    monkeypatch.setenv("FORCEMESH_RUN_FOLDER", str(tmp_path))
    changes = {"gateway.port": free_port(), "rates": {**LIGHT["rates"], "robot_hz": 40}}
    return alone("demo-tcp", tmp_path, "tcp", **changes)


@pytest.fixture
def tls_cell_file(tmp_path, monkeypatch) -> Path:
    """The demo's cell with certificates of its own in `pki`."""
    monkeypatch.setenv("FORCEMESH_RUN_FOLDER", str(tmp_path))
    path = alone("demo", tmp_path, "tls", **{"bus.tls": {"folder": str(tmp_path / "pki")}})
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
