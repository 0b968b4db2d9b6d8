"""Settings of Zenoh: large receive buffers where nothing may be lost, small batches, one thread."""

import os

import pytest

from common.bus.cell_bus import hub_settings
from forcemesh.codec import MAX_BYTES
from forcemesh.topics import CLIENT, HELPERS, ROLES
from forcemesh.zenoh_settings import (
    BATCH_B,
    ONE_THREAD,
    RUNTIME_VARIABLE,
    client_settings,
    use_one_thread,
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
    """A reader of the newest would read old ones after a stall; a batch has any message."""
    settings = client_settings(HUB, role, {})
    (endpoint,) = settings["connect"]["endpoints"]
    assert endpoint == (f"{HUB}#so_rcvbuf=4000000" if role in HELPERS else HUB)
    for each in (settings, hub_settings(CELL, HUB)):
        assert each["transport"]["link"]["tx"]["batch_size"] == BATCH_B
    assert BATCH_B >= MAX_BYTES + 1024  # with its key and Zenoh's overhead


def test_the_environments_number_of_threads_takes_precedence(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The default is one thread."""
    monkeypatch.delenv(RUNTIME_VARIABLE, raising=False)
    use_one_thread()
    assert os.environ[RUNTIME_VARIABLE] == ONE_THREAD
    monkeypatch.setenv(RUNTIME_VARIABLE, "mine")
    use_one_thread()
    assert os.environ[RUNTIME_VARIABLE] == "mine"
