"""RDT protocol (Raw Data Transfer) of ATI Net F/T, ATI Axia and OnRobot. Pure.

Codec, sequences of the stream, its loss rates, and the cause of an interruption.

A request is 8 bytes, a record 36, both big endian. Every record has two sequence numbers: its
place in the stream (rdt_sequence: gaps are lost datagrams) and the number of the sensor's sample
(ft_sequence: a stalled sensor repeats it).
Source: ATI, Network Force/Torque Sensor System manual 9620-05-Net F/T, chapter on UDP with RDT.
"""

import struct
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Literal, NamedTuple

from common.config.cell_sensor import SensorSection
from services.sensor.driver import NO_FAULT, SensorFault, SensorSample, fault_sample, judged
from services.sensor.rdt_status import SATURATION_BITS, bits_of, is_good, status_text

REQUEST = struct.Struct(">HHI")  # header, command, number of records (0: endless)
RECORD = struct.Struct(">III6i")  # rdt_sequence, ft_sequence, status, Fx Fy Fz Tx Ty Tz
REQUEST_HEADER = 0x1234

LATE_WINDOW = 64  # a record later than this is not reordered: the stream has restarted
JUMP = 10_000  # a larger gap is not loss: over a second at the fastest rate
SEQUENCES = 1 << 32
FROZEN_AFTER_NS = 100_000_000  # noise of a live sensor never repeats six counts this long
FROZEN_RECORDS = 20
QUALITY_WINDOW = 250  # places of the stream; the last one to two windows are evaluated
BAD_SHARE = 0.1  # of the records: above it, the network path is unreliable
LEAST_RECORDS = 100  # fewer give no reliable rate
MOST_FT_HZ = 10_000  # no sensor samples faster
FT_MARGIN = 5_000
AWAY_RECORDS = 3  # fewest records that another client must have received


class RdtCommand(IntEnum):
    """Commands to the sensor. Tare is not one: it would apply to every client of the sensor."""

    STOP = 0x0000
    START = 0x0002  # real-time stream


class RdtRecord(NamedTuple):
    """One record as received."""

    rdt_sequence: int
    ft_sequence: int
    status: int
    counts: tuple[int, ...]  # Fx Fy Fz Tx Ty Tz


def request(command: RdtCommand) -> bytes:
    """Return the datagram of a command; a stream has no end."""
    return REQUEST.pack(REQUEST_HEADER, command, 0)


def parse(datagram: bytes) -> RdtRecord | None:
    """Return the record in a datagram, None if it is not one."""
    if len(datagram) != RECORD.size:
        return None
    rdt_sequence, ft_sequence, status, *counts = RECORD.unpack(datagram)
    return RdtRecord(rdt_sequence, ft_sequence, status, tuple(counts))


# --- sample of a record ---------------------------------------------------------------------------


def sample_of(record: RdtRecord, scale: SensorSection) -> SensorSample:
    """Return the sample of a record, in N and N m.

    A saturated axis distorts the others too, so the whole sample is invalid. Its values are kept:
    they show which axis it was.
    """
    if not is_good(record.status):
        bits = bits_of(record.status)
        is_load = bits and SATURATION_BITS.issuperset(bits)
        code = "sensor_saturated" if is_load else "sensor_fault"
        return fault_sample(code, status_text(record.status))
    fx, fy, fz, tx, ty, tz = record.counts
    force_N = (fx / scale.counts_per_N, fy / scale.counts_per_N, fz / scale.counts_per_N)
    torque_Nm = (tx / scale.counts_per_Nm, ty / scale.counts_per_Nm, tz / scale.counts_per_Nm)
    return judged(force_N, torque_Nm, scale.force_range_N, scale.torque_range_Nm)


# --- sequence of the stream -----------------------------------------------------------------------

RecordKind = Literal["sample", "repeated", "duplicate", "reordered"]  # only a sample is published


@dataclass(slots=True)
class Tally:
    """Counts since the start of the process."""

    records: int = 0
    lost: int = 0  # never received; a late one is subtracted again
    duplicates: int = 0
    reordered: int = 0  # received after newer ones
    repeated: int = 0  # next in the stream, with the sample of the one before
    restarts: int = 0  # the sensor restarted its sequence without a request


