"""The whole chain over UDP and TCP in real processes, and the effect of a sensor fault."""

import socket
import time
import urllib.request

import pytest

from common.bus.cell_bus import open_bus
from common.config.load import dump_cell, load_cell
from forcemesh import topics
from forcemesh.errors import ConfigError
from forcemesh.requests import ArmRequest, Empty
from launch.processes import processes_of
from tests.chaos.common_net import free_port
from tests.scenario.conftest import PATIENCE_S, ROOT

pytestmark = pytest.mark.processes

NETFT = ROOT / "cells" / "demo-netft.yaml"


def test_the_process_of_the_arm_serves_its_sensor_and_the_driver_publishes_it() -> None:
    """Every role of the bus has its process; the emulated controller has none of them."""
    played = {p.roles: p.module for p in processes_of(load_cell(NETFT))}
    assert played[("controller",)] == "sim.controller"
    assert played[("sensor",)] == "services.sensor"
    assert sum(roles in {(role,) for role in topics.ROLES} for roles in played) == len(topics.ROLES)


@pytest.mark.parametrize("wrong", [{"roles.sensor": "sim"}, {"roles.sensor": "external"}])
def test_a_simulated_net_ft_without_a_reader_is_refused(wrong) -> None:
    """The cell file is refused, with the field to change."""
    with pytest.raises(ConfigError, match=r"sim\.netft"):
        load_cell(NETFT, wrong)


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


class Client:
    """Client that observes and commands the cell."""

    def __init__(self, bus) -> None:
        """Subscribe."""
        self.bus = bus
        self.status = bus.reader(topics.ARBITER_STATUS)

    def until(self, what) -> None:
        """Wait until a condition is true."""
        give_up_s = time.monotonic() + PATIENCE_S
        while not what():
            assert time.monotonic() < give_up_s, self.arbiter_status()
            time.sleep(0.02)

    def arbiter_status(self):
        """Return the newest status of the arbiter."""
        return self.status.read(time.monotonic_ns()).fresh

    def is_in(self, *states: str) -> bool:
        """Return whether the arbiter is in one of some states."""
        status = self.arbiter_status()
        return status is not None and status.state in states

    def trips(self) -> dict[str, str]:
        """Return the trips: texts by their codes."""
        status = self.arbiter_status()
        return {} if status is None else {trip.code: trip.text for trip in status.trips}


def test_a_second_client_that_takes_the_stream_stops_the_arm(netft_cell, start) -> None:
    """Seven processes, UDP and TCP: armed, deprived of the sensor, stopped with that reason."""
    cell, path = netft_cell
    start("-m", "cli", "up", "--cell", path)
    with open_bus(cell, topics.CLIENT, patience_s=PATIENCE_S) as bus:
        client = Client(bus)
        client.until(lambda: client.is_in("IDLE"))
        client.until(lambda: bus.ask(topics.TARE, Empty()).accepted)
        client.until(lambda: bus.ask(topics.ARM, ArmRequest()).accepted)
        url = f"http://127.0.0.1:{cell.sensor.page_port}/faults"
        with urllib.request.urlopen(url, b"steal=on") as answer:
            assert answer.status == 200
        client.until(lambda: client.is_in("FAULT") and "sensor_stolen" in client.trips())
        assert "another client took its stream" in client.trips()["sensor_stolen"]
