"""Messages of one running cell are delivered to another one by mistake: it executes none."""

from pathlib import Path
from threading import Lock

import numpy as np
import pytest
import zenoh

from common.bus.cell_bus import open_bus
from common.config.load import dump_cell, load_cell
from forcemesh import topics
from forcemesh.messages import MAY_MOVE
from tests.chaos.common_net import CellUnderTest, free_port
from tests.fakes.waiting import wait_until
from tests.hostile.client import connected
from tests.scenario.conftest import PATIENCE_S, ROOT, wait_for

STILL_RAD = 1e-3
MESSAGES = 2000

pytestmark = [
    pytest.mark.judged_once,
    pytest.mark.realtime,
    pytest.mark.long,
    pytest.mark.timeout(300),
]


def make_cell_file(folder: Path, name: str) -> Path:
    """Return a demo cell of its own on a free port of this machine."""
    overrides = {
        "cell": name,
        "bus.endpoint": f"tcp/127.0.0.1:{free_port()}",
        "rates": {"robot_hz": 100, "sensor_hz": 100, "control_hz": 100},  # two cells on one machine
    }
    path = folder / f"{name}.yaml"
    path.write_text(dump_cell(load_cell(ROOT / "cells" / "demo.yaml", overrides)))
    return path


class Misdelivery:
    """Delivers everything one cell publishes, byte for byte, under the keys of another."""

    def __init__(self, source: zenoh.Session, sink: zenoh.Session, one: str, other: str) -> None:
        """Start without deliveries."""
        self._sink, self._one, self._other, self._lock = sink, one, other, Lock()
        self.delivered: dict[str, int] = {}
        self._subscriber = source.declare_subscriber(f"{one}/**", self._deliver)

    def _deliver(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr).removeprefix(f"{self._one}/")
        self._sink.put(f"{self._other}/{key}", sample.payload.to_bytes())
        with self._lock:
            self.delivered[key] = self.delivered.get(key, 0) + 1


def test_a_cell_does_not_execute_commands_of_another_one(tmp_path, start, monkeypatch) -> None:
    """One presses, the other is held: it receives all messages, and its joints do not move."""
    monkeypatch.setenv("FORCEMESH_RUN_FOLDER", str(tmp_path))
    files = {name: make_cell_file(tmp_path, name) for name in ("pressing", "standing")}
    cells = {name: load_cell(file) for name, file in files.items()}
    for file in files.values():
        words = ("-m", "cli", "up", "--cell", file, "--no-panel")
        wait_for(start(*words), "is up")
    sessions = {name: connected(cell.bus.endpoint) for name, cell in cells.items()}
    with (
        open_bus(cells["pressing"], topics.CLIENT, patience_s=PATIENCE_S) as one,
        open_bus(cells["standing"], topics.CLIENT, patience_s=PATIENCE_S) as other,
    ):
        presses = CellUnderTest(cells["pressing"], one)
        stands = CellUnderTest(cells["standing"], other)
        presses.make_ready()
        presses.press(5.0)
        presses.until(lambda: presses.state == "ACTIVE", "force feedback")
        stands.until(lambda: stands.held, "a hold")
        rest = stands.joints()
        bridge = Misdelivery(sessions["pressing"], sessions["standing"], "pressing", "standing")
        many = lambda: bridge.delivered.get("robot/command", 0) > MESSAGES  # noqa: E731
        moved_rad = 0.0

        def is_delivered() -> bool:
            nonlocal moved_rad
            moved_rad = max(moved_rad, float(np.abs(stands.joints() - rest).max()))
            assert stands.last_robot.hold_reason
            return many()

        wait_until(is_delivered, PATIENCE_S, "enough is delivered")
        assert moved_rad < STILL_RAD
        stands.until(lambda: stands.state not in ("", *MAY_MOVE), "the arbiter's state")
        assert {"robot/state", "sensor/wrench", "wrench"} <= bridge.delivered.keys()
    for session in sessions.values():
        session.close()
