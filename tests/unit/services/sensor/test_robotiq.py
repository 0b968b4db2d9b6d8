"""The Robotiq FT 300: bytes and frames, and the driver over a pseudo-terminal."""

import builtins
import os
import pty
import random
import time
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.config.cell import SensorSection
from common.config.load import load_cell
from forcemesh.clock import NS_PER_S
from forcemesh.errors import ConfigError
from services.sensor.driver import SensorSample
from services.sensor.robotiq import FRAME_BYTES, HEAD, Framer, frame, start
from services.sensor.robotiq_driver import RobotiqDriver, robotiq_driver
from tests.fakes.rdt_sensor import REAL_CELL

STALE_S = 0.03
PERIOD_NS = 10_000_000

force = st.floats(-300.0, 300.0).map(lambda value: round(value, 2))
torque = st.floats(-30.0, 30.0).map(lambda value: round(value, 3))
readings = st.tuples(st.tuples(force, force, force), st.tuples(torque, torque, torque))


# --- bytes ----------------------------------------------------------------------------------------


def test_the_request_is_the_one_of_the_manual() -> None:
    """Slave 9, write multiple registers, 410, 0x0200, and the CRC that the manual prints."""
    assert start() == bytes.fromhex("09 10 01 9A 00 01 02 02 00 CD CA")


@given(readings)
def test_a_frame_is_read_as_it_was_sent(reading: Any) -> None:
    """In hundredths of a newton and thousandths of a newton metre, sign kept."""
    (read,) = Framer().feed(frame(*reading))
    assert read.force_N == pytest.approx(reading[0])
    assert read.torque_Nm == pytest.approx(reading[1])
    assert read.skipped == 0


@given(st.lists(readings, min_size=1, max_size=8), st.integers(0, 2**32))
def test_frames_are_found_however_the_bytes_are_cut(sent: list[Any], seed: int) -> None:
    """The line delivers pieces of any size."""
    rng, data, framer = random.Random(seed), b"".join(frame(*each) for each in sent), Framer()
    found = []
    while data:
        size = rng.randint(1, 20)
        found += framer.feed(data[:size])
        data = data[size:]
    assert [read.force_N for read in found] == [pytest.approx(each[0]) for each in sent]
    assert sum(read.skipped for read in found) == 0


@given(readings, st.binary(max_size=60))
def test_no_byte_is_forgotten(reading: Any, rubbish: bytes) -> None:
    """Of what came every byte is a frame's, is counted as skipped, or still waits."""
    framer = Framer()
    found = framer.feed(rubbish + frame(*reading) + HEAD)
    taken = sum(FRAME_BYTES + read.skipped for read in found)
    waiting = len(framer._rest)
    assert taken + framer.skipped + waiting == len(rubbish) + FRAME_BYTES + len(HEAD)


@given(readings, st.integers(2, 15), st.integers(1, 255))
def test_a_spoiled_frame_is_no_reading(reading: Any, place: int, flip: int) -> None:
    """One wrong byte anywhere behind the head: the CRC does not fit, the next frame is found."""
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
        """Return what waits."""
        if self.broken:
            raise OSError(5, "Input/output error")
        data, self.waiting = self.waiting, b""
        return data

    def write(self, data: bytes) -> int:
        """Keep what was sent."""
        self.written += data
        return len(data)

    def close(self) -> None:
        """Nothing to let go."""


def section(**changes: Any) -> SensorSection:
    """Return the section of a cell file for this sensor."""
    return load_cell(REAL_CELL, {f"sensor.{name}": value for name, value in changes.items()}).sensor


class Bench:
    """A driver, its line and a clock."""

    def __init__(self) -> None:
        self.line = Line()
        sensor = section(driver="robotiq", device="a line")
        self.driver = RobotiqDriver(sensor, lambda: self.line, stale_after_s=STALE_S)
        self.now_ns = NS_PER_S
        self.read()

    def read(self, data: bytes = b"", after_ns: int = PERIOD_NS) -> list[SensorSample]:
        """Let bytes arrive; return what the driver makes of them."""
        self.now_ns += after_ns
        self.line.waiting += data
        return list(self.driver.read(self.now_ns))


GOOD = frame((1.0, -2.0, 30.0), (0.1, -0.2, 0.3))


