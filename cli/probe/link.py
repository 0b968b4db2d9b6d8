"""Link to controller/fmprobe.as: one-line commands, replies of lines `name value`.

A command is a word and up to four numbers; the reply ends with the line `done WORD`. The program
accepts one connection; each loss of it is a test, so the link opens it again.
"""

import socket
import struct
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Protocol

from cli.probe.readings import ProbeReadings
from forcemesh.errors import ForcemeshError

RECEIVE_BYTES = 16_384
SOCKET_BUFFER_BYTES = 4096  # of the socket: a PC that does not read fills it soon
LINK_WITHIN_S = 12.0  # the program closes, ends and starts again
ATTEMPT_S, PAUSE_S = 2.0, 0.2
REPLY_WITHIN_S = 5.0
PROBE_REMEDY = "is fmprobe.as loaded and started (`EXECUTE fp.main`), with the port of fp.config?"


class ProbeError(ForcemeshError):
    """Error: the probe program cannot be reached, or does not reply as it should."""


class Wire(Protocol):
    """One TCP connection and its clock."""

    def now_s(self) -> float:
        """Return the time [s]."""

    def wait(self, duration_s: float) -> None:
        """Let time pass without reading."""

    def send(self, data: bytes) -> None:
        """Send bytes. Raises OSError."""

    def receive(self, timeout_s: float) -> bytes:
        """Return received bytes, none after the time-out. Raises OSError at the end."""

    def close(self) -> None:
        """Close the connection: FIN."""

    def reset(self) -> None:
        """Abort the connection: RST."""


class SocketWire:
    """TCP connection to a controller, IPv4 only, as the controller's."""

    def __init__(self, host: str, port: int) -> None:
        """Connect. Raises OSError."""
        sock = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, SOCKET_BUFFER_BYTES)
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            sock.settimeout(ATTEMPT_S)
            sock.connect((host, port))
            if sock.getsockname() == sock.getpeername():  # TCP self-connect: there is no listener
                raise ConnectionRefusedError(f"nothing listens on port {port}")
        except OSError:
            sock.close()
            raise
        self._socket = sock

    def now_s(self) -> float:
        """Return the monotonic time [s]."""
        return time.monotonic()

    def wait(self, duration_s: float) -> None:
        """Sleep."""
        time.sleep(duration_s)

    def send(self, data: bytes) -> None:
        """Send bytes."""
        self._socket.sendall(data)

    def receive(self, timeout_s: float) -> bytes:
        """Return received bytes, none after the time-out. Raises OSError at the end."""
        self._socket.settimeout(max(timeout_s, 1e-3))
        try:
            data = self._socket.recv(RECEIVE_BYTES)
        except TimeoutError:
            return b""
        if not data:
            raise ConnectionError("closed by the controller")
        return data

    def close(self) -> None:
        """Close the connection: FIN."""
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()

    def reset(self) -> None:
        """Abort the connection: RST."""
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        self._socket.close()


class ProbeLink:
    """Dialogue with the probe program."""

    def __init__(
        self,
        dial: Callable[[], Wire],
        place: str,
        wait: Callable[[float], None],
        now_s: Callable[[], float],
    ) -> None:
        """Connect to the program.

        Args:
            dial: Opens a connection. Raises OSError.
            place: Its address, for messages.
            wait: Lets time pass between attempts to connect [s].
            now_s: Clock that limits these attempts [s].

        Raises:
            ProbeError: Nothing accepts the connection.
        """
        self._dial, self._place, self._wait, self._now_s = dial, place, wait, now_s
        self.reopen()

    def reopen(self) -> None:
        """Connect until the program replies: it may be closing its port to open it again.

        Raises:
            ProbeError: It does not reply in LINK_WITHIN_S.
        """
        reason: Exception | str = ""
        end_s = self._now_s() + LINK_WITHIN_S
        while self._now_s() < end_s:
            try:
                self._rest, self.wire = b"", self._dial()
                self.command("echo", ATTEMPT_S)
            except OSError as error:
                reason = f"{self._place}: no connection: {_reason(error)}; {PROBE_REMEDY}"
            except ProbeError as error:
                self.wire.close()
                reason = error
            else:
                return
            self._wait(PAUSE_S)
        raise ProbeError(str(reason))

    def send(self, data: bytes) -> None:
        """Send bytes of a command. Raises ProbeError."""
        try:
            self.wire.send(data)
        except OSError as error:
            raise ProbeError(f"{self._place}: the connection broke: {_reason(error)}") from error

    def command(
        self, text: str, within_s: float = REPLY_WITHIN_S, *, rest: str = ""
    ) -> ProbeReadings:
        """Send a command and return its reply.

        Args:
            text: The command.
            within_s: Time for the whole reply.
            rest: The part of it that has not been sent; without it, all of it.

        Raises:
            ProbeError: The connection broke, or the reply did not end in time.
        """
        self.send(f"{rest or text}\n".encode("ascii"))
        try:
            return ProbeReadings.of(self._lines(text.split(maxsplit=1)[0], within_s))
        except OSError as error:
            broke = f"the connection broke: {_reason(error)}"
            raise ProbeError(f"{self._place}: `{text}`: {broke}") from error

    def _lines(self, word: str, within_s: float) -> list[str]:
        """Return the lines up to `done WORD`. Raises OSError, and ProbeError without that line."""
        found: list[str] = []
        end_s = self.wire.now_s() + within_s
        while (left_s := end_s - self.wire.now_s()) > 0.0:
            self._rest += self.wire.receive(left_s)
            *whole, self._rest = self._rest.split(b"\n")
            for line in whole:
                found.append(line.decode("ascii", "replace").strip())
                if found[-1] == f"done {word}":
                    return found[:-1]
                if found[-1].startswith("done "):
                    found.clear()  # of a command that was given up
        got = f"{len(found)} lines" if found else "nothing"
        raise ProbeError(
            f"{self._place}: `{word}`: {got} and no `done {word}` in {within_s:g} s; {PROBE_REMEDY}"
        )

    def close(self) -> None:
        """Close the connection."""
        self.wire.close()


def _reason(error: OSError) -> str:
    return error.strerror or str(error)
