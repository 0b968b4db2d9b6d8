"""Connections to an ATI sensor, without blocking or exceptions: its stream and its settings page.

The stream comes over UDP. `poll` requests it, receives all waiting datagrams, and repeats the
request during silence. The socket is connected: only datagrams from the sensor's own address and
port are received. The page is read over HTTP in a thread, so that it does not delay the stream.
"""

import http.client
import socket
import threading
from contextlib import suppress
from typing import NamedTuple

from forcemesh.clock import NS_PER_S
from forcemesh.errors import DataError
from services.sensor.netft_page import PATH, SettingsPage, parse
from services.sensor.rdt import RdtCommand, request

DATAGRAM_BYTES = 2048
BUFFER_BYTES = 1 << 20  # as far as the system grants it: a delayed process loses nothing here
RECEIVES_PER_POLL = 1000  # a flood cannot block the loop
REPEAT_REQUEST_S = 0.25  # during silence
REOPEN_AFTER = 8  # unanswered requests: the network may have changed
PAGE_TIMEOUT_S = 2.0
FETCH_AGAIN_S = 1.0  # until the page is received
VERIFY_AGAIN_S = 2.0  # from then on: its user may change units or calibration while it streams
MOST_PAGE_BYTES = 200_000


class ReceivedDatagrams(NamedTuple):
    """Datagrams received since the last poll, oldest first."""

    datagrams: list[bytes]
    since_ns: int  # none was received before
    asked: bool = False  # a new stream was requested after these
    unanswered: int = 0  # requests so far


class UdpLink:
    """UDP link to the sensor."""

    def __init__(self, host: str, port: int, *, ask_after_s: float) -> None:
        """Store the settings; the first `poll` opens the socket.

        Args:
            host: Address of the sensor, preferably in numbers: name resolution can take long.
            port: Its port.
            ask_after_s: Silence after earlier reception until the stream is requested again [s].
        """
        self.requests = 0
        self.fault = ""  # of the network, empty while the sensor is received
        self._address = (host, port)
        self._ask_after_ns = round(ask_after_s * NS_PER_S)
        self._socket: socket.socket | None = None
        self._unanswered = 0
        self._fault_is_new = False
        self._ask_at_ns = 0
        self._emptied_ns = 0

    @property
    def where(self) -> str:
        """Return the address of the sensor."""
        host, port = self._address
        return f"sensor {host}:{port}"

    def poll(self, now_ns: int) -> ReceivedDatagrams:
        """Receive waiting datagrams; request the stream after a time of silence."""
        since_ns = self._emptied_ns
        datagrams = self._receive(now_ns)
        if datagrams:
            self.fault, self._unanswered = "", 0
            self._ask_at_ns = now_ns + self._ask_after_ns
        asked = now_ns >= self._ask_at_ns
        if asked:
            self._ask(now_ns)
        return ReceivedDatagrams(datagrams, since_ns, asked, self._unanswered)

    def close(self) -> None:
        """Send the stop request, if the sensor can be reached, and close the socket."""
        if self._socket is not None:
            with suppress(OSError):
                self._socket.send(request(RdtCommand.STOP))
        self._drop()

    def _receive(self, now_ns: int) -> list[bytes]:
        datagrams: list[bytes] = []
        for _ in range(RECEIVES_PER_POLL):
            if self._socket is None:
                break
            try:
                datagrams.append(self._socket.recv(DATAGRAM_BYTES))
            except BlockingIOError:
                self._emptied_ns = now_ns
                break
            except OSError as error:  # error of an earlier request
                self._note(error)
                break
        return datagrams

    def _ask(self, now_ns: int) -> None:
        self._ask_at_ns = now_ns + round(REPEAT_REQUEST_S * NS_PER_S)
        if not self._fault_is_new:
            self.fault = ""
        self._fault_is_new = False
        if self._unanswered and self._unanswered % REOPEN_AFTER == 0:
            self._drop()
        try:
            if self._socket is None:
                self._open(now_ns)
            if self._socket is not None:
                self._socket.send(request(RdtCommand.START))
        except (OSError, UnicodeError) as error:  # invalid host name
            self._note(error)
        self.requests += 1
        self._unanswered += 1

    def _open(self, now_ns: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.settimeout(0.0)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
        self._emptied_ns = now_ns
        try:
            self._socket.connect(self._address)
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
            text = "connection refused: switch on the sensor's RDT interface"
        self.fault, self._fault_is_new = f"{self.where}: {text}", True


class PageFetch:
    """HTTP client that requests the page until it is received, then again to verify it."""

    def __init__(self, host: str, port: int) -> None:
        """Store the address; the first `poll` sends the request."""
        self.fault = "not read yet"
        self.verified_ns = 0  # request of the newest page
        self._where = (host, port)
        self._page: SettingsPage | None = None
        self._next_ns = 0
        self._thread: threading.Thread | None = None

    def poll(self, now_ns: int) -> SettingsPage | None:
        """Return the newest page, None until it is received."""
        busy = self._thread is not None and self._thread.is_alive()
        if not busy and now_ns >= self._next_ns:
            wait_s = FETCH_AGAIN_S if self._page is None else VERIFY_AGAIN_S
            self._next_ns = now_ns + round(wait_s * NS_PER_S)
            self._thread = threading.Thread(target=self._fetch, args=(now_ns,), daemon=True)
            self._thread.start()
        return self._page

    def clear(self) -> None:
        """Drop the page and fetch it again: the sensor may have been replaced."""
        self._page, self.fault, self._next_ns = None, "not read yet", 0

    def _fetch(self, asked_ns: int) -> None:
        host, port = self._where
        connection = http.client.HTTPConnection(host, port, timeout=PAGE_TIMEOUT_S)
        try:
            connection.request("GET", PATH)
            answer = connection.getresponse()
            text = answer.read(MOST_PAGE_BYTES).decode("utf-8", errors="replace")
            if answer.status == http.client.OK:
                self._page, self.verified_ns = parse(text), asked_ns
            else:
                self._failed(f"HTTP {answer.status} {answer.reason}")
        except (OSError, http.client.HTTPException, DataError) as error:
            self._failed(str(error))
        finally:
            connection.close()

    def _failed(self, why: str) -> None:
        host, port = self._where
        self.fault = f"http://{host}:{port}{PATH}: {why}"
