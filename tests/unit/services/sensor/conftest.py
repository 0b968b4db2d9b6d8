"""A sensor on a real UDP socket, and a driver that reads it."""

from collections.abc import Iterator

import pytest

from tests.fakes.rdt_sensor import FakeSensor, Rig


@pytest.fixture
def sensor() -> Iterator[FakeSensor]:
    """Yield a sensor without a client."""
    with FakeSensor() as fake:
        yield fake


@pytest.fixture
def rig(sensor: FakeSensor) -> Iterator[Rig]:
    """Yield a driver that has requested the sensor's stream."""
    with Rig(sensor) as rig:
        rig.start()
        yield rig
