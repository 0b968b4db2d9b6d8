"""Sockets of the simulated sensor: RDT on UDP, settings page and fault switches on HTTP.

curl http://127.0.0.1:8081/netftapi2.xml
curl http://127.0.0.1:8081/faults                        shows the switches
curl http://127.0.0.1:8081/faults -d 'loss=0.2&stall=on'  sets some
curl http://127.0.0.1:8081/faults -d restart=on
"""

import socket
import threading
from collections.abc import Sequence
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import parse_qsl

from forcemesh.errors import SimulationError
from sim.netft.protocol import page
from sim.netft.sensor import EVENT, NetftSensor

PAGE, FAULTS = "/netftapi2.xml", "/faults"
MOST_REQUESTS = 100  # per poll: a flood cannot block the loop
LONGEST_BODY = 2000
TRUE = ("on", "1", "true", "yes")


class NetftServer:
    """Sockets of a sensor. Call `poll` and `measured` from one thread; HTTP has its own."""

    def __init__(
        self, sensor: NetftSensor, *, address: str = "127.0.0.1", port: int = 0, page_port: int = 0
    ) -> None:
        """Open the sockets; port 0 selects a free one.

        Raises:
            SimulationError: A port is in use.
        """
        self.sensor = sensor
        self.sent = 0
        self.unsendable = 0
        self._restarts = threading.Event()
        self._udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._udp.settimeout(0.0)
        try:
            self._udp.bind((address, port))
            self._http = _PageServer((address, page_port), self)
        except OSError as error:
            self._udp.close()
            ports = f"UDP {port} and TCP {page_port}"
            raise SimulationError(f"cannot open {ports} at {address}: {error.strerror}") from error
        self.port: int = self._udp.getsockname()[1]
        self.page_port: int = self._http.server_address[1]
        thread = threading.Thread(target=self._http.serve_forever, args=(0.05,), daemon=True)
        thread.start()

    def close(self) -> None:
        """Close every socket."""
        self._http.shutdown()
        self._http.server_close()
        self._udp.close()

    def restart(self) -> None:
        """Schedule a power cycle of the sensor for the next poll."""
        self._restarts.set()

    def poll(self) -> None:
        """Process pending requests of clients, and a requested restart."""
        if self._restarts.is_set():
            self._restarts.clear()
            self.sensor.restart()
        for _ in range(MOST_REQUESTS):
            try:
                data, client = self._udp.recvfrom(64)
            except BlockingIOError:
                return
            except OSError:  # ICMP error of an earlier record: its client is gone
                continue
            self.sensor.receive(data, client)

    def measured(self, wrench: Sequence[float]) -> None:
        """Take a sample of a wrench [N, N m] and send its records."""
        for data, client in self.sensor.measure(wrench):
            try:
                self._udp.sendto(data, client)
                self.sent += 1
            except OSError:
                self.unsendable += 1


class _PageServer(ThreadingHTTPServer):
    request_queue_size = 16

    def __init__(self, where: tuple[str, int], owner: NetftServer) -> None:
        self.owner = owner
        super().__init__(where, _Handler)


class _Handler(BaseHTTPRequestHandler):
    server: _PageServer

    def do_GET(self) -> None:
        """Respond with the page or the switches."""
        sensor = self.server.owner.sensor
        if self.path == PAGE:
            self._answer(HTTPStatus.OK, page(sensor.about, sensor.switches.status), "text/xml")
        elif self.path == FAULTS:
            self._answer(HTTPStatus.OK, sensor.switches.model_dump_json(), "application/json")
        else:
            self._answer(HTTPStatus.NOT_FOUND, f"not found; use {PAGE} or {FAULTS}", "text/plain")

    def do_POST(self) -> None:
        """Set switches by name."""
        owner = self.server.owner
        length = min(int(self.headers.get("Content-Length") or 0), LONGEST_BODY)
        words = dict(parse_qsl(self.rfile.read(length).decode(errors="replace")))
        if self.path != FAULTS:
            self._answer(HTTPStatus.NOT_FOUND, f"switches are set at {FAULTS}", "text/plain")
            return
        if words.pop(EVENT, "off").lower() in TRUE:
            owner.restart()
        try:
            owner.sensor.switches = owner.sensor.switches.changed(words)
        except ValueError as error:
            self._answer(HTTPStatus.BAD_REQUEST, str(error), "text/plain")
            return
        self.do_GET()

    def log_message(self, *_: object) -> None:
        """Suppress the request log."""

    def _answer(self, status: HTTPStatus, text: str, kind: str) -> None:
        data = text.encode()
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)
