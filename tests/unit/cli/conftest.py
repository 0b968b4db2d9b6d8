"""A cell on a free port, without a hub."""

from pathlib import Path

import pytest

from cli.context import CELL_VARIABLE
from common.config.cell import CellConfig
from common.config.load import dump_cell, load_cell
from forcemesh.zenoh_settings import ENDPOINT_VARIABLE
from launch.run_file import FOLDER_VARIABLE
from tests.chaos.common_net import free_port
from tests.fakes.bench import DEMO


@pytest.fixture
def cell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> CellConfig:
    """A cell on a free port, its run files in a folder of this test only."""
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path))
    monkeypatch.delenv(ENDPOINT_VARIABLE, raising=False)
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    return load_cell(DEMO, {"cell": "verbs", "bus.endpoint": endpoint})


@pytest.fixture
def cell_file(cell: CellConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The file of that cell; every verb takes it from the environment."""
    path = tmp_path / "cell.yaml"
    path.write_text(dump_cell(cell))
    monkeypatch.setenv(CELL_VARIABLE, str(path))
    monkeypatch.setenv("COLUMNS", "200")
    return path
