"""Zenoh as the services use it: a real hub and real clients on a loopback port."""

import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from common.bus.cell_bus import open_bus, open_hub
from common.config.cell import CellConfig
from common.config.load import load_cell
from forcemesh import topics
from forcemesh.bus import Bus, Publisher, Reader
from forcemesh.errors import BusError
from forcemesh.messages import Message, WrenchAtTcp
from forcemesh.zenoh_session import ReceiverThread
from forcemesh.zenoh_settings import ENDPOINT_VARIABLE
from tests.fakes.waiting import wait_until

pytestmark = pytest.mark.realtime

DEMO = Path(__file__).resolve().parents[2] / "cells" / "demo.yaml"
PATIENCE_S = 20.0  # of the test, for a loaded machine


@pytest.fixture
def cell(monkeypatch: pytest.MonkeyPatch) -> CellConfig:
    """A cell on a port that is free."""
    monkeypatch.delenv(ENDPOINT_VARIABLE, raising=False)
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]
    return load_cell(DEMO, {"cell": "zenoh", "bus.endpoint": f"tcp/127.0.0.1:{port}"})


@pytest.fixture
def hub(cell: CellConfig) -> Iterator[Bus]:
    """The cell's hub."""
    with open_hub(cell) as bus:
        yield bus


def until_received(publisher: Publisher, message: Message, *readers: Reader) -> None:
    """Publish until every reader has received a message: from then on nothing is lost."""

    def all_received() -> bool:
        publisher.put(message)
        return all(reader.poll() for reader in readers)

    wait_until(all_received, PATIENCE_S)


def seq(reader: Reader) -> int:
    """Return the number of the newest message."""
    header = reader.read(time.monotonic_ns()).header
    return 0 if header is None else header.seq


@pytest.mark.usefixtures("hub")
def test_a_reader_gets_the_newest_message_only(cell: CellConfig) -> None:
    """A reader that was busy gets the newest message and the number of messages it has missed."""
    with open_bus(cell, "wrench") as writer, open_bus(cell, topics.CLIENT) as client:
        busy, idle = client.reader(topics.WRENCH), client.reader(topics.WRENCH)
        publisher = writer.publisher(topics.WRENCH)
        until_received(publisher, WrenchAtTcp(), busy, idle)
        before, counted_before = seq(busy), busy.counters.received + busy.counters.superseded
        for number in range(1, 51):
            publisher.put(WrenchAtTcp(force_N=(float(number), 0.0, 0.0)))
        newest = WrenchAtTcp(force_N=(50.0, 0.0, 0.0))

        def is_received(reader: Reader) -> bool:
            for _ in range(1000):
                if seq(reader) == publisher.seq:
                    return True
                time.sleep(0.001)
            publisher.put(newest)  # a link that broke on a busy machine has lost the one before
            return False

        wait_until(lambda: is_received(idle) and is_received(busy), PATIENCE_S)
        reading = busy.read(client.clock.now_ns())
        assert reading.fresh == newest
        assert busy.counters.superseded >= 48
        counted = busy.counters.received + busy.counters.superseded
        assert counted - counted_before == publisher.seq - before
        assert busy.poll() is False


@pytest.mark.usefixtures("hub")
def test_no_thread_outlives_its_bus(cell: CellConfig, monkeypatch: pytest.MonkeyPatch) -> None:
    """A thread still in Zenoh when Python exits aborts the process; also a slow thread."""
    listen = ReceiverThread._listen

    def slowly(receiver: ReceiverThread) -> None:
        listen(receiver)
        time.sleep(0.2)

    monkeypatch.setattr(ReceiverThread, "_listen", slowly)
    before = set(threading.enumerate())
    with open_bus(cell, "wrench") as bus:
        bus.reader(topics.SENSOR_WRENCH).wait(0.001)
        assert set(threading.enumerate()) > before
    assert set(threading.enumerate()) <= before


def test_a_hub_that_is_not_there_is_one_clear_error(cell: CellConfig) -> None:
    """It names the endpoint."""
    with (
        pytest.raises(BusError, match=f"no hub at {cell.bus.endpoint}"),
        open_bus(cell, topics.CLIENT, patience_s=0.2),
    ):
        pass
