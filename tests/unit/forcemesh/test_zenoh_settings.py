"""Settings of Zenoh: large receive buffers where nothing may be lost, small batches, one thread."""

import pytest

from common.bus.cell_bus import hub_settings
from forcemesh.codec import MAX_BYTES
from forcemesh.topics import CLIENT, HELPERS, ROLES
from forcemesh.zenoh_settings import (
    BATCH_B,
    client_settings,
    with_room,
)
from tests.fakes.bench import CELL

HUB = "tcp/127.0.0.1:7447"


@pytest.mark.parametrize(
    ("endpoint", "expected"),
    [
        ("tls/hub:7447", "tls/hub:7447#so_rcvbuf=4000000"),
        ("tcp/hub:7447#iface=eth0", "tcp/hub:7447#iface=eth0;so_rcvbuf=4000000"),
        ("tcp/hub:7447#so_rcvbuf=9", "tcp/hub:7447#so_rcvbuf=9"),
        ("quic/hub:7447", "quic/hub:7447"),
    ],
)
def test_a_stream_endpoint_gets_a_large_receive_buffer(endpoint: str, expected: str) -> None:
    """A user's own setting stays; an endpoint without such a setting is unchanged."""
    assert with_room(endpoint) == expected


@pytest.mark.parametrize("role", [*ROLES, *HELPERS, CLIENT])
def test_only_a_complete_receiver_has_a_large_buffer(role: str) -> None:
    """A reader of the newest message would read old ones after a stall; a batch has the longest."""
    settings = client_settings(HUB, role, {})
    (endpoint,) = settings["connect"]["endpoints"]
    assert endpoint == (f"{HUB}#so_rcvbuf=4000000" if role in HELPERS else HUB)
    for each in (settings, hub_settings(CELL, HUB)):
        assert each["transport"]["link"]["tx"]["batch_size"] == BATCH_B
    assert BATCH_B >= MAX_BYTES + 1024  # with its key and Zenoh's overhead
