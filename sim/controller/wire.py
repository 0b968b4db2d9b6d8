"""In-memory link with the interface of a socket link, for a client in lock step.

`poll` reports events as a socket link does: opened, bytes, lost. Timing depends only on the
virtual clock, so a run is repeatable to the byte.
"""

from collections.abc import Callable
from typing import Generic, TypeVar

from forcemesh.clock import NS_PER_S
from sim.controller.network import MemoryNetwork, MemoryStream

PAUSE_S = 0.1  # between attempts to connect
RECEIVE_BYTES = 16_384

Events = TypeVar("Events")


class LockStepLink(Generic[Events]):
    """Connects to a port of a MemoryNetwork and reconnects after a loss."""

    def __init__(
        self, network: MemoryNetwork, port: int, make_events: Callable[[bool, bytes, str], Events]
    ) -> None:
        """Start unconnected; `make_events` receives opened, data and the reason of a loss."""
        self.connections = 0
        self.last_fault = ""
        self._network, self._port, self._make_events = network, port, make_events
        self._stream: MemoryStream | None = None
        self._rest = b""  # bytes not yet accepted by the stream
        self._lost = ""
        self._next_attempt_ns = 0

    def poll(self, now_ns: int) -> Events:
        """Connect if due, receive, send the rest; return the events."""
        opened, data = False, b""
        if self._stream is None and not self._lost and now_ns >= self._next_attempt_ns:
            opened = self._connect(now_ns)
        if self._stream is not None:
            data = self._receive(now_ns)
            self._flush(now_ns)
        lost, self._lost = self._lost, ""
        return self._make_events(opened, data, lost)

    def send(self, data: bytes, now_ns: int) -> bool:
        """Send bytes; return False without a connection."""
        if self._stream is None:
            return False
        self._rest += data
        self._flush(now_ns)
        return self._stream is not None

    def greeted(self) -> None:
        """Do nothing: there is no back-off to reset in virtual time."""

    def close(self, reason: str, now_ns: int) -> None:
        """Close the connection; the next one is opened after PAUSE_S."""
        if self._stream is not None:
            self._stream.close()
            self._lost = reason
        self.last_fault = reason
        self._stream, self._rest = None, b""
        self._next_attempt_ns = now_ns + round(PAUSE_S * NS_PER_S)

    def _connect(self, now_ns: int) -> bool:
        try:
            self._stream = self._network.dial(self._port)
        except OSError as error:
            self.close(str(error), now_ns)
            return False
        self.connections += 1
        return True

    def _receive(self, now_ns: int) -> bytes:
        assert self._stream is not None  # noqa: S101 - checked by the caller
        try:
            data = self._stream.receive(RECEIVE_BYTES)
        except OSError as error:
            self.close(str(error), now_ns)
            return b""
        if data == b"":
            self.close("closed by the controller", now_ns)
        return data or b""

    def _flush(self, now_ns: int) -> None:
        if self._stream is None or not self._rest:
            return
        try:
            self._rest = self._rest[self._stream.send(self._rest) :]
        except OSError as error:
            self.close(str(error), now_ns)
