"""Reader of sensor samples while the arm is at rest: each sample once, valid ones only."""

from collections.abc import Callable

import numpy as np
import pinocchio as pin

from common.bus.configured_cell import ConfiguredCell
from common.motion.convert import pose_of
from common.motion.frames import Array
from forcemesh import topics
from forcemesh.clock import NS_PER_S, wait_until
from forcemesh.errors import ForcemeshError
from identification.dwells import Dwell, Purpose
from identification.errors import CalibrationError
from identification.excitation.stillness import PoseSample, StillnessDetector

READINGS_POLL_S = 0.001
STILL_WITHIN_S = 10.0
JUDGE_EVERY_NS = 50_000_000  # period of the rest check
READINGS_WITHIN_S = 2.0
LEAST_READINGS = 10
ATTEMPTS = 2

Watch = Callable[[str], None]  # receives the awaited condition; raises when the arm was stopped


class ReadingLostError(ForcemeshError):
    """Sensor or robot data was missing or invalid."""


class Gatherer:
    """Subscriber to sensor, robot state and wrench, with a rest detector."""

    def __init__(self, cell: ConfiguredCell) -> None:
        """Subscribe."""
        self._cell, self._clock = cell, cell.session.clock
        self._started_ns = self._clock.now_ns()
        self._wrench = cell.session.bus.reader(topics.WRENCH)
        self._T_flange_sensor: pin.SE3 = cell.config.sensor.T_flange_sensor.pose
        self._T_flange_tcp: pin.SE3 = cell.config.tool.T_flange_tcp.pose
        self._last_sample = (0, 0)  # epoch and number of the last sample
        self.stillness = StillnessDetector()
        self.serial = ""  # of the sensor
        self.active_calibration = ""  # the calibration that the running cell uses

    def take(self) -> PoseSample | None:
        """Return the newest sample when it is new, else None.

        Raises ReadingLostError while sensor or robot data is missing or invalid.
        """
        sensor, robot = self._cell.sensor.reading(), self._cell.state.reading()
        if fault := sensor.fault or robot.fault:
            self.stillness.clear()
            raise ReadingLostError(fault)
        message, header, state = sensor.fresh, sensor.header, robot.fresh
        if message is None or header is None or state is None:
            return None
        if (header.epoch, header.seq) == self._last_sample:
            return None
        self._last_sample = (header.epoch, header.seq)
        self.serial = message.serial or self.serial
        T = pose_of(state) * self._T_flange_sensor
        sample = PoseSample(
            header.stamp_ns,
            np.array(T.translation),
            np.array(T.rotation),
            np.array(message.force_N + message.torque_Nm),
        )
        self.stillness.add(sample)
        return sample

    def until_received(self) -> None:
        """Wait for the first valid sample. Raises CalibrationError when none is received."""
        reason = ""

        def is_received() -> bool:
            nonlocal reason
            try:
                return self.take() is not None
            except ReadingLostError as error:
                reason = str(error)
                return False

        if not wait_until(
            self._clock, is_received, within_s=READINGS_WITHIN_S, poll_s=READINGS_POLL_S
        ):
            raise CalibrationError(f"no reading within {READINGS_WITHIN_S:g} s: {reason}")

    def dwell(self, purpose: Purpose, dwell_s: float, watch: Watch) -> Dwell:
        """Wait for rest, then read for dwell_s; repeat once when a reading is lost.

        Raises CalibrationError, with the awaited condition, when it does not come to rest.
        """
        for attempt in range(1, ATTEMPTS + 1):
            try:
                self._wait_for_rest(watch)
                return self._read_dwell(purpose, dwell_s, watch)
            except ReadingLostError as error:
                watch("the sensor")
                if attempt == ATTEMPTS:
                    raise CalibrationError(f"the reading failed twice: {error}") from error
                self.until_received()
        raise AssertionError  # the last attempt returns or raises

    def _wait_for_rest(self, watch: Watch) -> None:
        self.stillness.clear()
        give_up_ns = self._clock.now_ns() + round(STILL_WITHIN_S * NS_PER_S)
        waits_for, judged_ns = "readings", 0
        while self._clock.now_ns() < give_up_ns:
            self._clock.sleep_s(READINGS_POLL_S)
            watch(f"waiting for {waits_for}")
            if self.take() is None or self._clock.now_ns() - judged_ns < JUDGE_EVERY_NS:
                continue
            judged_ns = self._clock.now_ns()
            waits_for = self.stillness.pending_condition()
            if not waits_for:
                return
        raise CalibrationError(f"after {STILL_WITHIN_S:g} s still waiting for {waits_for}")

    def _read_dwell(self, purpose: Purpose, dwell_s: float, watch: Watch) -> Dwell:
        samples: list[PoseSample] = []
        residuals: list[Array] = []  # of the running cell, about the sensor's origin
        end_ns = self._clock.now_ns() + round(dwell_s * NS_PER_S)
        while self._clock.now_ns() < end_ns:
            self._clock.sleep_s(READINGS_POLL_S)
            watch("reading")
            sample = self.take()
            if sample is not None:
                samples.append(sample)
                self._add_wrench(residuals, sample)
        condition = self.stillness.pending_condition()
        if condition and condition != "readings":
            raise ReadingLostError(f"not at rest while reading: waiting for {condition}")
        if len(samples) < LEAST_READINGS:
            raise ReadingLostError(f"only {len(samples)} readings in {dwell_s:g} s")
        readings = np.array([sample.reading for sample in samples])
        at_ns = np.array([sample.at_ns - self._started_ns for sample in samples])
        return Dwell(
            purpose,
            at_ns / NS_PER_S,
            np.array([sample.position_m for sample in samples]),
            np.array([sample.R_base_sensor for sample in samples]),
            readings[:, :3],
            readings[:, 3:],
            *(np.split(np.mean(residuals, axis=0), 2) if residuals else (None, None)),
        )

    def _add_wrench(self, residuals: list[Array], sample: PoseSample) -> None:
        """Add the published wrench, shape (6,), with its torque moved to the sensor's origin."""
        if not self._wrench.poll():
            return
        wrench = self._wrench.read(self._clock.now_ns()).fresh
        if wrench is None:
            return
        self.active_calibration = wrench.calibration
        p_tcp_m = (self._T_flange_sensor.inverse() * self._T_flange_tcp).translation
        lever = np.cross(sample.R_base_sensor @ p_tcp_m, wrench.force_N)
        residuals.append(np.concatenate((wrench.force_N, np.array(wrench.torque_Nm) + lever)))
