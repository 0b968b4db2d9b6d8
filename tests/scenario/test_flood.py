"""A client that publishes too much, and a frozen one: no other process is affected.

Short runs for every day. The whole tests are `tests.chaos.flood` and `tests.chaos.soak`.
"""

import json
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import zenoh

from common.bus.cell_bus import LONGEST_MESSAGE_B, open_hub
from common.bus.memory_bus import MemoryTransport
from common.config.cell import CellConfig
from common.config.load import load_cell
from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.clock import ManualClock
from forcemesh.codec import encode_record
from forcemesh.inbox import MOST_AT_ONCE
from forcemesh.requests import Empty
from forcemesh.zenoh_session import ZenohTransport
from tests.chaos import flood
from tests.chaos.common_net import free_port, make_cell, running_cell
from tests.chaos.flood_peer import session_of
from tests.chaos.witness import witness
from tests.scenario.conftest import LIGHT

DEMO = Path(__file__).resolve().parents[2] / "cells" / "demo.yaml"
PATIENCE_S = 20.0  # of the test, for a loaded machine
FROZEN = 3  # clients
VIEWER = """
import sys, time
from common.bus.cell_bus import open_bus
from common.config.load import load_cell
from forcemesh import topics

with open_bus(load_cell(sys.argv[1]), topics.CLIENT) as bus:
    bus.reader(topics.WRENCH)
    print("viewing", flush=True)
    time.sleep(60.0)
"""
# A link ends half a second after its last word; lingering on it took until the end of the test.
FILLED_S, STALL_S, PAUSE_S = 5.0, 3.0, 0.002


@pytest.fixture
def cell() -> CellConfig:
    """A cell on a port that is free."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    return load_cell(DEMO, {"cell": "flood", "bus.endpoint": endpoint})


class EndlessSource:
    """A client whose requests arrive faster than a service can answer them."""

    def __init__(self, data: bytes) -> None:
        """Store the request that is always repeated."""
        self.data, self.replies = data, 0

    def take(self) -> "EndlessSource":
        """Return the next request, without end."""
        return self

    def answer(self, _data: bytes) -> None:
        """Count a reply."""
        self.replies += 1


@pytest.mark.parametrize("data", [b"\xc1", encode_record(Empty())], ids=["garbage", "good"])
def test_endless_requests_do_not_keep_a_service_in_one_step(data):
    """A step answers a few and continues its work, whether they can be decoded or not."""
    source: Any = EndlessSource(data)
    transport: Any = MemoryTransport()
    transport.serve = lambda _key: source
    arbiter = Bus("arbiter", "demo", transport, load_cell(DEMO), ManualClock())
    taken = list(arbiter.inbox(topics.CLEAR).take_all())

    assert len(taken) + source.replies == MOST_AT_ONCE


def received(
    session: zenoh.Session, subscriber: Any, key: str, sizes: list[int], last: int
) -> list[int]:
    """Put messages of these sizes until one of size `last` arrives; return the received ones."""
    for size in sizes:
        session.put(key, b"\0" * size)
    got: list[int] = []
    give_up_s = time.monotonic() + PATIENCE_S
    while last not in got:
        assert time.monotonic() < give_up_s, f"only {got} came through"
        session.put(key, b"\0" * last)
        time.sleep(0.01)
        while (sample := subscriber.try_recv()) is not None:
            got.append(len(sample.payload.to_bytes()))
    return got


@pytest.mark.realtime
def test_the_hub_passes_no_long_message_on(cell):
    """A message longer than any message of the table ends at the hub; the next one does not."""
    long = [LONGEST_MESSAGE_B + 1, 5 * LONGEST_MESSAGE_B, 200_000]
    with open_hub(cell), session_of(cell) as writer, session_of(cell) as reader:
        subscriber = reader.declare_subscriber("any/key", zenoh.handlers.FifoChannel(100))
        received(writer, subscriber, "any/key", [], last=1)
        got = received(writer, subscriber, "any/key", [*long, LONGEST_MESSAGE_B], last=2)

    assert set(got) <= {1, 2, LONGEST_MESSAGE_B}
    assert LONGEST_MESSAGE_B in got


@pytest.mark.processes
def test_clients_that_stand_still_do_not_stop_the_hub(start, tmp_path):
    """Found: at the end of each one's link the hub stood still for 10 s, and the arm held."""
    ports = {"cell": "frozen", "bus.endpoint": f"tcp/127.0.0.1:{free_port()}"}
    cell, path = make_cell("demo", tmp_path, ports)
    start("-m", "services.hub", "--cell", path)
    viewers = [start("-c", VIEWER, path) for _ in range(FROZEN)]
    for viewer in viewers:
        assert viewer.stdout.readline() == "viewing\n"
    with session_of(cell) as writer, session_of(cell) as reader:
        key = f"{cell.cell}/{topics.WRENCH.key}"
        subscriber = reader.declare_subscriber(key, zenoh.handlers.RingChannel(1))
        received(writer, subscriber, key, [], last=1)
        health = reader.declare_subscriber(f"{cell.cell}/{topics.HEALTH['hub'].key}")
        for _ in range(2):  # its own loop runs, and has seen every link
            health.recv()
        for viewer in viewers:
            viewer.send_signal(signal.SIGSTOP)
        try:
            longest_s = longest_gap_s(writer, subscriber, key)
        finally:
            for viewer in viewers:
                viewer.send_signal(signal.SIGCONT)
    assert longest_s < STALL_S


