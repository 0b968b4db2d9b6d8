"""A sensor on a real UDP socket, and a driver that reads it."""

from collections.abc import Iterator

import pytest

from tests.fakes.rdt_sensor import FakeSensor, Rig


@pytest.fixture
def sensor() -> Iterator[FakeSensor]:
    """A sensor that nobody has asked yet."""
    with FakeSensor() as fake:
        yield fake


@pytest.fixture
def rig(sensor: FakeSensor) -> Iterator[Rig]:
    """A driver that has asked the sensor for its stream."""
    with Rig(sensor) as rig:
        rig.start()
        yield rig
