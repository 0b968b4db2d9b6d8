"""Sources of messages: what a reader holds after it has waited; and what a slow reader costs."""

import queue
from contextlib import suppress
from types import SimpleNamespace
from typing import Any, get_args

import pytest
import zenoh

from common.bus.cell_bus import hub_settings
from forcemesh.codec import MAX_BYTES
from forcemesh.topics import CLIENT, HELPERS, ROLES, Qos
from forcemesh.zenoh_session import ZenohSource, ZenohTransport
from forcemesh.zenoh_settings import BATCH_B, client_settings
from tests.fakes.bench import CELL

HUB = "tcp/127.0.0.1:7447"


class Subscriber:
    """Stands in for Zenoh's: samples arrive in its channel."""

    def __init__(self) -> None:
        self._samples: queue.Queue[Any] = queue.Queue()

    def arrive(self, *data: bytes) -> None:
        """Let samples arrive."""
        for each in data:
            payload = SimpleNamespace(to_bytes=lambda each=each: each)
            self._samples.put(SimpleNamespace(payload=payload))

    def recv(self) -> Any:
        """Return the next sample, and wait for it."""
        return self._samples.get()

    def try_recv(self) -> Any:
        """Return the next sample, None when there is none."""
        return None if self._samples.empty() else self._samples.get()


def taken(source: ZenohSource, count: int) -> list[bytes]:
    """Return so many payloads, waiting before each."""
    found: list[bytes] = []
    while len(found) < count:
        if (data := source.take()) is None:
            source.wait(10.0)
        else:
            found.append(data)
    return found


@pytest.mark.parametrize("room", [2, 5, 1000])
def test_a_reader_that_waits_loses_nothing_while_its_queue_has_room(room: int) -> None:
    """Found with `watch --csv`: a source that had waited once kept the newest message only."""
    subscriber: Any = Subscriber()
    source = ZenohSource(subscriber, room)
    data = [bytes([index % 251]) for index in range(room)]
    subscriber.arrive(b"first")
    assert taken(source, 1) == [b"first"]
    source.wait(0.0)  # from now on a thread receives
    subscriber.arrive(*data)
    assert taken(source, room) == data


def test_a_reader_of_the_newest_gets_the_newest() -> None:
    """Room for one: a control loop never reads an old message."""
    subscriber: Any = Subscriber()
    source = ZenohSource(subscriber, 1)
    source.wait(0.0)
    subscriber.arrive(b"old", b"new")
    while (data := source.take()) != b"new":
        assert data in (None, b"old")
        source.wait(10.0)
    assert source.take() is None


@pytest.mark.parametrize("qos", get_args(Qos))
def test_a_reader_that_does_not_read_delays_no_publisher(qos: Qos) -> None:
    """What its queue does not hold is dropped, of every topic."""
    session: Any = SimpleNamespace(
        declare_publisher=lambda _key, **settings: asked.update(settings)
    )
    asked: dict[str, Any] = {}
    ZenohTransport(session).publish("cell/topic", qos)
    assert asked["congestion_control"] is zenoh.CongestionControl.DROP


def test_what_is_gathered_is_sent_in_order_at_the_end_of_its_block() -> None:
    """Also when the block fails; what a block within it gathered goes first."""
    sent: list[bytes] = []
    publisher = SimpleNamespace(put=sent.append)
    session: Any = SimpleNamespace(declare_publisher=lambda _key, **_settings: publisher)
    transport = ZenohTransport(session)
    put = transport.publish("cell/topic", "stream")
    with suppress(ZeroDivisionError), transport.gathered():
        put(b"later")
        with transport.gathered():
            put(b"first")
            put(b"second")
            assert sent == []
        put(b"last")
        assert sent == [b"first", b"second"]
        raise ZeroDivisionError
    put(b"at once")
    assert sent == [b"first", b"second", b"later", b"last", b"at once"]


@pytest.mark.parametrize("role", [*ROLES, *HELPERS, CLIENT])
def test_only_a_complete_receiver_has_a_large_buffer(role: str) -> None:
    """A reader of the newest message would read old ones after a stall; a batch has the longest."""
    settings = client_settings(HUB, role, {})
    (endpoint,) = settings["connect"]["endpoints"]
    assert endpoint == (f"{HUB}#so_rcvbuf=4000000" if role in HELPERS else HUB)
    for each in (settings, hub_settings(CELL, HUB)):
        assert each["transport"]["link"]["tx"]["batch_size"] == BATCH_B
    assert BATCH_B >= MAX_BYTES + 1024  # with its key and Zenoh's overhead
