"""RDT driver for ATI Net F/T, ATI Axia and OnRobot: records of one stream in, samples out."""

from collections.abc import Sequence
from dataclasses import asdict

from common.config.cell_sensor import SensorSection
from forcemesh.clock import NS_PER_S
from services.sensor.driver import NO_FAULT, Info, SensorFault, SensorSample, fault_sample
from services.sensor.link import PageFetch, UdpLink
from services.sensor.netft_page import SettingsPage, disagreement, info_of, scale_of
from services.sensor.rdt import (
    Quality,
    RdtRecord,
    RdtStream,
    continues,
    meaning_of_break,
    parse,
    sample_of,
    signed,
)
from services.sensor.rdt_status import MONITOR_CONDITIONS

# Every sample is a fault for this long after a restart or a theft of the stream: a reader that
# keeps only the newest message must not miss it.
FAULT_HOLD_S = 0.25
AT_ONCE_S = 0.05  # from a request to its reply, in a local network
NOTHING_COMES = SensorFault(
    "sensor_silent",
    "nothing received: check address and power, and that no other client takes the stream",
)
NO_MORE = SensorFault("sensor_silent", "nothing received any more")
UNVERIFIED_AFTER_S = 10.0  # several failed requests of the page
BEING_READ = SensorFault("sensor_calibration", "the sensor's page is being read")


