"""One service on an in-memory bus and a virtual clock; the test plays every other role."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from common.bus.memory_bus import MemoryTransport
from common.config.cell import CellConfig
from common.config.load import load_cell
from common.runtime.service import Service
from forcemesh.bus import Bus, Origin, Publisher, Reader
from forcemesh.clock import ManualClock
from forcemesh.messages import Message
from forcemesh.records import Record
from forcemesh.requests import Reply
from forcemesh.topics import CLIENT, Request, Topic

DEMO = Path(__file__).resolve().parents[2] / "cells" / "demo.yaml"
CELL = load_cell(DEMO)
# At half the demo's rates a virtual cell takes two thirds of the time: for tests that do not
# depend on the rates. A lab need not have a sensor of 500 Hz either.
HALF_RATES = {"robot_hz": 125, "sensor_hz": 250, "control_hz": 125}
HALF_CELL = load_cell(DEMO, {"rates": HALF_RATES})


def cell_with(**changes: Any) -> CellConfig:
    """Return the demo's cell with other values, `section__name`."""
    return load_cell(DEMO, {name.replace("__", "."): value for name, value in changes.items()})


class Bench:
    """A service, stepped by hand."""

    def __init__(
        self,
        role: str,
        make: Callable[[Bus, CellConfig], Service],
        cell: CellConfig = CELL,
        step_s: float = 0.004,
    ) -> None:
        """Start the service at a virtual time, before any message."""
        self.cell = cell
        self.clock = ManualClock()
        self.transport = MemoryTransport()
        self.transport.advance = self._live
        self.step_s = step_s
        self.before_step: Callable[[], None] = lambda: None
        self._publishers: dict[str, Publisher[Any]] = {}
        self._readers: dict[str, Reader[Any]] = {}
        self.client = self._bus(CLIENT)
        self.service = make(self._bus(role), cell)

    def _bus(self, role: str) -> Bus:
        return Bus(role, self.cell.cell, self.transport, self.cell, self.clock)

    def put(self, topic: Topic[Any], message: Message, origin: Origin | None = None) -> None:
        """Publish a message as the role that writes its topic."""
        if topic.key not in self._publishers:
            self.replace_writer(topic)
        self._publishers[topic.key].put(message, origin)

    def replace_writer(self, topic: Topic[Any]) -> None:
        """Continue as another process of the role that writes a topic."""
        self._publishers[topic.key] = self._bus(topic.writer).publisher(topic)

    def watch(self, topic: Topic[Any]) -> Reader[Any]:
        """Return a client's reader of a topic, the same one each time."""
        if topic.key not in self._readers:
            self._readers[topic.key] = self.client.reader(topic)
        return self._readers[topic.key]

    def step(self, times: int = 1) -> None:
        """Advance by periods: first the other roles publish, then the service steps."""
        for _ in range(times):
            self.clock.sleep_s(self.step_s)
            self.before_step()
            self.service.step(self.clock.now_ns())

    def pass_s(self, duration_s: float) -> None:
        """Advance by a time."""
        self.step(round(duration_s / self.step_s))

    def newest(self, topic: Topic[Any]) -> Any:
        """Return the newest message of a topic; the first call only subscribes."""
        return self.watch(topic).read(self.clock.now_ns()).message

    def after_step(self, topic: Topic[Any]) -> Any:
        """Step once; return the service's message of that step on a topic."""
        self.watch(topic)
        self.step()
        return self.newest(topic)

    def ask(self, request: Request[Any], message: Record) -> Reply:
        """Send a request as a client and return the reply."""
        return self.client.ask(request, message)

    def _live(self, timeout_s: float, answered: Callable[[], bool]) -> None:
        for _ in range(round(timeout_s / self.step_s)):
            if answered():
                return
            self.step()
