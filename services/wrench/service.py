"""Wrench service: gravity-compensated wrench at the TCP from sensor readings and robot poses."""

from collections.abc import Callable
from dataclasses import dataclass
from math import ceil
from typing import Any

import pinocchio as pin

from common.config.cell import CellConfig
from common.motion.convert import pose_of
from forcemesh import topics
from forcemesh.bus import LONGEST_FAULT, Bus, Inbox, Origin, Reading
from forcemesh.clock import NS_PER_S
from forcemesh.codec import Header
from forcemesh.faults import clipped, input_trip, tripped
from forcemesh.messages import ZERO3, RobotState, SensorWrench, Trip, WrenchAtTcp
from forcemesh.requests import Reply
from services.wrench.calibration_manager import CalibrationManager, RequestContext
from services.wrench.compensation import AccelerationEstimator, Filter, ReportedPosition, Wrench
from services.wrench.plausibility import ReadingCheck, ReadingLimits


@dataclass(slots=True)
class Pairing:
    """Sequence numbers of the newest sample and the newest pose, with their time offset."""

    sensor: int = 0
    robot: int = 0
    apart_s: float = 0.0  # how much older the one received last was

    def update(self, sensor: Header | None, robot: Header | None) -> None:
        """Set the time that a new message lies behind the other one.

        Only received messages are compared: a missing one is reported as silent, not as late.
        Clocks of two hosts are not compared.
        """
        if sensor is None or robot is None or sensor.boot != robot.boot:
            return
        newer_s = (sensor.stamp_ns - robot.stamp_ns) / NS_PER_S
        is_sensor_new, is_robot_new = sensor.seq != self.sensor, robot.seq != self.robot
        if is_sensor_new and is_robot_new:
            self.apart_s = abs(newer_s)
        elif is_sensor_new or is_robot_new:
            self.apart_s = newer_s if is_robot_new else -newer_s
        self.sensor, self.robot = sensor.seq, robot.seq


