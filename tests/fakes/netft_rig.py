"""Driver and simulated Net F/T in one process, on a virtual clock: all the logic, no sockets."""

from collections import deque
from collections.abc import Callable, Mapping
from itertools import count
from typing import Any

import numpy as np

from common.config.load import load_cell
from forcemesh import topics
from forcemesh.clock import NS_PER_S
from forcemesh.codec import decode
from forcemesh.messages import SensorWrench
from services.sensor.link import PageFetch, UdpLink
from services.sensor.netft_page import SettingsPage, parse
from services.sensor.rdt_driver import RdtDriver
from services.sensor.service import SensorDriver
from sim.netft.protocol import About, page
from sim.netft.sensor import NetftSensor
from tests.fakes.bench import Bench
from tools.tree import ROOT

REAL_CELL = ROOT / "cells" / "rs007l-real.yaml"
RATE_HZ = 1000
PERIOD_S = 1.0 / RATE_HZ
STALE_S = 0.02
TRUTH = np.array([1.0, -2.0, 12.5, 0.1, -0.2, 0.3])
NAMES = count(1)
FITTING = About(force_range_N=200.0, torque_range_Nm=8.0)  # to the cell of the template


class LoopLink(UdpLink):
    """The driver's link, and its socket, which is connected to one sensor only."""

    def __init__(self, sensor: NetftSensor) -> None:
        super().__init__("simulated", 49152, ask_after_s=STALE_S / 2)
        self.sensor = sensor
        self.name, self.inbox = "", deque[bytes]()

    def _open(self, now_ns: int) -> None:
        self._emptied_ns = now_ns
        self.name, self.inbox = f"client {next(NAMES)}", deque()
        self._socket: Any = self

    def recv(self, _size: int) -> bytes:
        """Return the oldest datagram."""
        if not self.inbox:
            raise BlockingIOError
        return self.inbox.popleft()

    def send(self, data: bytes) -> None:
        """Pass a request to the sensor."""
        self.sensor.receive(data, self.name)

    def _drop(self) -> None:
        self._socket, self.name = None, ""

    def deliver(self, data: bytes, client: str) -> None:
        """Deliver a datagram, if it is addressed to this client."""
        if self.name == client:
            self.inbox.append(data)


class LoopPage(PageFetch):
    """The sensor's page, there at once or never."""

    def __init__(self, about: About, fault: str = "") -> None:
        super().__init__("simulated", 80)
        self.fault, self.about = fault, about
        self.silent_ns = 0  # age of the newest page, while it is not read again

    def poll(self, now_ns: int) -> SettingsPage | None:
        """Return the page, unless it cannot be read."""
        self.verified_ns = now_ns - self.silent_ns
        return None if self.fault and not self.silent_ns else parse(page(self.about))

    def clear(self) -> None:
        """Read the page again at the next poll."""


class NetftRig(Bench):
    """Sensor, driver and service; `about` describes the sensor, the cell file the configuration."""

    def __init__(
        self,
        about: About = FITTING,
        *,
        page_fault: str = "",
        cell: Mapping[str, object] | None = None,
    ) -> None:
        loaded = load_cell(REAL_CELL, {"rates.sensor_hz": RATE_HZ, **(cell or {})})
        self.sensor = NetftSensor(about, seed=1)
        self.link = LoopLink(self.sensor)
        reads_page = loaded.sensor.calibration != "cell"
        self.page = LoopPage(about, page_fault) if reads_page else None
        self.driver = RdtDriver(loaded.sensor, self.link, self.page, stale_after_s=STALE_S)
        super().__init__(
            "sensor", lambda bus, cell: SensorDriver(bus, cell, self.driver), loaded, PERIOD_S
        )
        self.published: list[SensorWrench] = []
        self.in_transit: Callable[[bytes], list[bytes]] = lambda data: [data]
        self.before_step = self._measure
        self._tap = self.client.tap(topics.SENSOR_WRENCH, 10_000)
        self._rng = np.random.default_rng(2)

    def _measure(self) -> None:
        noise = 1e-3 * self._rng.standard_normal(6)
        for data, client in self.sensor.measure((TRUTH + noise).tolist()):
            for arrived in self.in_transit(data):
                self.link.deliver(arrived, client)

    def run(self, duration_s: float = 0.0) -> list[SensorWrench]:
        """Let the sensor measure and the driver read; return the messages that were not read."""
        before = len(self.published)
        self.pass_s(duration_s)
        while (data := self._tap.take()) is not None:
            self.published.append(decode(data, SensorWrench)[1])
        return self.published[before:]

    def switch(self, **switches: Any) -> None:
        """Set switches of the sensor; `restart` is one too."""
        if switches.pop("restart", False):
            self.sensor.restart()
        words = {name: str(value) for name, value in switches.items()}
        self.sensor.switches = self.sensor.switches.changed(words)

    def first_code(self) -> str:
        """Return the code of the next invalid message."""
        give_up_ns = self.clock.now_ns() + 2 * NS_PER_S
        while self.clock.now_ns() < give_up_ns:
            for message in self.run(0.01):
                if not message.valid:
                    return message.code
        return "all is valid"

    @property
    def counters(self) -> dict[str, int]:
        """Counters of the service."""
        assert isinstance(self.service, SensorDriver)
        return self.service.counters()
