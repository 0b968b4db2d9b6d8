"""The Robotiq FT 300: bytes and frames, and the driver on a line in memory."""

import os
import pty
import random
import struct
import sys
import time
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.config.cell_sensor import SensorSection
from common.config.load import load_cell
from forcemesh.clock import NS_PER_S
from forcemesh.errors import ConfigError
from forcemesh.messages import Vec3
from services.sensor.driver import SensorSample
from services.sensor.robotiq import (
    FRAME_BYTES,
    HEAD,
    Framer,
    RobotiqDriver,
    crc16,
    robotiq_driver,
    start,
)
from tests.fakes.netft_rig import REAL_CELL

STALE_S = 0.03
PERIOD_NS = 10_000_000

force = st.floats(-300.0, 300.0).map(lambda value: round(value, 2))
torque = st.floats(-30.0, 30.0).map(lambda value: round(value, 3))
readings = st.tuples(st.tuples(force, force, force), st.tuples(torque, torque, torque))


def frame(force_N: Vec3, torque_Nm: Vec3) -> bytes:
    """Return the bytes of a frame as the sensor sends it."""
    numbers = [round(100.0 * f) for f in force_N] + [round(1000.0 * t) for t in torque_Nm]
    data = HEAD + struct.pack("<6h", *numbers)
    return data + crc16(data)


# --- bytes ----------------------------------------------------------------------------------------


def test_the_request_is_the_one_of_the_manual() -> None:
    """The request is slave 9, write multiple registers, 410, 0x0200, and the CRC of the manual."""
    assert start() == bytes.fromhex("09 10 01 9A 00 01 02 02 00 CD CA")


@given(st.lists(readings, min_size=1, max_size=8), st.integers(0, 2**32))
def test_frames_are_found_however_the_bytes_are_cut(sent: list[Any], seed: int) -> None:
    """Pieces of any size; hundredths of a newton and thousandths of a newton metre, signed."""
    rng, data, framer = random.Random(seed), b"".join(frame(*each) for each in sent), Framer()
    found = []
    while data:
        size = rng.randint(1, 20)
        found += framer.feed(data[:size])
        data = data[size:]
    assert [read.force_N for read in found] == [pytest.approx(each[0]) for each in sent]
    assert [read.torque_Nm for read in found] == [pytest.approx(each[1]) for each in sent]
    assert sum(read.skipped for read in found) == 0


@given(readings, st.integers(2, 15), st.integers(1, 255))
def test_a_corrupted_frame_is_no_reading(reading: Any, place: int, flip: int) -> None:
    """One wrong byte anywhere after the head: the CRC differs, and the next frame is found."""
    data = bytearray(frame(*reading))
    data[place] ^= flip
    good = frame((1.0, 2.0, 3.0), (0.1, 0.2, 0.3))
    found = Framer().feed(bytes(data) + good + good)
    assert all(read.force_N == (1.0, 2.0, 3.0) for read in found)
    assert len(found) == 2
    assert found[0].skipped == FRAME_BYTES


# --- the driver, on a line in memory --------------------------------------------------------------


class Line:
    """A serial line whose other end is the test."""

    def __init__(self) -> None:
        self.waiting, self.written, self.broken = b"", b"", False

    def read(self, _size: int) -> bytes:
        """Return the pending bytes."""
        if self.broken:
            raise OSError(5, "Input/output error")
        data, self.waiting = self.waiting, b""
        return data

    def write(self, data: bytes) -> int:
        """Keep the sent bytes."""
        self.written += data
        return len(data)

    def close(self) -> None:
        """Release nothing."""


def section(**changes: Any) -> SensorSection:
    """Return the section of a cell file for this sensor."""
    return load_cell(REAL_CELL, {f"sensor.{name}": value for name, value in changes.items()}).sensor


class RobotiqBench:
    """A driver, its line and a clock."""

    def __init__(self) -> None:
        self.line = Line()
        sensor = section(driver="robotiq", device="a line")
        self.driver = RobotiqDriver(sensor, lambda: self.line, stale_after_s=STALE_S)
        self.now_ns = NS_PER_S
        self.read()

    def read(self, data: bytes = b"", after_ns: int = PERIOD_NS) -> list[SensorSample]:
        """Deliver bytes; return the samples of the driver."""
        self.now_ns += after_ns
        self.line.waiting += data
        return list(self.driver.read(self.now_ns))