def test_the_stream_is_asked_for_and_its_frames_are_samples() -> None:
    """Once, while frames come; each is a sample in SI with a number of its own."""
    bench = Bench()
    assert bench.line.written == start()
    samples = [sample for _ in range(150) for sample in bench.read(GOOD)]
    assert bench.line.written == start()
    assert [sample.counter for sample in samples] == list(range(1, 151))
    assert {sample.status for sample in samples} == {"ok"}
    assert samples[0].force_N == pytest.approx((1.0, -2.0, 30.0))
    bench.driver.close()
    assert bench.line.written.endswith(b"\xff" * 50)


def test_lost_frames_are_counted_and_many_are_a_fault() -> None:
    """What makes no frame was one: its number is left out, and a tenth of them is too many."""
    bench = Bench()
    bench.read(GOOD)
    (sample,) = bench.read(GOOD[:10] + GOOD)
    assert (sample.counter, sample.status) == (3, "ok")
    codes = [bench.read(GOOD[:9] + GOOD)[0].code for _ in range(60)]
    assert codes[0] == ""
    assert codes[-1] == "sensor_lossy"
    assert bench.driver.counters()["lost"] == 61


def test_saturation_is_that_of_the_smaller_range() -> None:
    """The cell file's 200 N go before the sensor's own 300 N."""
    (sample,) = Bench().read(frame((190.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
    assert (sample.status, sample.code) == ("saturated", "sensor_saturated")


def test_silence_strangers_and_a_broken_line_are_told_apart() -> None:
    """Each with its code; the line is opened anew until it is back."""
    bench = Bench()
    assert bench.driver.complaint().code == "sensor_silent"
    bench.read(b"$GPGGA,123519,4807.038,N" * 10)
    assert bench.driver.complaint().code == "sensor_stranger"
    bench.line.broken = True
    bench.read()
    assert "Input/output error" in bench.driver.complaint().text
    bench.line = Line()
    bench.read(after_ns=2 * NS_PER_S)
    assert bench.line.written == start()
    assert [sample.status for sample in bench.read(GOOD)] == ["ok"]


def test_readings_that_waited_too_long_are_dropped() -> None:
    """Nobody knows their age after this process was held up."""
    bench = Bench()
    bench.read(GOOD)
    assert bench.read(GOOD * 5, after_ns=NS_PER_S // 10) == []
    assert bench.driver.counters()["late"] == 5
    assert bench.driver.complaint().code == "overrun"
    assert len(bench.read(GOOD)) == 1


def test_a_missing_package_is_told_in_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the word that installs it."""
    real = builtins.__import__

    def without(name: str, *rest: Any) -> Any:
        if name == "serial":
            raise ImportError(name)
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(ConfigError, match="pip install pyserial"):
        robotiq_driver(section(), stale_after_s=STALE_S)


# --- the driver, on a real line -------------------------------------------------------------------


@pytest.fixture
def terminal() -> Iterator[tuple[int, str]]:
    """The sensor's end of a pseudo-terminal, and the name of ours."""
    ours, theirs = pty.openpty()
    yield ours, os.ttyname(theirs)
    os.close(ours)
    os.close(theirs)


@pytest.mark.realtime
def test_pyserial_carries_request_and_stream(terminal: tuple[int, str]) -> None:
    """Nothing on the way changes a byte, also 0x0D, 0x11 and 0xFF."""
    sensor_end, name = terminal
    driver = robotiq_driver(section(device=name), stale_after_s=10.0)
    driver.read(time.monotonic_ns())
    assert os.read(sensor_end, 100) == start()
    sent = frame((0.13, -0.01, 2.56), (0.017, -0.001, 3.34))
    os.write(sensor_end, sent * 3)
    samples: list[SensorSample] = []
    give_up_s = time.monotonic() + 10.0
    while len(samples) < 3 and time.monotonic() < give_up_s:
        samples += driver.read(time.monotonic_ns())
    assert [sample.force_N for sample in samples] == [pytest.approx((0.13, -0.01, 2.56))] * 3
    driver.close()
    assert os.read(sensor_end, 100) == b"\xff" * 50


def test_a_line_that_does_not_exist_is_told_and_tried_again() -> None:
    """The cable may come later."""
    driver = robotiq_driver(section(device="/dev/no-such-line"), stale_after_s=STALE_S)
    driver.read(NS_PER_S)
    assert "No such file" in driver.complaint().text
    driver.read(3 * NS_PER_S)
    assert driver.counters()["requests"] == 2
