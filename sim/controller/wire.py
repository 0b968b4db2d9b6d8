"""A client's end of a wire in memory, in the shape of a socket link: lock step with a controller.

`poll` says what happened as a socket's link would: opened, bytes, lost. Nothing but the virtual
clock decides when, so a run is repeatable to the byte.
"""

from collections.abc import Callable
from typing import Generic, TypeVar

from forcemesh.clock import NS_PER_S
from sim.controller.network import MemoryNetwork, MemoryStream

PAUSE_S = 0.1  # between attempts to connect
RECEIVE_BYTES = 16_384

News = TypeVar("News")


class LockStepWire(Generic[News]):
    """Connects to a port of a MemoryNetwork and stays connected as long as it can."""

    def __init__(
        self, network: MemoryNetwork, port: int, make_news: Callable[[bool, bytes, str], News]
    ) -> None:
        """Open nothing yet; `make_news` gets opened, data and why the connection was lost."""
        self.connections = 0
        self.last_fault = ""
        self._network, self._port, self._make_news = network, port, make_news
        self._stream: MemoryStream | None = None
        self._rest = b""  # what the wire has not taken
        self._lost = ""
        self._next_attempt_ns = 0

    def poll(self, now_ns: int) -> News:
        """Connect if it is time, receive, send what is left; return what happened."""
        opened, data = False, b""
        if self._stream is None and not self._lost and now_ns >= self._next_attempt_ns:
            opened = self._connect(now_ns)
        if self._stream is not None:
            data = self._receive(now_ns)
            self._flush(now_ns)
        lost, self._lost = self._lost, ""
        return self._make_news(opened, data, lost)

    def send(self, data: bytes, now_ns: int) -> bool:
        """Hand bytes over; False when there is no connection."""
        if self._stream is None:
            return False
        self._rest += data
        self._flush(now_ns)
        return self._stream is not None

    def greeted(self) -> None:
        """Pauses do not grow in virtual time: nothing to take back."""

    def close(self, reason: str, now_ns: int) -> None:
        """Give the connection up; the next one is opened after the pause."""
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
        assert self._stream is not None  # noqa: S101 - its caller has looked
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
