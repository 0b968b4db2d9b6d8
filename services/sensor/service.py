"""Sensor service: samples of a sensor driver in, `sensor/wrench` out."""

import sys

from common.config.cell import CellConfig
from forcemesh import topics
from forcemesh.bus import LONGEST_FAULT, Bus
from forcemesh.clock import NS_PER_S
from forcemesh.messages import SensorWrench
from services.sensor.driver import (
    SensorInterface,
    SensorSample,
    fault_sample,
    refused_unless_finite,
)
from services.sensor.driver_registry import driver_of

LONGEST_STEP_S = 0.001  # longest time that a record waits in the socket
STEPS_PER_SAMPLE = 2  # with fewer, two samples arrive at once and the first is superseded
SEVERITY = {"ok": 0, "saturated": 1, "fault": 2}
RATE_WINDOW_NS = 250_000_000  # window in which the sensor's rate is measured
DECIMATION_MARGIN = 2.05  # times the cell's rate: twice, plus tolerance of clocks and measurement


class Decimation:
    """Selection of the samples to publish when the sensor is faster than needed.

    Up to twice the wanted rate every sample is kept, above it every n-th, counted by the sensor's
    sequence numbers: bursts on the network do not change the selection, and the next sample
    replaces a lost one.
    """

    def __init__(self, output_hz: float) -> None:
        """Keep every sample until the rate of the sensor is measured."""
        self._output_hz = output_hz
        self.rate_hz = 0.0  # 0 until measured
        self.keep_every = 1
        self._kept = 0  # number of the last sample kept
        self._since: tuple[int, int] | None = (
            None  # number and time [ns] at the measurement's start
        )

    def pause(self) -> None:
        """Restart the measurement after a gap; keep the ratio until it is done."""
        self._since = None

    def keeps(self, number: int, now_ns: int) -> bool:
        """Return whether to keep a sample."""
        first, since_ns = self._since or (number, now_ns)
        if now_ns - since_ns >= RATE_WINDOW_NS:
            self.rate_hz = 1e9 * (number - first) / (now_ns - since_ns)
            ratio = self.rate_hz / self._output_hz
            self.keep_every = 1 if ratio <= DECIMATION_MARGIN else round(ratio)
            first, since_ns = number, now_ns
        self._since = (first, since_ns)
        if number - self._kept < self.keep_every:
            return False
        self._kept = number
        return True


class SensorDriver:
    """Service that publishes every sample on reception, and a fault at its rate without samples."""

    def __init__(self, bus: Bus, cell: CellConfig, driver: SensorInterface | None = None) -> None:
        """Create the publisher; `driver` replaces the one that the cell file names."""
        self.period_s = min(LONGEST_STEP_S, 1.0 / (STEPS_PER_SAMPLE * cell.rates.sensor_hz))
        self.trigger = None
        self.fault = "no sample yet"
        stale_after_s = cell.stale_after_s(topics.SENSOR_WRENCH)
        self._driver = driver or driver_of(cell, stale_after_s=stale_after_s)
        self._decimation = Decimation(cell.rates.sensor_hz)
        self._worst: SensorSample | None = None  # sample since the last one published
        self._stale_after_ns = round(stale_after_s * NS_PER_S)
        self._period_ns = round(NS_PER_S / cell.rates.sensor_hz)
        self._sampled_ns = bus.clock.now_ns()
        self._counter = 0
        self._fault_due_ns = 0
        self._about, self._serial = "", ""
        self._published = self._thinned = 0
        self._out = bus.publisher(topics.SENSOR_WRENCH)

    def counters(self) -> dict[str, int]:
        """Return counts of received, lost and dropped samples, by cause."""
        return {
            **self._driver.counters(),
            "published": self._published,
            "thinned": self._thinned,
            "sensor_hz": round(self._decimation.rate_hz),
            "keep_every": self._decimation.keep_every,
        }

    def close(self) -> None:
        """Stop the sensor's stream."""
        self._driver.close()

    def step(self, now_ns: int) -> None:
        """Publish every received sample; publish a fault while there is none."""
        for sample in self._driver.read(now_ns):
            self._take(refused_unless_finite(sample), now_ns)
        silent_ns = now_ns - self._sampled_ns
        is_silent = silent_ns > self._stale_after_ns or self._counter == 0
        if is_silent and now_ns >= self._fault_due_ns:
            if now_ns - self._fault_due_ns > self._period_ns:
                self._fault_due_ns = now_ns  # missed periods are not made up for
            self._fault_due_ns += self._period_ns
            code, text = self._driver.silence_fault()
            self._put(fault_sample(code, f"no sample for {silent_ns / 1e6:.0f} ms, {text}"))

    def _take(self, sample: SensorSample, now_ns: int) -> None:
        """Publish or drop a sample; a fault in a dropped one is published with the next."""
        silent = now_ns - self._sampled_ns > self._stale_after_ns // 2
        if silent:
            self._decimation.pause()
        if silent or not self._about:  # the sensor's page may arrive after its first samples
            self._introduce()
        self._sampled_ns, self._counter = now_ns, sample.counter
        if self._worst is None or SEVERITY[sample.status] >= SEVERITY[self._worst.status]:
            self._worst = sample
        if self._decimation.keeps(sample.counter, now_ns):
            worst, self._worst = self._worst, None
            self._put(sample if worst.status == "ok" else worst)
        else:
            self._thinned += 1

    def _put(self, sample: SensorSample) -> None:
        self.fault = sample.reason[:LONGEST_FAULT]
        self._published += 1
        self._out.put(
            SensorWrench(
                valid=sample.status == "ok",
                reason=self.fault,
                code=sample.code,
                force_N=sample.force_N,
                torque_Nm=sample.torque_Nm,
                status=sample.status,
                counter=self._counter,
                serial=self._serial,
            )
        )

    def _introduce(self) -> None:
        """Log the identity of the sensor, at the start and when it has changed."""
        info = self._driver.info()
        if info is None or str(info) == self._about:
            return
        self._about, self._serial = str(info), info.serial
        sys.stderr.write(f"{self._driver.where}: {info}\n")