def longest_gap_s(writer: zenoh.Session, subscriber: Any, key: str) -> float:
    """Put messages that fill every buffer on the way; return the longest time between two."""
    longest_s, last_s = 0.0, time.monotonic()
    give_up_s = last_s + FILLED_S
    while (now_s := time.monotonic()) < give_up_s:
        writer.put(key, b"\0" * LONGEST_MESSAGE_B)
        longest_s = max(longest_s, now_s - last_s)
        if subscriber.try_recv() is not None:
            last_s = now_s
        time.sleep(PAUSE_S)
    return longest_s


@pytest.mark.realtime
def test_a_transport_reports_its_longest_put(cell):
    """The put duration in health comes from puts: none, none earlier, the longest since."""
    with open_hub(cell), session_of(cell) as session:
        transport = ZenohTransport(session)
        assert transport.longest_put_s(0) == 0.0
        put = transport.publish("any/key", "stream")
        put(b"one")
        between_ns = time.monotonic_ns()
        first_s = transport.longest_put_s(0)
        assert first_s > 0.0
        assert transport.longest_put_s(between_ns) == 0.0
        put(b"two")
        assert transport.longest_put_s(0) >= transport.longest_put_s(between_ns) > 0.0


@pytest.fixture
def pressing(tmp_path, monkeypatch) -> Iterator[tuple[flood.HealthMonitor, Path]]:
    """Return a real cell that presses, and its client.

    A miss here is a missed deadline of that cell; `tests.chaos.flood` requires milliseconds, on a
    machine without other load.
    """
    monkeypatch.setenv("FORCEMESH_RUN_FOLDER", str(tmp_path))
    overrides = {"cell": "flood", "bus.endpoint": f"tcp/127.0.0.1:{free_port()}", **LIGHT}
    cell, path = make_cell("demo", tmp_path, overrides)
    with witness(tmp_path) as watch, running_cell(cell, path) as under_test:
        under_test.tare()
        under_test.make_ready()
        under_test.press(flood.PRESS_N)
        time.sleep(flood.HEALTH_WINDOW_S)  # health covers one second and is received later
        deadline_s = cell.deadlines.sensor_s
        yield (
            flood.HealthMonitor(under_test, watch, flood.TimingLimits(deadline_s, deadline_s)),
            path,
        )


@pytest.mark.processes
def test_a_frozen_viewer_and_a_flood_delay_no_process(pressing):
    """One second of each: no loop and no put misses a deadline that an idle process does not."""
    watcher, path = pressing
    frozen = flood.frozen_viewer(watcher, path, 1.0)
    flooded, sent = flood.flooded(watcher, path, "mixed", seconds=1.0, rate_hz=1000, least_hz=100)

    assert frozen.mistakes == []
    assert flooded.mistakes == []
    assert json.loads(sent)["questions"] > 30
