"""A cell file on a free port with nobody there."""

import socket
from pathlib import Path

import pytest

from cli.context import CELL_VARIABLE
from common.config.load import dump_cell, load_cell
from forcemesh.zenoh_settings import ENDPOINT_VARIABLE
from launch.run_file import FOLDER_VARIABLE

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def cell_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cell on a free port with nobody there; every verb takes it from the environment."""
    with socket.create_server(("127.0.0.1", 0)) as probe:
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    overrides = {"cell": "verbs", "bus.endpoint": endpoint}
    path = tmp_path / "cell.yaml"
    path.write_text(dump_cell(load_cell(ROOT / "cells" / "demo.yaml", overrides)))
    monkeypatch.delenv(ENDPOINT_VARIABLE, raising=False)
    monkeypatch.setenv(CELL_VARIABLE, str(path))
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path))
    monkeypatch.setenv("COLUMNS", "200")
    return path
