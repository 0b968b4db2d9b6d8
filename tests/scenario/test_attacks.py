"""A whole cell with certificates, in processes, and nine attacks of unauthorised clients."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from typer.testing import CliRunner

from cli.__main__ import app
from tests.chaos.common_net import free_port, make_cell
from tests.scenario.conftest import LIGHT
from tools.attacks import ATTACKS

pytestmark = [pytest.mark.judged_once, pytest.mark.realtime, pytest.mark.processes]

ROOT = Path(__file__).parents[2]
PATIENCE_S = 60.0


@pytest.fixture
def cell_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The demo's cell with certificates of its own, on a port of this test alone."""
    monkeypatch.setenv("FORCEMESH_RUN_FOLDER", str(tmp_path))
    overrides = {
        "cell": "attacked",
        "bus.endpoint": f"tls/127.0.0.1:{free_port()}",
        "bus.tls": {"folder": str(tmp_path / "pki")},
        **LIGHT,
    }
    _, path = make_cell("demo", tmp_path, overrides)
    result = CliRunner().invoke(app, ["pki", "init", "--cell", str(path)])
    assert result.exit_code == 0, result.output
    return path


def test_no_client_but_the_arbiter_moves_the_arm(cell_file: Path, tmp_path: Path) -> None:
    """None of nine attacks moves it or is passed on, and the hub reports each refusal."""
    log = tmp_path / "up.log"
    with log.open("w") as output:
        up = subprocess.Popen(
            [sys.executable, "-m", "cli", "up", "--cell", str(cell_file)],
            cwd=ROOT, stdout=output, stderr=subprocess.STDOUT,
        )  # fmt: skip
    try:
        give_up_s = time.monotonic() + PATIENCE_S
        while "is up" not in log.read_text() and time.monotonic() < give_up_s:
            assert up.poll() is None, log.read_text()
            time.sleep(0.1)
        command = [sys.executable, "-m", "tools.attacks", "--cell", str(cell_file), "--json"]
        done = subprocess.run(
            command, cwd=ROOT, capture_output=True, text=True, check=False, env=os.environ
        )
    finally:
        up.terminate()
        up.wait(PATIENCE_S)
    rows = [json.loads(row) for row in done.stdout.splitlines()]
    assert [row["attack"] for row in rows] == [attack.name for attack in ATTACKS], done.stderr
    assert len(rows) == 9
    for row in rows:
        assert row["moved_rad"] < 1e-3, row
        assert row["forwarded"] == 0, row
    report = log.read_text()
    for code in {attack.code for attack in ATTACKS} - {""}:
        assert f"refused {code}" in report
