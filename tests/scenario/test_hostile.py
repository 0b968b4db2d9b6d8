"""A hostile client with Zenoh and MessagePack alone against a running cell, in processes."""

import ast
import sys
from pathlib import Path

import pytest

from common.config.cell import CellConfig
from launch.run_file import FOLDER_VARIABLE
from tests.hostile import client, playback
from tests.hostile.target import client_of, make_target
from tests.scenario.conftest import LIGHT

pytestmark = [
    pytest.mark.judged_once,
    pytest.mark.realtime,
    pytest.mark.processes,
    pytest.mark.timeout(1800),
]

COUNT = 400


@pytest.fixture
def target(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[CellConfig, Path]:
    """A light cell and its file."""
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path))
    return make_target(tmp_path, LIGHT)


def test_no_hostile_request_or_message_ends_a_process_or_moves_a_held_arm(target) -> None:
    """Every process continues, a held arm rests, every hold works; nightly it sends 10 000."""
    with client_of(*target) as outsider:
        found = client.attack_cell(outsider, COUNT)
    assert client.is_unaffected(found), found
    assert found["holds"] > COUNT // 100
    assert found["replies"]["late"] > 0
    assert found["replies"]["malformed"] > COUNT // 10


def test_a_recording_played_back_moves_nothing(target) -> None:
    """Neither an armed cell, nor a robot that has known no arbiter."""
    found = playback.play_back(*target)
    assert playback.is_unaffected(found), found
    assert {"idle", "goal"} <= found["permitted"].keys()
    assert "no_lease" in found["robot_alone"]["holds"]


def test_the_hostile_client_imports_nothing_of_forcemesh() -> None:
    """Its knowledge of the cell could be read in the documentation."""
    tree = ast.parse(Path(client.__file__).read_text(encoding="utf-8"))
    names = {
        name.partition(".")[0]
        for node in ast.walk(tree)
        if isinstance(node, ast.Import | ast.ImportFrom)
        for name in ([node.module or ""] if isinstance(node, ast.ImportFrom) else
                     [alias.name for alias in node.names])
    }  # fmt: skip
    assert names - set(sys.stdlib_module_names) == {"zenoh", "msgpack"}