class RdtDriver:
    """Driver that classifies records by sequence: lost, duplicate, late, stalled or restarted."""

    def __init__(
        self,
        sensor: SensorSection,
        wire: UdpLink,
        page: PageFetch | None,
        *,
        stale_after_s: float,
    ) -> None:
        """Store the settings. `page`: None if the cell file's counts are used."""
        self._sensor, self._wire, self._page = sensor, wire, page
        self._scale = scale_of(sensor) if page is None else None
        self._page_fault = NO_FAULT
        self._read: SettingsPage | None = None  # of this stream
        self._stale_after_ns = round(stale_after_s * NS_PER_S)
        self._stream = RdtStream()
        self._quality = Quality()
        self._silence = NOTHING_COMES
        self._held_fault, self._held_until_ns = NO_FAULT, 0
        self._last: RdtRecord | None = None  # newest one received, also of an earlier stream
        self._last_ns = 0
        self._ft_step = 1
        self._asked: tuple[int, int] | None = None  # time, and number of unanswered requests
        names = (
            "malformed",
            "late",
            "monitor_conditions",
            "thefts",
            "sensor_restarts",
            "page_changes",
        )
        self._counts = dict.fromkeys(names, 0)

    @property
    def where(self) -> str:
        """Return name and address of the sensor for messages."""
        return self._wire.where

    def counters(self) -> dict[str, int]:
        """Return counts of received, lost and dropped records, by cause."""
        return {**asdict(self._stream.tally), **self._counts, "requests": self._wire.requests}

    def info(self) -> Info | None:
        """Return the identity of the sensor, None until its page has been read."""
        if self._page is None:
            return info_of(self._sensor, None)
        page = self._page.poll(0)
        return None if page is None else info_of(self._sensor, page)

    def close(self) -> None:
        """Stop the sensor's stream."""
        self._wire.close()

    def silence_fault(self) -> SensorFault:
        """Return why no sample is received: network, sensor, or this process."""
        if self._wire.fault:
            return SensorFault("sensor_silent", self._wire.fault)
        return SensorFault(self._silence.code, f"{self.where}: {self._silence.text}")

    def read(self, now_ns: int) -> Sequence[SensorSample]:
        """Return every sample received since the last call, oldest first."""
        self._calibrate(now_ns)
        received = self._wire.poll(now_ns)
        age_ns = now_ns - received.since_ns
        samples = [self._take(datagram, now_ns, age_ns) for datagram in received.datagrams]
        if received.asked:
            self._asked = (now_ns, received.unanswered)
            never = self._stream.number == 0
            self._silence = NOTHING_COMES if never or received.unanswered > 1 else NO_MORE
        return [sample for sample in samples if sample is not None]

    # --- one record -------------------------------------------------------------------------------

    def _take(self, datagram: bytes, now_ns: int, age_ns: int) -> SensorSample | None:
        record = parse(datagram)
        if record is None:
            self._counts["malformed"] += 1
            text = f"{len(datagram)} bytes received, which are not an RDT record of 36 bytes"
            self._silence = SensorFault("sensor_stranger", text)
            return None
        if self._asked is not None and not self._continues(record):
            self._stream.newest = None  # it may start anywhere
        restarts = self._stream.tally.restarts
        kind = self._stream.follow(record, now_ns)
        self._classify_break(record, now_ns, is_new=self._stream.tally.restarts > restarts)
        self._quality.move_on(self._stream)
        if kind == "repeated":
            text = f"the sensor is stalled: ft_sequence stays at {record.ft_sequence}"
            self._silence = SensorFault("sensor_stalled", text)
        if kind != "sample":
            return None
        if age_ns > self._stale_after_ns:
            # It waited in the socket while this process was delayed, for an unknown time.
            self._counts["late"] += 1
            text = f"records waited up to {age_ns / 1e6:.0f} ms to be read"
            self._silence = SensorFault("overrun", text)
            return None
        self._counts["monitor_conditions"] += record.status in MONITOR_CONDITIONS
        self._silence = NO_MORE
        return self._sample(record, now_ns)

    def _sample(self, record: RdtRecord, now_ns: int) -> SensorSample:
        """Return the sample of a record, or its first fault in order of severity."""
        if self._scale is None or self._page_fault.code:
            sample = fault_sample(*(self._page_fault if self._page_fault.code else BEING_READ))
        else:
            sample = sample_of(record, self._scale)
        if sample.status == "ok":
            causes = (
                self._held_fault if now_ns < self._held_until_ns else NO_FAULT,
                self._stream.frozen_fault(now_ns),
                self._quality.rate_fault(self._stream),
            )
            sample = next((fault_sample(*cause) for cause in causes if cause.code), sample)
        return sample._replace(counter=self._stream.number, stamp_ns=now_ns)

    def _classify_break(self, record: RdtRecord, now_ns: int, *, is_new: bool) -> None:
        """Classify the first record of a new stream; store the newest one."""
        last, asked = self._last, self._asked
        if self._continues(record):
            asked = None  # the stream resumed by itself, independent of the request
        if last is not None and (asked is not None or is_new):
            asked_ns, unanswered = asked or (0, 0)
            at_once = unanswered == 1 and now_ns - asked_ns <= AT_ONCE_S * NS_PER_S
            fault = meaning_of_break(
                last,
                record,
                silent_s=(now_ns - self._last_ns) / NS_PER_S,
                ft_step=self._ft_step,
                at_once=at_once,
            )
            if fault.code:
                self._hold_fault(fault, now_ns)
        elif last is not None and signed(record.rdt_sequence - last.rdt_sequence) == 1:
            self._ft_step = max(signed(record.ft_sequence - last.ft_sequence), 0) or self._ft_step
        self._asked = None
        if self._stream.newest is record:
            self._last, self._last_ns = record, now_ns

    def _continues(self, record: RdtRecord) -> bool:
        """Return whether a record continues the stream received last."""
        return self._last is not None and continues(self._last, record, self._ft_step)

    def _hold_fault(self, fault: SensorFault, now_ns: int) -> None:
        self._held_fault, self._held_until_ns = fault, now_ns + round(FAULT_HOLD_S * NS_PER_S)
        is_theft = fault.code == "sensor_stolen"
        self._counts["thefts" if is_theft else "sensor_restarts"] += 1
        if self._page is not None and not is_theft:
            self._page.clear()
            self._scale = self._read = None

    # --- its page ---------------------------------------------------------------------------------

    def _calibrate(self, now_ns: int) -> None:
        """Take the page's counts, also changed ones, or set the fault."""
        if self._page is None:
            return
        page = self._page.poll(now_ns)
        if page is None:
            self._page_fault = SensorFault("sensor_calibration", f"its page: {self._page.fault}")
            return
        if page != self._read:
            if self._read is not None:
                text = (
                    f"its page has changed while it streamed, to {page.counts_per_N:.6g} counts "
                    f"per N (in {page.force_unit}) and {page.counts_per_Nm:.6g} per N m "
                    f"(in {page.torque_unit})"
                )
                self._held_fault = SensorFault("sensor_calibration", text)
                self._held_until_ns = now_ns + round(FAULT_HOLD_S * NS_PER_S)
                self._counts["page_changes"] += 1
            is_source = self._sensor.calibration == "page"
            self._read, self._scale = page, scale_of(self._sensor, page if is_source else None)
        self._page_fault = disagreement(self._sensor, page)
        age_s = (now_ns - self._page.verified_ns) / NS_PER_S
        if age_s > UNVERIFIED_AFTER_S and not self._page_fault.code:
            text = f"its units were last verified {age_s:.0f} s ago, {UNVERIFIED_AFTER_S:g} s are"
            text += f" allowed: its page: {self._page.fault}"
            self._page_fault = SensorFault("sensor_calibration", text)


def rdt_driver(sensor: SensorSection, *, stale_after_s: float) -> RdtDriver:
    """Return the driver of a cell file, with real sockets."""
    # Requested again before the topic is stale: the reason is known by then.
    link = UdpLink(sensor.address, sensor.port, ask_after_s=0.5 * stale_after_s)
    reads_page = sensor.calibration != "cell"
    page = PageFetch(sensor.address, sensor.page_port) if reads_page else None
    return RdtDriver(sensor, link, page, stale_after_s=stale_after_s)
