"""Synthetic force logs whose true figures are known, and their files."""

import csv
import struct
from collections.abc import Iterable, Mapping, Sequence
from math import exp, pi, sqrt
from pathlib import Path

import numpy as np
from mcap.writer import Writer

from common.motion.frames import Array
from tuning.force_log import Signal
from tuning.log_quality import LogColumn

RATE_HZ = 500.0
STEP_S, END_S = 1.0, 5.0
WRENCH_STAMPED = "geometry_msgs/msg/WrenchStamped"


def times(end_s: float = END_S, rate_hz: float = RATE_HZ) -> Array:
    """Return even times."""
    return np.arange(round(end_s * rate_hz)) / rate_hz


def first_order(time_s: Array, tau_s: float, at_s: float = STEP_S) -> Array:
    """Return a unit step response that settles to a band of b after tau ln(1 / b)."""
    return np.where(time_s >= at_s, -np.expm1(-np.maximum(time_s - at_s, 0.0) / tau_s), 0.0)


def second_order(time_s: Array, *, damping: float, rad_s: float, at_s: float = STEP_S) -> Array:
    """Return a unit step response with an overshoot of `overshoot_of(damping)`."""
    x = np.maximum(time_s - at_s, 0.0) * rad_s
    root = sqrt(1.0 - damping * damping)
    wave = np.cos(root * x) + damping / root * np.sin(root * x)
    return np.where(time_s >= at_s, 1.0 - np.exp(-damping * x) * wave, 0.0)


def overshoot_of(damping: float) -> float:
    """Return the overshoot of a second-order system, in percent (a textbook formula)."""
    return 100.0 * exp(-damping * pi / sqrt(1.0 - damping * damping))


def setpoint_at(time_s: Array, level: float, at_s: float = STEP_S) -> Array:
    """Return a set point that steps from 0."""
    return np.where(time_s >= at_s, level, 0.0)


def noise(count: int, deviation: float, seed: int = 1) -> Array:
    """Return white noise."""
    return deviation * np.random.default_rng(seed).standard_normal(count)


def column(time_s: Array, value: Array, name: str = "fz") -> LogColumn:
    """Return a column in N without missing samples."""
    return LogColumn(name, "N", Signal(time_s, value), 0)


def write_csv(path: Path, columns: Mapping[str, Iterable[object]]) -> Path:
    """Write columns with a header."""
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))
    return path


def wrench_cdr(stamp_s: float, six: Sequence[float], *, frame: str, order: str = "<") -> bytes:
    """Return a WrenchStamped in CDR, padded byte for byte as the standard says."""
    text = frame.encode() + b"\0"
    second = int(stamp_s)
    body = struct.pack(f"{order}iII", second, round(1e9 * (stamp_s - second)), len(text)) + text
    while len(body) % 8:
        body += b"\0"
    head = b"\x00\x01\x00\x00" if order == "<" else b"\x00\x00\x00\x00"
    return head + body + struct.pack(f"{order}6d", *six)


Message = tuple[float, bytes]  # time in the file [s], data


def write_mcap(path: Path, topics: Mapping[tuple[str, str, str], Iterable[Message]]) -> Path:
    """Write messages by topic, schema and encoding."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        for (topic, schema, encoding), messages in topics.items():
            number = writer.register_schema(schema, "jsonschema", b"{}") if schema else 0
            channel = writer.register_channel(topic, encoding, number)
            for at_s, data in messages:
                at_ns = round(1e9 * at_s)
                writer.add_message(channel, at_ns, data, at_ns)
        writer.finish()
    return path
