"""HTTP client for the sensor's page, in a thread, so that it does not delay the stream."""

import http.client
import threading
from typing import Protocol

from forcemesh.clock import NS_PER_S
from forcemesh.errors import DataError
from services.sensor.netft_page import PATH, SettingsPage, parse

TIMEOUT_S = 2.0
FETCH_AGAIN_S = 1.0
MOST_PAGE_BYTES = 200_000


class PageSource(Protocol):
    """Source of the page."""

    fault: str

    def poll(self, now_ns: int) -> SettingsPage | None:
        """Return the page, None until it is received."""

    def clear(self) -> None:
        """Drop the page and fetch it again: the sensor may have been replaced."""


class PageFetch:
    """HTTP client that repeats its request every second until the page is received."""

    def __init__(self, host: str, port: int) -> None:
        """Store the address; the first `poll` sends the request."""
        self.fault = "not read yet"
        self._where = (host, port)
        self._page: SettingsPage | None = None
        self._next_ns = 0
        self._thread: threading.Thread | None = None

    def poll(self, now_ns: int) -> SettingsPage | None:
        """Return the page, None until it is received."""
        busy = self._thread is not None and self._thread.is_alive()
        if self._page is None and not busy and now_ns >= self._next_ns:
            self._next_ns = now_ns + round(FETCH_AGAIN_S * NS_PER_S)
            self._thread = threading.Thread(target=self._fetch, daemon=True)
            self._thread.start()
        return self._page

    def clear(self) -> None:
        """Drop the page and fetch it again: the sensor may have been replaced."""
        self._page, self.fault = None, "not read yet"

    def _fetch(self) -> None:
        host, port = self._where
        connection = http.client.HTTPConnection(host, port, timeout=TIMEOUT_S)
        try:
            connection.request("GET", PATH)
            answer = connection.getresponse()
            text = answer.read(MOST_PAGE_BYTES).decode("utf-8", errors="replace")
            if answer.status == http.client.OK:
                self._page = parse(text)
            else:
                self._failed(f"HTTP {answer.status} {answer.reason}")
        except (OSError, http.client.HTTPException, DataError) as error:
            self._failed(str(error))
        finally:
            connection.close()

    def _failed(self, why: str) -> None:
        host, port = self._where
        self.fault = f"http://{host}:{port}{PATH}: {why}"
