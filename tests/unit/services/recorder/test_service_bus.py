"""How the recorder is on the bus: with room for seconds, and with one thread."""

import os
from typing import Any

import pytest

from common.bus.hub_settings import hub_settings
from forcemesh.codec import MAX_BYTES
from forcemesh.topics import CLIENT, HELPERS, ROLES
from forcemesh.zenoh_settings import (
    BATCH_B,
    ONE_THREAD,
    RUNTIME_VARIABLE,
    client_settings,
    listen_with_one_thread,
    with_room,
)
from tests.fakes.bench import CELL

HUB = "tcp/127.0.0.1:7447"


@pytest.mark.parametrize(
    ("endpoint", "roomy"),
    [
        (HUB, f"{HUB}#so_rcvbuf=4000000"),
        ("tls/hub:7447", "tls/hub:7447#so_rcvbuf=4000000"),
        ("tcp/hub:7447#iface=eth0", "tcp/hub:7447#iface=eth0;so_rcvbuf=4000000"),
        ("tcp/hub:7447#so_rcvbuf=9", "tcp/hub:7447#so_rcvbuf=9"),
        ("unixsock-stream//tmp/hub", "unixsock-stream//tmp/hub"),
        ("quic/hub:7447", "quic/hub:7447"),
    ],
)
def test_an_endpoint_gets_room_where_it_is_a_stream(endpoint: str, roomy: str) -> None:
    """What a user has set stays; what has no such setting is left alone."""
    assert with_room(endpoint) == roomy


@pytest.mark.parametrize("role", [*ROLES, *HELPERS, CLIENT])
def test_only_who_must_miss_nothing_has_room(role: str) -> None:
    """A reader that keeps the newest alone would read old messages after a stall."""
    (endpoint,) = client_settings(HUB, role, {})["connect"]["endpoints"]
    assert (endpoint != HUB) == (role in HELPERS)


def test_the_longest_message_goes_in_one_piece() -> None:
    """What is heard takes buffers that are small, and large enough."""
    sizes = {settings["transport"]["link"]["tx"]["batch_size"] for settings in every_setting()}
    assert sizes == {BATCH_B}
    assert BATCH_B >= MAX_BYTES + 1024  # with its key and what Zenoh adds


def every_setting() -> list[dict[str, Any]]:
    """Return the settings of the hub and of whoever is its client."""
    return [hub_settings(CELL, HUB), *(client_settings(HUB, role, {}) for role in (*ROLES, CLIENT))]


def test_what_the_environment_says_of_threads_goes_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """One thread unless somebody knows better."""
    monkeypatch.delenv(RUNTIME_VARIABLE, raising=False)
    listen_with_one_thread()
    assert os.environ[RUNTIME_VARIABLE] == ONE_THREAD
    monkeypatch.setenv(RUNTIME_VARIABLE, "mine")
    listen_with_one_thread()
    assert os.environ[RUNTIME_VARIABLE] == "mine"
