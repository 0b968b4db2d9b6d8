"""The whole chain over UDP and TCP in real processes, and the effect of a sensor fault."""

import socket
import urllib.request

import pytest

from common.bus.cell_bus import open_bus
from common.config.load import dump_cell, load_cell
from forcemesh import topics
from forcemesh.requests import ArmRequest
from tests.chaos.common_net import CellUnderTest, free_port
from tests.scenario.conftest import PATIENCE_S, ROOT

pytestmark = pytest.mark.processes

NETFT = ROOT / "cells" / "demo-netft.yaml"


@pytest.fixture
def netft_cell(tmp_path, monkeypatch):
    """The cell on ports of this test alone."""
    monkeypatch.setenv("FORCEMESH_RUN_FOLDER", str(tmp_path))
    port, page_port = free_port(), free_port()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        rdt_port = probe.getsockname()[1]
    overrides = {
        "cell": f"netft-{port}",
        "bus.endpoint": f"tcp/127.0.0.1:{port}",
        "gateway.port": free_port(),
        "sensor.port": rdt_port,
        "sensor.page_port": page_port,
    }
    cell = load_cell(NETFT, overrides)
    (tmp_path / "cell.yaml").write_text(dump_cell(cell))
    return cell, tmp_path / "cell.yaml"


def test_a_second_client_that_takes_the_stream_stops_the_arm(netft_cell, start) -> None:
    """Seven processes, UDP and TCP: armed, deprived of the sensor, stopped with that reason."""
    cell, path = netft_cell
    start("-m", "cli", "up", "--cell", path)
    with open_bus(cell, topics.CLIENT, patience_s=PATIENCE_S) as bus:
        client = CellUnderTest(cell, bus)
        client.until(lambda: client.state == "IDLE", "the cell is up", PATIENCE_S)
        client.tare()
        client.insist(topics.ARM, ArmRequest())
        url = f"http://127.0.0.1:{cell.sensor.page_port}/faults"
        with urllib.request.urlopen(url, b"steal=on") as answer:
            assert answer.status == 200
        client.until(lambda: client.state == "FAULT", "the fault", PATIENCE_S)
        assert "sensor_stolen" in client.causes()