GOOD = frame((1.0, -2.0, 30.0), (0.1, -0.2, 0.3))


def test_the_stream_is_requested_and_its_frames_are_samples() -> None:
    """One request while frames arrive; a sample in SI each, saturated by the cell file's range."""
    bench = RobotiqBench()
    assert bench.line.written == start()
    samples = [sample for _ in range(150) for sample in bench.read(GOOD)]
    assert bench.line.written == start()
    assert [sample.counter for sample in samples] == list(range(1, 151))
    assert {sample.status for sample in samples} == {"ok"}
    assert samples[0].force_N == pytest.approx((1.0, -2.0, 30.0))
    (saturated,) = bench.read(frame((190.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
    assert (saturated.status, saturated.code) == ("saturated", "sensor_saturated")
    bench.driver.close()
    assert bench.line.written.endswith(b"\xff" * 50)


def test_silence_foreign_data_and_a_broken_line_have_different_codes() -> None:
    """Each case has its own code; the line is reopened until it works."""
    bench = RobotiqBench()
    assert bench.driver.silence_fault().code == "sensor_silent"
    bench.read(b"$GPGGA,123519,4807.038,N" * 10)
    assert bench.driver.silence_fault().code == "sensor_stranger"
    bench.line.broken = True
    bench.read()
    assert "Input/output error" in bench.driver.silence_fault().text
    bench.line = Line()
    bench.read(after_ns=2 * NS_PER_S)
    assert bench.line.written == start()
    assert [sample.status for sample in bench.read(GOOD)] == ["ok"]


# --- the driver, on a real line -------------------------------------------------------------------


def test_lost_frames_are_counted_and_many_are_a_fault() -> None:
    """Bytes that form no frame count as one lost frame; 10 % of lost frames are a fault."""
    bench = RobotiqBench()
    bench.read(GOOD)
    (sample,) = bench.read(GOOD[:10] + GOOD)
    assert (sample.counter, sample.status) == (3, "ok")
    codes = [bench.read(GOOD[:9] + GOOD)[0].code for _ in range(60)]
    assert codes[0] == ""
    assert codes[-1] == "sensor_lossy"
    assert bench.driver.counters()["lost"] == 61


def test_readings_that_waited_too_long_are_dropped() -> None:
    """After a stall of this process the age of pending readings is unknown."""
    bench = RobotiqBench()
    bench.read(GOOD)
    assert bench.read(GOOD * 5, after_ns=NS_PER_S // 10) == []
    assert bench.driver.counters()["late"] == 5
    assert bench.driver.silence_fault().code == "overrun"
    assert len(bench.read(GOOD)) == 1


def test_a_missing_line_or_package_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    """The cable may be plugged in later; the package has the command that installs it."""
    driver = robotiq_driver(section(device="/dev/no-such-line"), stale_after_s=STALE_S)
    driver.read(NS_PER_S)
    assert "No such file" in driver.silence_fault().text
    driver.read(3 * NS_PER_S)
    assert driver.counters()["requests"] == 2
    monkeypatch.setitem(sys.modules, "serial", None)
    with pytest.raises(ConfigError, match="pip install pyserial"):
        robotiq_driver(section(), stale_after_s=STALE_S)


@pytest.mark.realtime
def test_pyserial_carries_request_and_stream() -> None:
    """The line changes no byte, also not 0x0D, 0x11 and 0xFF."""
    sensor_end, driver_end = pty.openpty()
    driver = robotiq_driver(section(device=os.ttyname(driver_end)), stale_after_s=10.0)
    driver.read(time.monotonic_ns())
    assert os.read(sensor_end, 100) == start()
    os.write(sensor_end, frame((0.13, -0.01, 2.56), (0.017, -0.001, 3.34)))
    until_s, samples = time.monotonic() + 10.0, list[SensorSample]()
    while not samples and time.monotonic() < until_s:
        samples += driver.read(time.monotonic_ns())
    assert [sample.force_N for sample in samples] == [pytest.approx((0.13, -0.01, 2.56))]
    driver.close()
    for end in (sensor_end, driver_end):
        os.close(end)
