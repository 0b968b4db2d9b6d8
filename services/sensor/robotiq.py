"""Stream decoder of a Robotiq FT 300 / FT 300-S: bytes in, frames out. Pure.

A frame is 16 bytes: 0x20 0x4E, six signed 16-bit numbers (low byte first: N/100, N m/1000), and the
Modbus CRC. It has no sequence number: a loss shows as bytes that form no frame.
Source: Robotiq, FT 300-S instruction manual, sections on Modbus RTU and the data stream.
"""

import struct
from dataclasses import dataclass

from forcemesh.messages import Vec3

HEAD = b"\x20\x4e"
FRAME_BYTES = 16
BAUD = 19_200
RATE_HZ = 100.0
FORCE_RANGE_N, TORQUE_RANGE_NM = 300.0, 30.0
STOP = b"\xff" * 50  # half a second of any bytes: it becomes a Modbus slave again
MOST_BUFFERED_BYTES = 4096  # of unframed bytes that are kept


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


@dataclass(frozen=True, slots=True)
class RobotiqFrame:
    """One reading, with the number of unframed bytes before it."""

    force_N: Vec3
    torque_Nm: Vec3
    skipped: int = 0


def frame(force_N: Vec3, torque_Nm: Vec3) -> bytes:
    """Return the bytes of a frame as the sensor sends it."""
    numbers = [round(100.0 * f) for f in force_N] + [round(1000.0 * t) for t in torque_Nm]
    data = HEAD + struct.pack("<6h", *numbers)
    return data + crc16(data)


class Framer:
    """Framer of a byte stream; bytes outside frames are skipped one by one and counted."""

    def __init__(self) -> None:
        """Start with an empty buffer."""
        self.bad_crc = 0
        self._rest = b""
        self._skipped = 0  # since the last frame

    @property
    def skipped(self) -> int:
        """Return the number of unframed bytes since the last frame."""
        return self._skipped

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
            frames.append(RobotiqFrame(force_N, torque_Nm, self._skipped))
            self._rest, self._skipped = self._rest[FRAME_BYTES:], 0
        self._drop_noise()
        return frames

    def _skip(self, count: int) -> None:
        self._rest = self._rest[count:]
        self._skipped += count

    def _drop_noise(self) -> None:
        """Keep only bytes that may still become a frame."""
        begin = self._rest.find(HEAD)
        if begin < 0:
            begin = len(self._rest) - (1 if self._rest[-1:] == HEAD[:1] else 0)
        self._skip(max(begin, len(self._rest) - MOST_BUFFERED_BYTES))
