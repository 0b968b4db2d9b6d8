"""Reading at rest: stillness of pose and reading, each sample once, repetition after a fault."""

from typing import Any

import numpy as np
import pytest

from cli.calibration.gather import STILL_WITHIN_S, Gatherer
from common.bus.configured_cell import ConfiguredCell
from common.bus.memory_bus import MemoryTransport
from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.clock import NS_PER_S, ManualClock
from forcemesh.messages import RobotState, SensorWrench, WrenchAtTcp
from identification.errors import CalibrationError
from tests.fakes.calibration import demo_cell

CELL = demo_cell()
NOISE_N = 0.1


class PublishingClock(ManualClock):
    """A clock whose sleep publishes: the sensor every 2 ms, the robot every 4 ms."""

    def __init__(self) -> None:
        """Start at rest, with 10 N on the sensor."""
        super().__init__()
        self.transport = MemoryTransport()
        self._made = {
            topic.key: Bus(topic.writer, CELL.cell, self.transport, CELL, self).publisher(topic)
            for topic in (topics.SENSOR_WRENCH, topics.ROBOT_STATE, topics.WRENCH)
        }
        self._rng = np.random.default_rng(0)
        self.force_N: Any = lambda t_s: 10.0
        self.x_m: Any = lambda t_s: 0.4
        self.fault: Any = lambda t_s: ""
        self.published_N: list[float] = []  # z force of every good reading

    @property
    def t_s(self) -> float:
        """Return the time since the start [s]."""
        return (self.now_ns() - NS_PER_S) / NS_PER_S

    def sleep_s(self, duration_s: float) -> None:
        """Advance by whole milliseconds, and publish the messages that are due."""
        for _ in range(max(1, round(1e3 * duration_s))):
            self.advance_ns(1_000_000)
            tick = self.now_ns() // 1_000_000
            if tick % 4 == 0:
                state = RobotState(position_m=(self.x_m(self.t_s), 0.0, 0.3))
                self._made["robot/state"].put(state)
                self._made["wrench"].put(WrenchAtTcp(force_N=(0.3, 0.0, 0.0), calibration="abc"))
            if tick % 2 == 0:
                self._publish_reading()

    def _publish_reading(self) -> None:
        fault = self.fault(self.t_s)
        if fault:
            message = SensorWrench(valid=False, reason=fault, code="sensor_fault", status="fault")
        else:
            z_N = self.force_N(self.t_s) + NOISE_N * float(self._rng.normal())
            self.published_N.append(z_N)
            message = SensorWrench(force_N=(0.0, 0.0, z_N), serial="FT1234")
        self._made["sensor/wrench"].put(message)


def client_of(clock: PublishingClock) -> ConfiguredCell:
    """Return a client of that cell."""
    bus = Bus(topics.CLIENT, CELL.cell, clock.transport, CELL, clock)
    return ConfiguredCell(CELL, bus=bus)


@pytest.fixture
def clock() -> PublishingClock:
    """A clock on which sensor and robot publish."""
    return PublishingClock()


@pytest.fixture
def gatherer(clock) -> Gatherer:
    """A client of that cell that has received messages."""
    found = Gatherer(client_of(clock))
    found.until_received()
    return found


def no_watch(_what: str) -> None:
    """Ignore the progress."""


def test_a_dwell_holds_each_good_reading_once(clock, gatherer):
    """Each row is one published reading, with its exact numbers, none twice."""
    dwell = gatherer.dwell("fit", 0.5, no_watch)
    assert len(dwell) == 250
    published_N = clock.published_N[-len(dwell) - 1 :]
    assert set(np.round(dwell.force_N[:, 2], 12)) <= set(np.round(published_N, 12))
    assert (np.diff(dwell.time_s) > 0.0).all()
    assert dwell.time_s[-1] - dwell.time_s[0] == pytest.approx(0.498)
    assert gatherer.serial == "FT1234"
    T_sensor = CELL.sensor.T_flange_sensor.pose
    assert dwell.attitude == pytest.approx(np.array(T_sensor.rotation))
    assert dwell.position_m[0] == pytest.approx([0.4, 0.0, 0.32])


def test_the_residual_of_the_cell_is_about_the_sensor(gatherer):
    """A force of 0.3 N at the TCP, 140 mm away, is 42 mN m about the sensor's origin."""
    dwell = gatherer.dwell("verify", 0.3, no_watch)
    assert dwell.residual_N == pytest.approx([0.3, 0.0, 0.0])
    assert np.linalg.norm(dwell.residual_Nm) == pytest.approx(0.3 * 0.14)
    assert gatherer.active_calibration == "abc"


def test_a_dwell_begins_when_arm_and_force_are_still(clock, gatherer):
    """The dwell begins after the end of the motion and the settling of the force."""
    clock.x_m = lambda t_s: 0.4 + 0.05 * max(0.0, 1.0 - t_s)
    clock.force_N = lambda t_s: 10.0 + 5.0 * np.exp(-max(0.0, t_s - 1.0) / 0.3)
    waits: list[str] = []
    dwell = gatherer.dwell("fit", 0.3, waits.append)
    assert dwell.time_s[0] > 1.4
    assert dwell.force_N[:, 2].mean() == pytest.approx(10.0, abs=0.5)
    assert any("the arm to rest" in text for text in waits)
    assert any("a steady force" in text for text in waits)
    assert waits[-1] == "reading"
    began_s = clock.t_s
    clock.x_m = lambda t_s: 0.4 + 0.8 * t_s
    with pytest.raises(CalibrationError, match="still waiting for the arm to rest"):
        gatherer.dwell("fit", 0.3, no_watch)
    assert clock.t_s - began_s == pytest.approx(STILL_WITHIN_S, abs=0.2)


def test_a_fault_while_reading_is_read_again(clock, gatherer):
    """After a short fault the whole dwell is repeated, once; the error has the sensor's reason."""
    clock.fault = lambda t_s: "a spike" if 0.6 <= t_s < 0.65 else ""
    dwell = gatherer.dwell("fit", 0.3, no_watch)
    assert dwell.time_s[0] > 0.65
    assert len(dwell) == 150
    clock.fault = lambda t_s: "a loose plug" if t_s % 0.5 > 0.45 else ""
    with pytest.raises(CalibrationError, match=r"failed twice: .*a loose plug"):
        gatherer.dwell("fit", 1.0, no_watch)