class WrenchService:
    """Service that filters every sensor sample and publishes the wrench at the control rate."""

    def __init__(self, bus: Bus, cell: CellConfig) -> None:
        """Create readers, publisher and inboxes; take mounting and payload from the cell."""
        self.period_s = 1.0 / cell.rates.control_hz
        self.fault = ""
        self._cell = cell
        self._manager = CalibrationManager(cell, bus.clock.now_ns())
        self._check = ReadingCheck(ReadingLimits.of(cell))
        self._filter = Filter(cell.filter.median, cell.filter.lowpass_s)
        self._acceleration = AccelerationEstimator(cell) if cell.filter.inertial else None
        self._pairing = Pairing()
        # Largest time offset between wrench and pose: two periods of the slower one, or half of
        # the sensor's deadline, if the cell file makes that longer.
        slower_s = 1.0 / min(cell.rates.robot_hz, cell.rates.sensor_hz)
        deadline_s = cell.stale_after_s(topics.SENSOR_WRENCH)
        self._apart_max_s = max(2.0 * slower_s, 0.5 * deadline_s)
        self._fault: Trip | None = None
        self._fault_until_ns = 0
        # A fault is published for this long: a reader that misses it finds the topic stale.
        self._fault_hold_ns = round(cell.stale_after_s(topics.WRENCH) * NS_PER_S)
        self._last_stamp_ns = 0
        self._next_put_ns = 0
        # Half a sensor period early is on time: samples and periods are not aligned.
        self._put_after_ns = round((self.period_s - 0.5 / cell.rates.sensor_hz) * NS_PER_S)
        self._report: RobotState | None = None  # the last one without a fault
        self._T_base_flange: pin.SE3 | None = None  # of this report, None without an orientation
        samples = ceil(cell.rates.sensor_hz / cell.rates.control_hz)  # of a period
        self._sensor = bus.reader(topics.SENSOR_WRENCH, room=samples)
        self._robot = bus.reader(topics.ROBOT_STATE)
        self._target = bus.reader(topics.REGULATOR_TARGET)
        self._contact = bus.reader(topics.CONTACT)
        self._out = bus.publisher(topics.WRENCH)
        self._requests: tuple[tuple[Inbox[Any], Callable[[RequestContext, Any], Reply]], ...] = (
            (bus.inbox(topics.TARE), self._manager.tare),
            (bus.inbox(topics.CALIBRATE), self._manager.calibrate),
            (bus.inbox(topics.AXES), self._manager.axes_checked),
        )
        self.trigger = self._sensor

    def counters(self) -> dict[str, int]:
        """Return the samples that the reader dropped and the rejected spikes."""
        counters = self._sensor.counters
        return {
            "sensor_superseded": counters.superseded,
            "sensor_repeated": counters.repeated,
            "sensor_spikes": self._check.spikes,
        }

    def numbers(self, now_ns: int) -> dict[str, float]:
        """Return the delay of the filter [s] and the age of the last tare [h]."""
        age_h = (now_ns - self._manager.zero_since_ns) / NS_PER_S / 3600.0
        return {"filter_delay_s": self._cell.plant.filter_delay_s, "tare_age_h": age_h}

    def step(self, now_ns: int) -> None:
        """Filter the samples since the last step; publish at the control rate, a fault at once."""
        robot = self._robot.read(now_ns)
        if robot.fresh is not self._report:  # each report is converted once
            self._report = robot.fresh
            self._T_base_flange = None if self._report is None else pose_of(self._report)
        was_valid = self._fault is None
        for sensor in self._sensor.readings(now_ns):
            self._filter_one(sensor, robot, now_ns)
        for inbox, answer in self._requests:
            for each in inbox.take_all():
                target = self._target.read(now_ns).fresh
                context = RequestContext(
                    now_ns,
                    self._fault,
                    self._T_base_flange,
                    moving=self._report is not None and self._report.status.moving,
                    feedback_runs=target is not None and target.valid,
                    contact=self._contact.read(now_ns).fresh,
                )
                each.reply(answer(context, each.request))
        if now_ns >= self._next_put_ns or (was_valid and self._fault is not None):
            self._next_put_ns = now_ns + self._put_after_ns
            self._put(sensor)

    def _filter_one(
        self, sensor: Reading[SensorWrench], robot: Reading[RobotState], now_ns: int
    ) -> None:
        """Filter a sample, and update the fault, which is held until every reader has it."""
        fault = self._take(sensor, robot.header)
        no_pose = self._T_base_flange is None or self._pairing.apart_s > self._apart_max_s
        if fault is None and no_pose:
            fault = self._pose_fault(robot)
        if fault is not None:
            waited_for = "missing" in (sensor.code, fault.code)
            self._fault_until_ns = now_ns + (0 if waited_for else self._fault_hold_ns)
        if fault is not None or now_ns >= self._fault_until_ns:
            self._fault, self.fault = fault, "" if fault is None else fault.text

    def _take(self, sensor: Reading[SensorWrench], robot: Header | None) -> Trip | None:
        """Filter a new, valid sample; reset the filter after a gap or a fault."""
        sample, header, T = sensor.fresh, sensor.header, self._T_base_flange
        if sample is not None and header is not None and sample.status == "ok":
            stamp_ns = header.stamp_ns
            if stamp_ns == self._last_stamp_ns:
                return None
            dt_s = max(stamp_ns - self._last_stamp_ns, 0) / NS_PER_S if self._last_stamp_ns else 0.0
            self._last_stamp_ns = stamp_ns
            reading = sample.force_N + sample.torque_Nm
            fault = self._check.fault_of(reading, dt_s)
            if self._check.accepted:
                self._filter.feed(reading, dt_s)
                if T is not None:
                    self._manager.recent.append((reading, T))
        else:
            fault = sensor_fault(sensor)
            self._check.clear()
        if fault is not None:
            self._filter.clear()
            self._manager.recent.clear()
        self._pairing.update(header, robot)
        if self._acceleration is not None:
            report = None
            if robot is not None and T is not None:
                p_com_m = T.act(self._manager.compensation.p_flange_com_in_flange)
                report = ReportedPosition(robot.epoch, robot.seq, robot.stamp_ns, p_com_m)
            self._acceleration.update(report)
        return fault

    def _pose_fault(self, robot: Reading[RobotState]) -> Trip:
        if self._report is None:
            return input_trip(robot.code, robot.fault)
        apart_ms, limit_ms = self._pairing.apart_s * 1e3, self._apart_max_s * 1e3
        text = f"wrench and pose are {apart_ms:.0f} ms apart, the limit is {limit_ms:.0f} ms"
        return tripped(
            "misaligned", text, value=self._pairing.apart_s, limit=self._apart_max_s, unit="s"
        )

    def _put(self, sensor: Reading[SensorWrench]) -> None:
        filtered, sample, T_base_flange = self._filter.output, sensor.fresh, self._T_base_flange
        if self._fault or filtered is None or T_base_flange is None or sample is None:
            why = self._fault or tripped("not_ready", "no sample yet")
            self._out.put(WrenchAtTcp(valid=False, reason=why.text, code=why.code), sensor.origin)
            return
        calibration = self._manager.in_use
        fx, fy, fz, mx, my, mz = filtered
        at_tcp_in_base = self._manager.compensation.at_tcp(
            Wrench((fx, fy, fz), (mx, my, mz)),
            T_base_flange,
            ZERO3 if self._acceleration is None else self._acceleration.now(),
        )
        calibration_fault = calibration.fault(sample.serial)
        message = WrenchAtTcp(
            force_N=at_tcp_in_base.force_N,
            torque_Nm=at_tcp_in_base.torque_Nm,
            raw_force_N=sample.force_N,
            raw_torque_Nm=sample.torque_Nm,
            calibration=calibration.origin,
            tared=calibration.tared,
            calibrated=not calibration_fault,
            calibration_fault=calibration_fault,
            axes_checked=calibration.axes_checked,
            torques_checked=calibration.torques_checked,
            mounting_rotation_rad=calibration.payload.mounting_rotation_rad,
        )
        header = sensor.header
        self._out.put(message, None if header is None else Origin(header.stamp_ns, header.seq))


def sensor_fault(sensor: Reading[SensorWrench]) -> Trip:
    """Return the fault that the sensor topic reports, before its numbers are checked."""
    if sensor.silent:
        return input_trip("sensor_silent", sensor.fault)
    sample = sensor.message
    if sample is not None and sample.status != "ok" and sensor.code in ("", "invalid"):
        code = "sensor_saturated" if sample.status == "saturated" else "sensor_fault"
        reason = f": {sample.reason}" if sample.reason else ""
        return tripped(code, clipped(f"the sensor reports {sample.status}{reason}", LONGEST_FAULT))
    return input_trip("sensor_fault" if sensor.code == "invalid" else sensor.code, sensor.fault)