@dataclass(slots=True)
class RdtStream:
    """State of a stream: its newest record, and the gaps before it."""

    newest: RdtRecord | None = None
    missing: int = 0  # bit i: the record i places before the newest is missing
    number: int = 0  # of the newest record since the process started, losses included
    still_records: int = 0  # with the same six counts as the newest
    still_since_ns: int = 0
    tally: Tally = field(default_factory=Tally)

    def follow(self, record: RdtRecord, now_ns: int) -> RecordKind:
        """Advance by a record; return its kind. Only the newest record is a sample."""
        tally, newest = self.tally, self.newest
        tally.records += 1
        if newest is None:
            return self._begin(record, now_ns)
        ahead = signed(record.rdt_sequence - newest.rdt_sequence)
        is_later_sample = signed(record.ft_sequence - newest.ft_sequence) > 0
        if not -LATE_WINDOW < ahead < JUMP or (ahead <= 0 and is_later_sample):
            tally.restarts += 1
            return self._begin(record, now_ns)
        if ahead > 0:
            return self._continue(record, newest, ahead, now_ns)
        bit = 1 << -ahead
        if not self.missing & bit:
            tally.duplicates += 1
            return "duplicate"
        self.missing &= ~bit
        tally.reordered += 1
        tally.lost -= 1
        return "reordered"

    def frozen_fault(self, now_ns: int) -> SensorFault:
        """Return the fault of a constant reading while samples are counted."""
        still_ns = now_ns - self.still_since_ns
        if self.still_records < FROZEN_RECORDS or still_ns < FROZEN_AFTER_NS:
            return NO_FAULT
        text = f"the sensor is frozen: {self.still_records} samples without a trace of noise"
        return SensorFault("sensor_frozen", text)

    def _begin(self, record: RdtRecord, now_ns: int) -> RecordKind:
        self.newest, self.missing, self.number = record, 0, self.number + 1
        self.still_records, self.still_since_ns = 1, now_ns
        return "sample"

    def _continue(
        self, record: RdtRecord, newest: RdtRecord, ahead: int, now_ns: int
    ) -> RecordKind:
        gap = ((1 << ahead) - 1) & ~1  # bits of the records between the two
        self.missing = (self.missing << ahead | gap) & ((1 << LATE_WINDOW) - 1)
        self.newest, self.number = record, self.number + ahead
        self.tally.lost += ahead - 1
        is_repeated = record.ft_sequence == newest.ft_sequence
        self.tally.repeated += is_repeated
        if record.counts != newest.counts:
            self.still_records, self.still_since_ns = 1, now_ns
        else:  # a sensor that repeats a sample is stalled, not frozen: it is not counted
            self.still_records += not is_repeated
        return "repeated" if is_repeated else "sample"


def signed(difference: int) -> int:
    """Return a difference of two sequence numbers, which wrap at 32 bits."""
    return (difference + SEQUENCES // 2) % SEQUENCES - SEQUENCES // 2


# --- quality of the stream ------------------------------------------------------------------------


class Quality:
    """Rates of losses, disorder and copies over the last one to two windows of a stream."""

    def __init__(self) -> None:
        """Start at the beginning of a stream."""
        self._older = self._newer = (0, Tally())  # place of the stream and its counts there

    def move_on(self, stream: RdtStream) -> None:
        """Take the records received so far into the window."""
        if stream.number - self._newer[0] >= QUALITY_WINDOW:
            self._older, self._newer = self._newer, (stream.number, replace(stream.tally))

    def rate_fault(self, stream: RdtStream) -> SensorFault:
        """Return the fault of the records in the window."""
        (place, before), tally = self._older, stream.tally
        places = stream.number - place
        if places < LEAST_RECORDS:
            return NO_FAULT
        shares = (
            ("sensor_lossy", "were lost", tally.lost - before.lost),
            ("sensor_disorder", "arrived out of order", tally.reordered - before.reordered),
            ("sensor_copies", "arrived twice", tally.duplicates - before.duplicates),
        )
        for code, what, count in shares:
            if count > BAD_SHARE * places:
                return SensorFault(code, f"{count} of the last {places} records {what}")
        return NO_FAULT


def continues(last: RdtRecord, record: RdtRecord, ft_step: int) -> bool:
    """Return whether a record is of the same stream: both sequences changed together."""
    places = signed(record.rdt_sequence - last.rdt_sequence)
    samples = signed(record.ft_sequence - last.ft_sequence)
    off = abs(samples - places * ft_step)
    return abs(places) < JUMP and off <= ft_step + abs(places) * ft_step // 2


def meaning_of_break(
    last: RdtRecord, first: RdtRecord, *, silent_s: float, ft_step: int, at_once: bool
) -> SensorFault:
    """Return the cause of the interruption between two streams.

    Args:
        last: Newest record before the interruption.
        first: First record after it.
        silent_s: Time between the two.
        ft_step: Increment of ft_sequence per record before.
        at_once: Whether the stream was requested, and the first request was answered.
    """
    gap = signed(first.ft_sequence - last.ft_sequence)
    if gap < 0 or gap > silent_s * MOST_FT_HZ + FT_MARGIN:
        return SensorFault(
            "sensor_restarted",
            f"the sensor restarted: ft_sequence went from {last.ft_sequence} "
            f"to {first.ft_sequence}",
        )
    if at_once and gap > AWAY_RECORDS * max(ft_step, 1):
        # It kept measuring and can be reached, but it had stopped sending here.
        return SensorFault(
            "sensor_stolen",
            f"the sensor sent nothing for {silent_s * 1e3:.0f} ms, kept measuring and answered "
            "the next request at once: another client took its stream",
        )
    return NO_FAULT
