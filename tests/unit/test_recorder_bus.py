"""How the recorder is on the bus: with room for seconds, and with one thread."""

import os

import pytest

from common.bus_settings import (
    ONE_THREAD,
    RUNTIME_VARIABLE,
    client_settings,
    listen_with_one_thread,
    with_room,
)
from common.topics import CLIENT, HELPERS, ROLES

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


def test_what_the_environment_says_of_threads_goes_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """One thread unless somebody knows better."""
    monkeypatch.delenv(RUNTIME_VARIABLE, raising=False)
    listen_with_one_thread()
    assert os.environ[RUNTIME_VARIABLE] == ONE_THREAD
    monkeypatch.setenv(RUNTIME_VARIABLE, "mine")
    listen_with_one_thread()
    assert os.environ[RUNTIME_VARIABLE] == "mine"
