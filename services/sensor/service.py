"""The sensor driver on the bus: records of the sensor in, `sensor/wrench` out."""

from dataclasses import asdict
from typing import Protocol

from common import topics
from common.cell import Cell, SensorSection
from common.clock import NS_PER_S
from common.endpoints import Bus
from common.messages import SensorWrench
from services.sensor.link import Heard, Link, LinkSettings
from services.sensor.rdt import (
    MONITOR_CONDITION,
    Command,
    Sample,
    Scale,
    Stream,
    begin_anew,
    fault_sample,
    follow,
    frozen_reason,
    parse,
    request,
    sample_of,
)
from services.sensor.thinning import Thinning, pause, thin

STEP_S = 0.0005  # how long a record may wait in the socket
NOTHING_COMES = "nothing comes: is the address right, and does no other client take the stream?"
SEVERITY = {"ok": 0, "saturated": 1, "fault": 2}


class Wire(Protocol):
    """What the driver needs of its link."""

    requests: int
    fault: str

    @property
    def where(self) -> str:
        """Name of the peer for people."""

    def poll(self, now_ns: int) -> Heard:
        """Return what has come, at once."""

    def close(self) -> None:
        """Stop the stream."""


class SensorDriver:
    """Publishes every sample once, when it comes; says why at its rate while none comes."""

    def __init__(self, bus: Bus, cell: Cell, wire: Wire | None = None) -> None:
        """Take the topic of the sensor; `wire` replaces the socket."""
        self.period_s = STEP_S
        self.trigger = None
        self.fault = "no sample yet"
        self._wire = wire or link_of(cell.sensor)
        self._scale = scale_of(cell.sensor)
        self._stream = Stream()
        self._thinning = Thinning(cell.rates.sensor_hz)
        self._worst: Sample | None = None  # of the samples since the last one published
        self._stale_after_ns = round(cell.stale_after_s(topics.SENSOR_WRENCH) * NS_PER_S)
        self._period_ns = round(NS_PER_S / cell.rates.sensor_hz)
        self._sampled_ns = bus.clock.now_ns()
        self._complain_at_ns = 0
        self._silence = ""
        self._counts = dict.fromkeys(("published", "malformed", "late", "monitor_conditions"), 0)
        self._out = bus.publisher(topics.SENSOR_WRENCH)

    def counters(self) -> dict[str, int]:
        """Return what came, what was lost, what was dropped and why."""
        return {
            **asdict(self._stream.tally),
            **self._counts,
            "requests": self._wire.requests,
            "sensor_hz": round(self._thinning.rate_hz),
            "keep_every": self._thinning.keep_every,
        }

    def close(self) -> None:
        """Stop the sensor's stream."""
        self._wire.close()

    def step(self, now_ns: int) -> None:
        """Take every record that waits; complain while there is no sample."""
        heard = self._wire.poll(now_ns)
        age_ns = now_ns - heard.since_ns
        for datagram in heard.datagrams:
            self._take(datagram, now_ns, age_ns)
        if heard.asked:
            self._stream, self._thinning = begin_anew(self._stream), pause(self._thinning)
            self._silence = NOTHING_COMES
        silent_ns = now_ns - self._sampled_ns
        is_silent = silent_ns > self._stale_after_ns or self._stream.number == 0
        if is_silent and now_ns >= self._complain_at_ns:
            if now_ns - self._complain_at_ns > self._period_ns:
                self._complain_at_ns = now_ns  # periods that went by are not made up for
            self._complain_at_ns += self._period_ns
            self._put(fault_sample(self._complaint(heard, silent_ns)))

    # --- samples ----------------------------------------------------------------------------------

    def _take(self, datagram: bytes, now_ns: int, age_ns: int) -> None:
        record = parse(datagram)
        if record is None:
            self._counts["malformed"] += 1
            self._silence = f"{len(datagram)} bytes came, which are no RDT record of 36"
            return
        self._stream, kind = follow(self._stream, record, now_ns)
        if kind == "repeated":
            self._silence = f"the sensor is stalled: ft_sequence stays at {record.ft_sequence}"
        if kind != "sample":
            return
        if age_ns > self._stale_after_ns:
            # It waited in the socket while this process was held up: nobody knows how long.
            self._counts["late"] += 1
            self._silence = f"records have waited up to {age_ns / 1e6:.0f} ms to be read"
            return
        self._counts["monitor_conditions"] += record.status == MONITOR_CONDITION
        self._sampled_ns, self._silence = now_ns, ""
        frozen = frozen_reason(self._stream, now_ns)
        self._publish(fault_sample(frozen) if frozen else sample_of(record, self._scale), now_ns)

    def _publish(self, sample: Sample, now_ns: int) -> None:
        """Publish a sample, or leave it out; a bad one among those left out is not forgotten."""
        if self._worst is None or SEVERITY[sample.status] >= SEVERITY[self._worst.status]:
            self._worst = sample
        self._thinning, is_kept = thin(self._thinning, self._stream.number, now_ns)
        if is_kept:
            worst, self._worst = self._worst, None
            self._put(sample if worst.status == "ok" else worst)

    def _put(self, sample: Sample) -> None:
        self.fault = sample.reason[:400]
        self._counts["published"] += 1
        self._out.put(
            SensorWrench(
                valid=sample.status == "ok",
                reason=self.fault,
                force_N=sample.force_N,
                torque_Nm=sample.torque_Nm,
                status=sample.status,
                counter=self._stream.number,
            )
        )

    # --- silence ----------------------------------------------------------------------------------

    def _complaint(self, heard: Heard, silent_ns: int) -> str:
        """Say why there is no sample: the network, the sensor, or this process."""
        if not heard.datagrams and self._wire.fault:
            return self._wire.fault
        why = self._silence or "nothing comes any more"
        return f"{self._wire.where}: no sample for {silent_ns / 1e6:.0f} ms, {why}"


def link_of(sensor: SensorSection) -> Link:
    """Return the link to the sensor of a cell file."""
    return Link(
        LinkSettings(
            sensor.address, sensor.port, start=request(Command.START), stop=request(Command.STOP)
        )
    )


def scale_of(sensor: SensorSection) -> Scale:
    """Return calibration and range of the sensor of a cell file."""
    return Scale(
        counts_per_N=sensor.counts_per_N,
        counts_per_Nm=sensor.counts_per_Nm,
        force_range_N=sensor.force_range_N,
        torque_range_Nm=sensor.torque_range_Nm,
    )
