"""Driver for a Robotiq FT 300 on a serial line. Needs pyserial: `pip install pyserial`.

The sensor sends 100 readings a second: gains must be lower than with a faster sensor.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Protocol

from common.config.cell import SensorSection
from forcemesh.clock import NS_PER_S
from forcemesh.errors import ConfigError
from services.sensor.driver import Info, SensorFault, SensorSample, fault_sample, saturation
from services.sensor.robotiq import (
    BAUD,
    FORCE_RANGE_N,
    FRAME_BYTES,
    RATE_HZ,
    STOP,
    TORQUE_RANGE_NM,
    Framer,
    RobotiqFrame,
    start,
)

ASK_EVERY_S = 1.0
FEWEST_STRANGE_BYTES = 8 * FRAME_BYTES  # without a frame: another device is sending
BAD_SHARE = 0.1  # of the frames of the window
WINDOW = 100
SERIAL_RECEIVE_BYTES = 4096


class SerialLine(Protocol):
    """Interface of the serial line: pyserial's Serial, opened without blocking."""

    def read(self, size: int) -> bytes:
        """Return the waiting bytes."""

    def write(self, data: bytes) -> int | None:
        """Send bytes."""

    def close(self) -> None:
        """Close the line."""


class RobotiqDriver:
    """Driver that requests the stream, reads frames, and reopens the line after an error."""

    def __init__(
        self, sensor: SensorSection, open_line: Callable[[], SerialLine], *, stale_after_s: float
    ) -> None:
        """Store the settings; the first `read` opens the line. `open_line` may raise OSError."""
        self._sensor, self._open_line = sensor, open_line
        self._stale_after_ns = round(stale_after_s * NS_PER_S)
        self._line: SerialLine | None = None
        self._framer = Framer()
        self._counts = dict.fromkeys(("records", "lost", "malformed", "late", "requests"), 0)
        self._number = 0
        self._ask_at_ns = 0
        self._emptied_ns = 0
        self._fault = ""
        self._is_late = False
        self._window: list[int] = []  # frames lost before each of the last ones

    @property
    def where(self) -> str:
        """Return name and line of the sensor for messages."""
        return f"FT 300 at {self._sensor.device}"

    def info(self) -> Info:
        """Return the identity of the sensor."""
        return Info(
            "Robotiq FT 300",
            min(self._sensor.force_range_N, FORCE_RANGE_N),
            min(self._sensor.torque_range_Nm, TORQUE_RANGE_NM),
            f"its own calibration, {RATE_HZ:g} Hz",
        )

    def counters(self) -> dict[str, int]:
        """Return counts of received, lost and malformed frames."""
        return {**self._counts, "bad_crc": self._framer.bad_crc}

    def silence_fault(self) -> SensorFault:
        """Return why no sample is received."""
        if self._fault:
            return SensorFault("sensor_silent", f"{self.where}: {self._fault}")
        if self._framer.skipped >= FEWEST_STRANGE_BYTES:
            text = f"{self._framer.skipped} bytes received without a frame of an FT 300"
            return SensorFault("sensor_stranger", f"{self.where}: {text}")
        if self._is_late:
            return SensorFault("overrun", f"{self.where}: readings waited too long to be read")
        text = f"{self.where}: nothing received: check power and sensor.device"
        return SensorFault("sensor_silent", text)

    def close(self) -> None:
        """Stop the stream and close the line."""
        if self._line is not None:
            with suppress(OSError):
                self._line.write(STOP)
        self._drop()

    def read(self, now_ns: int) -> Sequence[SensorSample]:
        """Return every sample received since the last call, oldest first."""
        since_ns, self._emptied_ns = self._emptied_ns or now_ns, now_ns
        frames = self._framer.feed(self._receive())
        if frames:
            self._fault = ""
            self._ask_at_ns = now_ns + round(ASK_EVERY_S * NS_PER_S)
        elif now_ns >= self._ask_at_ns:
            self._ask(now_ns)
        self._is_late = bool(frames) and now_ns - since_ns > self._stale_after_ns
        samples = [self._take(each, now_ns) for each in frames]
        if self._is_late:
            self._counts["late"] += len(frames)
            return []
        return samples

    def _take(self, read: RobotiqFrame, now_ns: int) -> SensorSample:
        # The reply to the request, or the rest of a frame, precedes the first frame.
        lost = -(-read.skipped // FRAME_BYTES) if self._counts["records"] else 0
        self._counts["malformed"] += bool(lost)
        self._counts["lost"] += lost
        self._counts["records"] += 1
        self._number += 1 + lost
        self._window = [*self._window[1 - WINDOW :], lost]
        sample = self._judged(read)
        return replace(sample, counter=self._number, stamp_ns=now_ns)

    def _judged(self, read: RobotiqFrame) -> SensorSample:
        info, lost, frames = self.info(), sum(self._window), len(self._window)
        reason = saturation(read.force_N, read.torque_Nm, info.force_range_N, info.torque_range_Nm)
        if reason:
            return SensorSample(
                read.force_N, read.torque_Nm, "saturated", reason, "sensor_saturated"
            )
        if frames >= WINDOW // 2 and lost > BAD_SHARE * (lost + frames):
            text = f"{lost} of the last {lost + frames} readings were lost"
            return fault_sample("sensor_lossy", text)
        return SensorSample(read.force_N, read.torque_Nm)

    # --- the line ---------------------------------------------------------------------------------

    def _receive(self) -> bytes:
        if self._line is None:
            return b""
        try:
            return self._line.read(SERIAL_RECEIVE_BYTES)
        except OSError as error:
            self._note(error)
            self._drop()
            return b""

    def _ask(self, now_ns: int) -> None:
        self._ask_at_ns = now_ns + round(ASK_EVERY_S * NS_PER_S)
        self._counts["requests"] += 1
        try:
            if self._line is None:
                self._line = self._open_line()
                self._fault = ""
            self._line.write(start())
        except OSError as error:
            self._note(error)
            self._drop()

    def _drop(self) -> None:
        if self._line is not None:
            with suppress(OSError):
                self._line.close()
        self._line = None

    def _note(self, error: OSError) -> None:
        self._fault = error.strerror or str(error)


def robotiq_driver(sensor: SensorSection, *, stale_after_s: float) -> RobotiqDriver:
    """Return the driver of a cell file, with a real serial line.

    Raises:
        ConfigError: pyserial is not installed.
    """
    try:
        import serial  # noqa: PLC0415 - optional dependency of this sensor
    except ImportError as error:
        mistake = "sensor.driver: robotiq needs pyserial: pip install pyserial"
        raise ConfigError("the sensor's driver", [mistake]) from error

    def open_line() -> SerialLine:
        line: SerialLine = serial.Serial(sensor.device, BAUD, timeout=0, write_timeout=0.1)
        return line

    return RobotiqDriver(sensor, open_line, stale_after_s=stale_after_s)
