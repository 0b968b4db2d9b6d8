"""The sensor driver as a process, with its own cell and with cells that it refuses."""

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from common.bus.cell_bus import open_hub
from common.config.load import load_cell
from common.runtime.service import refuse_other_implementation
from forcemesh import topics
from forcemesh.errors import ConfigError
from forcemesh.zenoh_settings import ENDPOINT_VARIABLE
from services.sensor.rdt import RdtCommand, request
from tests.fakes.rdt_sensor import PATIENCE_S, PERIOD_S, REAL_CELL, ROOT, FakeSensor

pytestmark = pytest.mark.realtime


def test_template_cell_is_conservative_and_complete() -> None:
    """The template loads without a mistake, and its limits are below those of the demo cell."""
    real, demo = load_cell(REAL_CELL), load_cell(ROOT / "cells" / "demo.yaml")
    assert (real.roles.robot, real.roles.sensor) == ("gateway", "driver")
    assert set(real.robot.hosts) == {"pc", "controller"}
    assert real.gateway is not None
    assert real.deadlines == type(real.deadlines)()
    for name in ("step_m", "step_deg", "speed_m_s", "speed_deg_s", "tether_m", "force_N"):
        assert getattr(real.limits, name) < getattr(demo.limits, name)


@pytest.mark.parametrize(
    ("role", "implementation", "other"),
    [("robot", "sim", "gateway"), ("robot", "gateway", "sim"), ("sensor", "driver", "sim")],
)
def test_process_refuses_a_role_that_the_cell_gives_to_another(
    role: str, implementation: str, other: str
) -> None:
    """Two processes never have one role; the error names the field and both remedies."""
    cells = {"sim": ROOT / "cells" / "demo.yaml", "gateway": REAL_CELL}
    wrong = load_cell(cells[other])
    with pytest.raises(
        ConfigError, match=rf"roles\.{role} is {other}.*the {implementation}.*{role}: "
    ):
        refuse_other_implementation(wrong, role, implementation)
    right = load_cell(cells["sim" if implementation == "sim" else "gateway"])
    refuse_other_implementation(right, role, implementation)


@pytest.mark.parametrize(
    ("module", "cell", "message"),
    [
        (
            "services.sensor",
            "demo.yaml",
            "sensor: cell demo: roles.sensor is sim",
        ),
        ("sim.robot", "rs007l-real.yaml", "roles.robot is gateway"),
    ],
)
def test_process_of_another_cell_ends_with_one_clear_error(
    module: str, cell: str, message: str
) -> None:
    """The process ends with exit code 2 and the reason, before it opens the bus."""
    command = [sys.executable, "-m", module, "--cell", f"cells/{cell}"]
    ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert ended.returncode == 2
    assert message in ended.stderr
    assert "Traceback" not in ended.stderr


@pytest.mark.processes
def test_process_publishes_what_the_sensor_sends_and_stops_it_at_the_end(
    sensor: FakeSensor, tmp_path: Path
) -> None:
    """A process with hub and UDP publishes; SIGTERM stops the stream and it exits with 0."""
    text = REAL_CELL.read_text(encoding="utf-8")
    text = text.replace("address: 192.168.1.1", "address: 127.0.0.1")
    text = text.replace("port: 49152 # RDT", f"port: {sensor.port} # RDT")
    cell_file = tmp_path / "cell.yaml"
    cell_file.write_text(text, encoding="utf-8")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    command = [sys.executable, "-m", "services.sensor", "--cell", str(cell_file)]
    environment = os.environ | {ENDPOINT_VARIABLE: endpoint}
    cell = load_cell(cell_file)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(ENDPOINT_VARIABLE, endpoint)
        with open_hub(cell) as hub:
            process = subprocess.Popen(command, cwd=ROOT, env=environment)
            try:
                reader = hub.playing(topics.CLIENT).reader(topics.SENSOR_WRENCH)
                sensor.socket.settimeout(30.0)
                assert sensor.receive() == request(RdtCommand.START)
                deadline_s = time.monotonic() + PATIENCE_S
                while (message := reader.read(time.monotonic_ns()).fresh) is None:
                    assert time.monotonic() < deadline_s
                    sensor.send(sensor.record(force_N=12.5))
                    time.sleep(PERIOD_S)
                process.send_signal(signal.SIGTERM)
                while (data := sensor.receive()) == request(RdtCommand.START):
                    pass
                assert data == request(RdtCommand.STOP)
                assert process.wait(PATIENCE_S) == 0
            finally:
                process.kill()
                process.wait()
    assert message.force_N[2] == 12.5
