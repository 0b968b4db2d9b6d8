"""Driver for a Robotiq FT 300 / FT 300-S on a serial line. Needs pyserial: `pip install pyserial`.

A frame is 16 bytes: 0x20 0x4E, six signed 16-bit numbers (low byte first: N/100, N m/1000), and the
Modbus CRC. It has no sequence number: a loss shows as bytes that form no frame.
The sensor sends 100 readings a second: gains must be lower than with a faster sensor.
Source: Robotiq, FT 300-S instruction manual, sections on Modbus RTU and the data stream.
"""

import struct
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import NamedTuple, Protocol

from common.config.cell_sensor import SensorSection
from forcemesh.clock import NS_PER_S
from forcemesh.errors import ConfigError
from forcemesh.messages import Vec3
from services.sensor.driver import Info, LossWindow, SensorFault, SensorSample, fault_sample, judged

HEAD = b"\x20\x4e"
FRAME_BYTES = 16
BAUD = 19_200
RATE_HZ = 100.0
FORCE_RANGE_N, TORQUE_RANGE_NM = 300.0, 30.0
STOP = b"\xff" * 50  # half a second of any bytes: it becomes a Modbus slave again
MOST_BUFFERED_BYTES = 4096  # of unframed bytes that are kept
ASK_EVERY_S = 1.0
FEWEST_STRANGE_BYTES = 8 * FRAME_BYTES  # without a frame: another device is sending
SERIAL_RECEIVE_BYTES = 4096


def crc16(data: bytes) -> bytes:
    """Return the Modbus CRC-16, low byte first."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xA001 if crc & 1 else 0)
    return struct.pack("<H", crc)


def start() -> bytes:
    """Return the request that starts the stream: write 0x0200 to register 410 of slave 9."""
    request = bytes([9, 16, 410 >> 8, 410 & 0xFF, 0, 1, 2, 2, 0])
    return request + crc16(request)


class RobotiqFrame(NamedTuple):
    """One reading, with the number of unframed bytes before it."""

    force_N: Vec3
    torque_Nm: Vec3
    skipped: int = 0


class Framer:
    """Framer of a byte stream; bytes outside frames are skipped one by one and counted."""

    def __init__(self) -> None:
        """Start with an empty buffer."""
        self.bad_crc = 0
        self.skipped = 0  # unframed bytes since the last frame
        self._rest = b""

    def feed(self, data: bytes) -> list[RobotiqFrame]:
        """Take received bytes; return the complete frames."""
        self._rest += data
        frames: list[RobotiqFrame] = []
        while (begin := self._rest.find(HEAD)) >= 0 and len(self._rest) - begin >= FRAME_BYTES:
            self._skip(begin)
            candidate = self._rest[:FRAME_BYTES]
            if crc16(candidate[:-2]) != candidate[-2:]:
                self.bad_crc += 1
                self._skip(1)  # the head may have been part of a number
                continue
            fx, fy, fz, tx, ty, tz = struct.unpack("<6h", candidate[2:14])
            force_N = (fx / 100.0, fy / 100.0, fz / 100.0)
            torque_Nm = (tx / 1000.0, ty / 1000.0, tz / 1000.0)
            frames.append(RobotiqFrame(force_N, torque_Nm, self.skipped))
            self._rest, self.skipped = self._rest[FRAME_BYTES:], 0
        # Keep only bytes that may still become a frame.
        if begin < 0:
            begin = len(self._rest) - (1 if self._rest[-1:] == HEAD[:1] else 0)
        self._skip(max(begin, len(self._rest) - MOST_BUFFERED_BYTES))
        return frames

    def _skip(self, count: int) -> None:
        self._rest = self._rest[count:]
        self.skipped += count


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
        self._losses = LossWindow()

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
        code, text = "sensor_silent", "nothing received: check power and sensor.device"
        if self._fault:
            text = self._fault
        elif self._framer.skipped >= FEWEST_STRANGE_BYTES:
            code = "sensor_stranger"
            text = f"{self._framer.skipped} bytes received without a frame of an FT 300"
        elif self._is_late:
            code, text = "overrun", "readings waited too long to be read"
        return SensorFault(code, f"{self.where}: {text}")

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
        self._losses.add(lost)
        info, losses = self.info(), self._losses.fault()
        ranges = (info.force_range_N, info.torque_range_Nm)
        sample = judged(read.force_N, read.torque_Nm, *ranges)
        if sample.status == "ok" and losses.code:
            sample = fault_sample(*losses)
        return sample._replace(counter=self._number, stamp_ns=now_ns)

    # --- the line ---------------------------------------------------------------------------------

    def _receive(self) -> bytes:
        if self._line is None:
            return b""
        try:
            return self._line.read(SERIAL_RECEIVE_BYTES)
        except OSError as error:
            self._fail(error)
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
            self._fail(error)

    def _drop(self) -> None:
        if self._line is not None:
            with suppress(OSError):
                self._line.close()
        self._line = None

    def _fail(self, error: OSError) -> None:
        self._fault = error.strerror or str(error)
        self._drop()


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
