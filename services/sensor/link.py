"""The one socket of the sensor driver: UDP to the sensor, never blocking, never raising.

`poll` asks for the stream, takes everything that waits, and asks again while nothing comes. Only
datagrams of the sensor's own address and port are let in (the socket is connected).
"""

import socket
from contextlib import suppress
from dataclasses import dataclass

from forcemesh.clock import NS_PER_S

RECEIVE_BYTES = 2048
BUFFER_BYTES = 1 << 20  # as far as the system grants it: a held-up process shall lose nothing here
RECEIVES_PER_POLL = 1000  # a flood cannot keep the loop


@dataclass(frozen=True, slots=True)
class LinkSettings:
    """Where the sensor is, and what it is told."""

    host: str  # best an IP address: looking a name up can take long
    port: int
    start: bytes
    stop: bytes
    ask_after_s: float = 0.25  # of silence, when something came before
    ask_every_s: float = 0.25  # while nothing comes
    reopen_after: int = 8  # unanswered requests: the network may have changed below


@dataclass(frozen=True, slots=True)
class Heard:
    """What has come since the last poll, oldest first."""

    datagrams: list[bytes]
    since_ns: int  # none of them came before
    asked: bool = False  # for a new stream, after these
    unanswered: int = 0  # requests until now


class Link:
    """UDP socket to the sensor."""

    def __init__(self, settings: LinkSettings) -> None:
        """Open nothing yet: the first `poll` does."""
        self.settings = settings
        self.requests = 0
        self.fault = ""  # of the network, empty once the sensor is heard
        self._socket: socket.socket | None = None
        self._unanswered = 0
        self._fault_is_news = False
        self._ask_at_ns = 0
        self._emptied_ns = 0

    @property
    def where(self) -> str:
        """Address of the sensor."""
        return f"sensor {self.settings.host}:{self.settings.port}"

    def poll(self, now_ns: int) -> Heard:
        """Take what waits; ask for the stream when nothing has come for a while."""
        since_ns = self._emptied_ns
        datagrams = self._receive(now_ns)
        if datagrams:
            self.fault, self._unanswered = "", 0
            self._ask_at_ns = now_ns + round(self.settings.ask_after_s * NS_PER_S)
        asked = now_ns >= self._ask_at_ns
        if asked:
            self._ask(now_ns)
        return Heard(datagrams, since_ns, asked, self._unanswered)

    def close(self) -> None:
        """Tell the sensor to stop, as far as it can be reached, and close the socket."""
        if self._socket is not None:
            with suppress(OSError):
                self._socket.send(self.settings.stop)
        self._drop()

    def _receive(self, now_ns: int) -> list[bytes]:
        datagrams: list[bytes] = []
        for _ in range(RECEIVES_PER_POLL):
            if self._socket is None:
                break
            try:
                datagrams.append(self._socket.recv(RECEIVE_BYTES))
            except BlockingIOError:
                self._emptied_ns = now_ns
                break
            except OSError as error:  # what the network says of an earlier request
                self._note(error)
                break
        return datagrams

    def _ask(self, now_ns: int) -> None:
        self._ask_at_ns = now_ns + round(self.settings.ask_every_s * NS_PER_S)
        if not self._fault_is_news:
            self.fault = ""
        self._fault_is_news = False
        if self._unanswered and self._unanswered % self.settings.reopen_after == 0:
            self._drop()
        try:
            if self._socket is None:
                self._open(now_ns)
            if self._socket is not None:
                self._socket.send(self.settings.start)
        except (OSError, UnicodeError) as error:  # a name can be no name at all
            self._note(error)
        self.requests += 1
        self._unanswered += 1

    def _open(self, now_ns: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.settimeout(0.0)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
        self._emptied_ns = now_ns
        try:
            self._socket.connect((self.settings.host, self.settings.port))
        except (OSError, UnicodeError):
            self._drop()
            raise

    def _drop(self) -> None:
        if self._socket is not None:
            self._socket.close()
        self._socket = None

    def _note(self, error: OSError | UnicodeError) -> None:
        text = (isinstance(error, OSError) and error.strerror) or str(error)
        if isinstance(error, ConnectionRefusedError):
            text = "nobody listens there, is the sensor's RDT interface on?"
        self.fault, self._fault_is_news = f"{self.where}: {text}", True
