"""Driver for Bota Systems sensors, based on the maker's closed package `bota-driver`.

The settings of the sensor are in the maker's configuration file, which `sensor.device` names. The
package keeps the newest reading only: one that was not fetched in time shows as a gap between the
sensor's own stamps, and is counted as lost.
"""

from collections.abc import Sequence
from contextlib import suppress
from typing import Any, Protocol

from common.config.cell_sensor import SensorSection
from forcemesh.clock import NS_PER_S
from forcemesh.errors import ConfigError
from forcemesh.messages import Vec3
from services.sensor.driver import Info, LossWindow, SensorFault, SensorSample, fault_sample, judged

WRAP_US = 1 << 32  # of the sensor's stamps
GAP_PERIODS = 1.5
FAULT_HOLD_S = 0.25  # time for which a restart is reported


class BotaSource(Protocol):
    """Interface of the maker's driver, as far as it is used."""

    def read_frame(self) -> Any:
        """Return the newest reading without waiting; it may be a repeated one."""

    def get_expected_timestep_us(self) -> int:
        """Return the period of the readings [us]."""

    def deactivate(self) -> bool:
        """Stop the sensor."""

    def shutdown(self) -> bool:
        """Close the connection."""


class BotaDriver:
    """Driver that takes each reading once, by the sensor's own stamp."""

    def __init__(self, sensor: SensorSection, source: BotaSource) -> None:
        """Use an active source."""
        self._sensor, self._source = sensor, source
        self._step_us = max(1, int(source.get_expected_timestep_us()))
        self._counts = dict.fromkeys(("records", "lost", "sensor_restarts"), 0)
        self._number = 0
        self._last_us: int | None = None
        self._losses = LossWindow()
        self._fault_until_ns = 0
        self._fault = ""

    @property
    def where(self) -> str:
        """Return name and configuration of the sensor for messages."""
        return f"Bota sensor of {self._sensor.device}"

    def info(self) -> Info:
        """Return the identity of the sensor."""
        return Info(
            "Bota",
            self._sensor.force_range_N,
            self._sensor.torque_range_Nm,
            f"its own calibration, {1e6 / self._step_us:g} Hz",
        )

    def counters(self) -> dict[str, int]:
        """Return counts of received and lost readings."""
        return dict(self._counts)

    def silence_fault(self) -> SensorFault:
        """Return why no sample is received."""
        if self._fault or self._last_us is None:
            text = self._fault or "nothing received"
            return SensorFault("sensor_silent", f"{self.where}: {text}")
        return SensorFault("sensor_stalled", f"{self.where}: its stamp stays at {self._last_us} us")

    def close(self) -> None:
        """Stop the sensor and close its connection."""
        with suppress(RuntimeError):
            self._source.deactivate()
            self._source.shutdown()

    def read(self, now_ns: int) -> Sequence[SensorSample]:
        """Return the newest reading if it was not returned before."""
        try:
            frame = self._source.read_frame()
        except RuntimeError as error:
            self._fault = str(error)
            return []
        stamp_us = int(frame.timestamp)
        if stamp_us == self._last_us:
            return []
        self._fault = ""
        lost = self._count_lost(stamp_us, now_ns)
        self._last_us = stamp_us
        self._losses.add(lost)
        self._counts["records"] += 1
        self._counts["lost"] += lost
        self._number += 1 + lost
        return [self._sample(frame, now_ns)]

    def _count_lost(self, stamp_us: int, now_ns: int) -> int:
        """Return the number of readings between two stamps; a decreasing stamp is a restart."""
        if self._last_us is None:
            return 0
        passed_us = (stamp_us - self._last_us + WRAP_US // 2) % WRAP_US - WRAP_US // 2
        if passed_us < 0:
            self._counts["sensor_restarts"] += 1
            self._fault_until_ns = now_ns + round(FAULT_HOLD_S * NS_PER_S)
            return 0
        if passed_us <= GAP_PERIODS * self._step_us:
            return 0
        return round(passed_us / self._step_us) - 1

    def _sample(self, frame: Any, now_ns: int) -> SensorSample:
        """Return the sample of a reading, or its first fault."""
        fault = self._losses.fault()
        if frame.status.invalid:
            text = f"the sensor reports status 0x{frame.status.val:X}: invalid"
            fault = SensorFault("sensor_fault", text)
        elif now_ns < self._fault_until_ns:
            fault = SensorFault("sensor_restarted", "the sensor's stamps restarted")
        ranges = (self._sensor.force_range_N, self._sensor.torque_range_Nm)
        sample = fault_sample(*fault)
        if not fault.code:
            sample = judged(_vec3(frame.force), _vec3(frame.torque), *ranges)
        if frame.status.overrange and sample.status == "ok":
            text = "the sensor reports that it is beyond its range"
            sample = sample._replace(status="saturated", reason=text, code="sensor_saturated")
        return sample._replace(counter=self._number, stamp_ns=now_ns)


def _vec3(numbers: Sequence[float]) -> Vec3:
    x, y, z = (float(number) for number in numbers)
    return (x, y, z)


def bota_driver(sensor: SensorSection, *, stale_after_s: float) -> BotaDriver:  # noqa: ARG001 - judged by its stamps
    """Return the driver of a cell file, with the sensor active.

    Raises:
        ConfigError: The package is not installed, or the sensor did not start; gives the reason.
    """
    try:
        import bota_driver as maker  # noqa: PLC0415 - optional dependency of this sensor
    except ImportError as error:
        mistake = "sensor.driver: bota needs the maker's package: pip install bota-driver"
        raise ConfigError("the sensor's driver", [mistake]) from error
    try:
        source = maker.BotaDriver(sensor.device)
        started = source.configure() and source.activate()
    except (RuntimeError, ValueError) as error:
        raise ConfigError("the sensor's driver", [f"sensor.device: {error}"]) from error
    if not started:
        mistake = f"sensor.device: the sensor of {sensor.device} did not start: see output above"
        raise ConfigError("the sensor's driver", [mistake])
    return BotaDriver(sensor, source)
