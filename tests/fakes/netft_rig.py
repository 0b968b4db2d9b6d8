"""Driver and simulated Net F/T in one process, on a virtual clock: all the logic, no sockets."""

from collections import deque
from collections.abc import Callable, Mapping
from itertools import count
from typing import Any

import numpy as np

from common.config.load import load_cell
from forcemesh.bus import Bus
from forcemesh.clock import NS_PER_S, ManualClock
from forcemesh.codec import decode
from forcemesh.messages import SensorWrench
from forcemesh.topics import Qos
from services.sensor.link import PageFetch, UdpLink
from services.sensor.netft_page import SettingsPage, parse
from services.sensor.rdt_driver import RdtDriver
from services.sensor.service import SensorDriver
from sim.netft.protocol import About, page
from sim.netft.sensor import NetftSensor
from tools.tree import ROOT

REAL_CELL = ROOT / "cells" / "rs007l-real.yaml"
RATE_HZ = 1000
PERIOD_S = 1.0 / RATE_HZ
STALE_S = 0.02
TRUTH = np.array([1.0, -2.0, 12.5, 0.1, -0.2, 0.3])
NAMES = count(1)
FITTING = About(force_range_N=200.0, torque_range_Nm=8.0)  # to the cell of the template


class LoopSocket:
    """A UDP socket that is connected to one sensor only."""

    def __init__(self, sensor: NetftSensor) -> None:
        self.name = f"client {next(NAMES)}"
        self.inbox: deque[bytes] = deque()
        self._sensor = sensor

    def recv(self, _size: int) -> bytes:
        """Return the oldest datagram."""
        if not self.inbox:
            raise BlockingIOError
        return self.inbox.popleft()

    def send(self, data: bytes) -> None:
        """Pass a request to the sensor."""
        self._sensor.receive(data, self.name)

    def close(self) -> None:
        """Close: receive no more."""
        self.name = ""


class LoopLink(UdpLink):
    """The driver's link on an in-memory socket."""

    def __init__(self, sensor: NetftSensor) -> None:
        super().__init__("simulated", 49152, ask_after_s=STALE_S / 2)
        self.sensor = sensor

    def _open(self, now_ns: int) -> None:
        self._emptied_ns = now_ns
        self._socket: Any = LoopSocket(self.sensor)

    def deliver(self, data: bytes, client: str) -> None:
        """Deliver a datagram, if it is addressed to this client."""
        if self._socket is not None and self._socket.name == client:
            self._socket.inbox.append(data)


class LoopPage(PageFetch):
    """The sensor's page, there at once or never."""

    def __init__(self, about: About, fault: str = "") -> None:
        super().__init__("simulated", 80)
        self.fault, self.about, self.fetches = fault, about, 0
        self.silent_ns = 0  # age of the newest page, while it is not read again

    def poll(self, now_ns: int) -> SettingsPage | None:
        """Return the page, unless it cannot be read."""
        self.verified_ns = now_ns - self.silent_ns
        return None if self.fault and not self.silent_ns else parse(page(self.about))

    def clear(self) -> None:
        """Count a new request of the page."""
        self.fetches += 1


class NetftRig:
    """Sensor, driver and service; `about` describes the sensor, the cell file the configuration."""

    def __init__(
        self,
        about: About = FITTING,
        *,
        page_fault: str = "",
        cell: Mapping[str, object] | None = None,
    ) -> None:
        self.cell = load_cell(REAL_CELL, {"rates.sensor_hz": RATE_HZ, **(cell or {})})
        self.sensor = NetftSensor(about, seed=1)
        self.link = LoopLink(self.sensor)
        section = self.cell.sensor
        reads_page = section.calibration != "cell"
        self.page = LoopPage(self.sensor.about, page_fault) if reads_page else None
        self.driver = RdtDriver(section, self.link, self.page, stale_after_s=STALE_S)
        self.clock = ManualClock()
        self.published: list[SensorWrench] = []
        bus = Bus("sensor", self.cell.cell, self, self.cell, self.clock)
        self.service = SensorDriver(bus, self.cell, self.driver)
        self.in_transit: Callable[[bytes], list[bytes]] = lambda data: [data]
        self._rng = np.random.default_rng(2)

    def publish(self, _key: str, _qos: Qos) -> Callable[[bytes], None]:
        """Keep every message."""
        return lambda data: self.published.append(decode(data, SensorWrench)[1])

    def __getattr__(self, name: str) -> Any:
        raise AttributeError(name)

    def run(self, duration_s: float) -> list[SensorWrench]:
        """Let the sensor measure and the driver read; return the published messages."""
        before = len(self.published)
        for _ in range(round(duration_s / PERIOD_S)):
            self.clock.sleep_s(PERIOD_S)
            noise = 1e-3 * self._rng.standard_normal(6)
            for data, client in self.sensor.measure((TRUTH + noise).tolist()):
                for arrived in self.in_transit(data):
                    self.link.deliver(arrived, client)
            self.service.step(self.clock.now_ns())
        return self.published[before:]

    def switch(self, **switches: Any) -> None:
        """Set switches of the sensor; `restart` is one too."""
        if switches.pop("restart", False):
            self.sensor.restart()
        words = {name: str(value) for name, value in switches.items()}
        self.sensor.switches = self.sensor.switches.changed(words)

    def first_code(self, longest_s: float = 2.0) -> str:
        """Return the code of the next invalid message."""
        give_up_ns = self.clock.now_ns() + round(longest_s * NS_PER_S)
        while self.clock.now_ns() < give_up_ns:
            for message in self.run(0.01):
                if not message.valid:
                    return message.code
        return "all is valid"

    @property
    def counters(self) -> dict[str, int]:
        """Counters of the service."""
        return self.service.counters()
