"""A sensor on a real UDP socket, and the driver that reads it, on a clock of the tests."""

import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

from common.config.load import load_cell
from common.runtime.service import Runner
from forcemesh.bus import Bus
from forcemesh.clock import ManualClock
from forcemesh.codec import decode
from forcemesh.messages import SensorWrench
from forcemesh.topics import Qos
from services.sensor.rdt import RECORD, RdtCommand, request
from services.sensor.service import SensorDriver

ROOT = Path(__file__).resolve().parents[2]
REAL_CELL = ROOT / "cells" / "rs007l-real.yaml"
SENSOR_HZ = 500.0
PERIOD_S = 1.0 / SENSOR_HZ
PATIENCE_S = 5.0


class FakeSensor:
    """A sensor that streams to its last client; the test gives the data."""

    def __init__(self) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(PATIENCE_S)
        self.port: int = self.socket.getsockname()[1]
        self.client: tuple[str, int] | None = None
        self.place = 0
        self.ft = 1000

    def __enter__(self) -> "FakeSensor":
        return self

    def __exit__(self, *_: object) -> None:
        self.socket.close()

    def receive(self) -> bytes:
        """Wait for a request; a start request resets the numbers."""
        data, address = self.socket.recvfrom(64)
        if data == request(RdtCommand.START):
            self.client, self.place = address, 0
        return data

    def send(self, data: bytes) -> None:
        """Send a datagram; loopback has delivered it when this returns."""
        assert self.client is not None
        self.socket.sendto(data, self.client)

    def record(
        self, *, force_N: float = 3.0, status: int = 0, stalled: bool = False, frozen: bool = False
    ) -> bytes:
        """Return the next record: force along z, a torque about x, some noise elsewhere."""
        self.place += 1
        self.ft += 0 if stalled else 14
        noise = 0 if frozen else self.place % 50
        counts = (noise, -noise, round(force_N * 1e6), -500_000, noise, 0)
        return RECORD.pack(self.place, self.ft, status, *counts)


class Recorder:
    """A transport that keeps every message and not only the newest."""

    def __init__(self) -> None:
        self.messages: list[SensorWrench] = []
        self.stamps: list[int] = []

    def publish(self, key: str, qos: Qos) -> Callable[[bytes], None]:
        """Keep every message."""
        assert (key, qos) == ("rs007l/sensor/wrench", "stream")

        def put(data: bytes) -> None:
            header, message = decode(data, SensorWrench)
            self.messages.append(message)
            self.stamps.append(header.stamp_ns)

        return put

    def __getattr__(self, name: str) -> Any:
        raise AssertionError(f"the driver uses {name} of the bus")


class Rig:
    """A driver of the template cell, the sensor that it reads, and a clock."""

    def __init__(self, sensor: FakeSensor, **overrides: Any) -> None:
        where = {"sensor.address": "127.0.0.1", "sensor.port": sensor.port}
        cell = load_cell(REAL_CELL, where | overrides)
        self.sensor = sensor
        self.clock = ManualClock()
        self.published = Recorder()
        self.driver = SensorDriver(Bus("sensor", cell.cell, self.published, cell, self.clock), cell)
        self.runner = Runner(self.driver, [], self.clock)

    def __enter__(self) -> "Rig":
        return self

    def __exit__(self, *_: object) -> None:
        self.driver.close()

    def advance(self, duration_s: float) -> list[SensorWrench]:
        """Advance in steps of a tenth of a sensor's period; return the published messages."""
        before = len(self.published.messages)
        for _ in range(round(duration_s / PERIOD_S * 10)):
            self.clock.sleep_s(PERIOD_S / 10)
            self.runner.step(self.clock.now_ns())
        return self.published.messages[before:]

    def start(self) -> None:
        """Let the driver send its request, and the sensor receive it."""
        self.advance(PERIOD_S)
        assert self.sensor.receive() == request(RdtCommand.START)

    def stream(self, duration_s: float, **how: Any) -> list[SensorWrench]:
        """Send a record each period; return the driver's messages."""
        before = len(self.published.messages)
        for _ in range(round(duration_s / PERIOD_S)):
            self.sensor.send(self.sensor.record(**how))
            self.advance(PERIOD_S)
        return self.published.messages[before:]

    def send(self, *datagrams: bytes) -> list[SensorWrench]:
        """Send several datagrams at once; return the driver's messages."""
        for data in datagrams:
            self.sensor.send(data)
        return self.advance(PERIOD_S)

    @property
    def counters(self) -> dict[str, int]:
        """Counters of the driver."""
        return self.driver.counters()


def assert_no_numbers(messages: list[SensorWrench], reason: str) -> None:
    """Assert that every message is invalid, has a reason, and carries no reading."""
    assert messages
    for message in messages:
        assert not message.valid
        assert message.status == "fault"
        assert reason in message.reason, message.reason
        assert message.force_N == message.torque_Nm == (0.0, 0.0, 0.0)


def is_at_rate(messages: list[SensorWrench], duration_s: float) -> bool:
    """Return whether there is about one message for each period of the sensor."""
    return abs(len(messages) - duration_s * SENSOR_HZ) <= 2
