"""The recorder as a process on a real bus: killed, stopped by request, replayed byte by byte."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import yaml
from mcap.reader import NonSeekingReader

from common.bus.cell_bus import open_bus, open_hub
from common.config.cell import CellConfig
from common.config.load import load_cell
from forcemesh import topics
from forcemesh.bus import Bus, Publisher, Reader
from forcemesh.messages import Health, WrenchAtTcp
from forcemesh.requests import Empty, RecordRequest
from forcemesh.topics import CLIENT
from forcemesh.zenoh_settings import ENDPOINT_VARIABLE
from services.recorder.reading import RecordedFile
from tests.chaos.common_net import free_port
from tests.fakes.waiting import wait_until
from tests.unit.services.recorder.test_recording import of_every_topic, recorded

pytestmark = pytest.mark.realtime

ROOT = Path(__file__).resolve().parents[2]
DEMO = ROOT / "cells" / "demo.yaml"
PATIENCE_S = 30.0
RATE_S = 0.004
LOST_S = 1.0  # of the end of a recording whose recorder is killed
ROOM = 10_000


@pytest.fixture
def cell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> CellConfig:
    """A cell that records into a folder of the test, on a free port."""
    monkeypatch.delenv(ENDPOINT_VARIABLE, raising=False)
    settings = {"recorder.folder": str(tmp_path), "recorder.least_free_GB": 0.0}
    return load_cell(DEMO, {"bus.endpoint": f"tcp/127.0.0.1:{free_port()}", **settings})


@contextmanager
def started(cell: CellConfig, folder: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Run a recorder of the cell as a process."""
    path = folder / "cell.yaml"
    path.write_text(yaml.safe_dump(cell.model_dump(mode="json", exclude_none=True)))
    command = [sys.executable, "-m", "services.recorder", "--cell", str(path)]
    with subprocess.Popen(command, cwd=ROOT) as process:
        try:
            yield process
        finally:
            process.kill()


def publish_for(publisher: Publisher[WrenchAtTcp], duration_s: float) -> None:
    """Publish a topic at its usual rate."""
    end_s = time.monotonic() + duration_s
    while time.monotonic() < end_s:
        publisher.put(WrenchAtTcp(force_N=(1.0, 2.0, 3.0)))
        time.sleep(RATE_S)


def recorder_health(client: Bus) -> Reader[Health]:
    """Return the reader of the recorder's health once a message is received."""
    health = client.reader(topics.HEALTH["recorder"])
    wait_until(lambda: health.read(client.clock.now_ns()).fresh, PATIENCE_S)
    return health


def test_after_a_kill_the_file_opens_up_to_the_last_second(
    cell: CellConfig, tmp_path: Path
) -> None:
    """Killed in motion: no gap before, at most one second lost; any reader opens the file."""
    with (
        open_hub(cell) as hub,
        open_bus(cell, CLIENT, patience_s=PATIENCE_S) as client,
        started(cell, tmp_path) as process,
    ):
        recorder_health(client)
        publisher = hub.playing("wrench").publisher(topics.WRENCH)
        assert client.ask(topics.RECORD_START, RecordRequest(), PATIENCE_S).accepted
        publish_for(publisher, 3.0)
        killed_ns = time.time_ns()
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
    (path,) = tmp_path.glob("*.mcap")
    read = RecordedFile(path)
    wrenches = list(read.messages("wrench"))
    numbers = [each.fields["seq"] for each in wrenches]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    assert (killed_ns - wrenches[-1].at_ns) / 1e9 < LOST_S
    assert not read.is_whole
    other_read: list[object] = []
    with path.open("rb") as stream, pytest.raises(Exception):  # noqa: B017, PT011 - of mcap, at the end
        other_read.extend(NonSeekingReader(stream).iter_messages(["wrench"], log_time_order=False))
    assert len(other_read) == len(wrenches)


@pytest.mark.long
def test_the_process_completes_its_file_on_sigterm(cell: CellConfig, tmp_path: Path) -> None:
    """SIGTERM: the file is complete, nothing is lost; the reply to stop states its length."""
    with (
        open_hub(cell) as hub,
        open_bus(cell, CLIENT, patience_s=PATIENCE_S) as client,
        started(cell, tmp_path) as process,
    ):
        health = recorder_health(client)
        publisher = hub.playing("wrench").publisher(topics.WRENCH)
        assert client.ask(topics.RECORD_START, RecordRequest(label="one"), PATIENCE_S).accepted
        publish_for(publisher, 0.5)
        reply = client.ask(topics.RECORD_STOP, Empty(), PATIENCE_S)
        assert " 0 lost" in reply.text
        assert client.ask(topics.RECORD_START, RecordRequest(label="two"), PATIENCE_S).accepted
        publish_for(publisher, 0.5)
        message = health.read(client.clock.now_ns()).message
        assert message is not None
        assert message.counters["realtime"] == 0
        process.terminate()
        assert process.wait(PATIENCE_S) == 0
    for path in tmp_path.glob("*.mcap"):
        read = RecordedFile(path)
        assert len(list(read.messages("wrench"))) > 30
        assert read.is_whole


def test_a_replay_never_publishes_to_a_running_cell(cell: CellConfig, tmp_path: Path) -> None:
    """Refused while another process publishes one of its topics."""
    path, cell_file = recorded(tmp_path, of_every_topic(rounds=1)), tmp_path / "cell.yaml"
    cell_file.write_text(yaml.safe_dump(cell.model_dump(mode="json", exclude_none=True)))
    command = [sys.executable, "-m", "cli", "replay", str(path), "--onto", str(cell_file)]
    with open_hub(cell) as hub:
        publisher = hub.playing("wrench").publisher(topics.WRENCH)
        tap = hub.playing(CLIENT).tap(topics.ROBOT_COMMAND, ROOM)
        with subprocess.Popen(command, cwd=ROOT, stderr=subprocess.PIPE, text=True) as process:
            while process.poll() is None:
                publish_for(publisher, 0.05)
            assert process.returncode == 3
            assert process.stderr is not None
            assert "a cell demo is running there and publishes wrench" in process.stderr.read()
        assert tap.take() is None
