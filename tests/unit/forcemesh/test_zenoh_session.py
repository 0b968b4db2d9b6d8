"""Sources of messages on real sockets."""

import socket
import time

import pytest

from common.bus.cell_bus import open_bus, open_hub
from common.config.load import load_cell
from forcemesh import topics
from forcemesh.messages import WrenchAtTcp
from tests.fakes.bench import DEMO

pytestmark = pytest.mark.realtime

COUNT, ROOM, PATIENCE_S = 500, 1000, 30.0


def test_a_reader_that_waits_loses_nothing_while_its_queue_has_room() -> None:
    """Found with `watch --csv`: a source that had waited once kept the newest message only."""
    with socket.create_server(("127.0.0.1", 0)) as probe:
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    cell = load_cell(DEMO, {"cell": "tap", "bus.endpoint": endpoint})
    with open_hub(cell) as hub, open_bus(cell, topics.CLIENT) as client:
        tap = client.tap(topics.WRENCH, ROOM)
        publisher, received = hub.playing("wrench").publisher(topics.WRENCH), 0
        give_up_s = time.monotonic() + PATIENCE_S
        while tap.take() is None:  # until the subscription has reached the publisher
            assert time.monotonic() < give_up_s
            publisher.put(WrenchAtTcp())
            tap.wait(0.05)
        while tap.take() is not None:
            pass
        for _ in range(COUNT):
            publisher.put(WrenchAtTcp())
        while received < COUNT:
            assert time.monotonic() < give_up_s, f"{received} of {COUNT} messages arrived"
            if tap.take() is None:
                tap.wait(0.05)
            else:
                received += 1
