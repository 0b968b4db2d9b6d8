"""Bus client of the panel: connected only while a page is open."""

import math
import socket
import threading
from dataclasses import dataclass, field
from typing import Any

from common.bus.configured_cell import ConfiguredCell
from common.config.cell import CellConfig as CellFile
from forcemesh import topics
from forcemesh.bus import Reading
from forcemesh.clock import NS_PER_S, Clock, MonotonicClock
from forcemesh.errors import BusError
from forcemesh.messages import (
    ArbiterStatus,
    ContactEvent,
    Health,
    RegulatorTarget,
    RobotCommand,
    RobotState,
    SensorWrench,
    WrenchAtTcp,
)

PANEL_CLIENT = f"panel at {socket.gethostname()}"  # also after a reconnection or a restart
RECONNECT_S = 1.0  # between two attempts to reach the hub


NO_READING: Reading[Any] = Reading(None, None, math.inf, "missing", silent=True, code="missing")


@dataclass(frozen=True, slots=True)
class Snapshot:
    """Newest message of every topic, evaluated at one time."""

    now_ns: int = 0
    hub_fault: str = "not connected: no page was open"
    robot: Reading[RobotState] = NO_READING
    wrench: Reading[WrenchAtTcp] = NO_READING
    sensor: Reading[SensorWrench] = NO_READING
    target: Reading[RegulatorTarget] = NO_READING
    command: Reading[RobotCommand] = NO_READING
    arbiter: Reading[ArbiterStatus] = NO_READING
    contact: Reading[ContactEvent] = NO_READING
    health: dict[str, Reading[Health] | Reading[SensorWrench]] = field(default_factory=dict)


class CellMonitor:
    """Client of the cell; one thread joins and leaves, every thread may read."""

    def __init__(self, cell: CellFile, clock: Clock | None = None) -> None:
        """Prepare; no session is opened."""
        self.cell = cell
        self.clock = clock or MonotonicClock()
        self._client: ConfiguredCell | None = None
        self._lock = threading.Lock()
        self._joined = threading.Event()
        self._try_at_ns = 0
        self._fault = Snapshot().hub_fault

    def join(self) -> None:
        """Join the bus unless joined; retry after AGAIN_S."""
        if self._client is None and self.clock.now_ns() >= self._try_at_ns:
            self._open()

    def wait(self, within_s: float) -> None:
        """Wait until the bus is joined, at most this long."""
        self._joined.wait(within_s)

    def leave(self) -> None:
        """Leave the bus."""
        with self._lock:
            client, self._client = self._client, None
            self._joined.clear()
        if client is not None:
            client.close()

    def snapshot(self) -> Snapshot:
        """Return the newest message of every topic."""
        now_ns, client = self.clock.now_ns(), self._client
        if client is None:
            return Snapshot(now_ns=now_ns, hub_fault=self._fault)
        return Snapshot(
            now_ns=now_ns,
            hub_fault="",
            robot=client.state.reading(),
            wrench=client.wrench.reading(),
            sensor=client.sensor.reading(),
            target=client.target.reading(),
            command=client.command.reading(),
            arbiter=client.status.reading(),
            contact=client.contact.feed.reading(),
            health={
                name: client.health(name).reading() for name in (*topics.ROLES, *topics.HELPERS)
            },
        )

    @property
    def client(self) -> ConfiguredCell:
        """Client for requests. Raises BusError when the cell is not reached."""
        client = self._client
        if client is None:
            raise BusError(self._fault)
        return client

    def _open(self) -> None:
        try:
            client = ConfiguredCell(
                self.cell, commander="operator", patience_s=0.0, client=PANEL_CLIENT
            )
        except BusError as error:
            self._fault = str(error)
            self._try_at_ns = self.clock.now_ns() + round(RECONNECT_S * NS_PER_S)
            return
        with self._lock:
            self._client = client
            self._joined.set()


def age_text(reading: Reading[Any]) -> str:
    """Return the age of a message as short text."""
    if reading.message is None:
        return "no message"
    age_ms = 1e3 * reading.age_s
    return f"{age_ms:.0f} ms" if age_ms < 1000 else f"{reading.age_s:.1f} s"
