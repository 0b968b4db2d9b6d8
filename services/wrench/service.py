"""Wrench service: gravity-compensated wrench at the TCP from sensor readings and robot poses."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from common.config.cell import CellConfig
from common.motion.convert import pose_of, vec3
from common.motion.frames import is_finite_pose
from forcemesh import topics
from forcemesh.bus import LONGEST_FAULT, Bus, Inbox, Origin, Reading
from forcemesh.clock import NS_PER_S
from forcemesh.messages import RobotState, SensorWrench, WrenchAtTcp
from forcemesh.requests import Reply
from services.wrench.calibration_manager import CalibrationManager, RequestContext
from services.wrench.compensation import (
    AccelerationEstimator,
    Filter,
    Mounting,
    ReportedPose,
    Wrench,
    compensate,
    feed,
)
from services.wrench.plausibility import (
    NO_FAULT,
    ReadingHistory,
    ReadingLimits,
    WrenchFault,
    check_reading,
)


@dataclass(frozen=True, slots=True)
class Pairing:
    """Sequence numbers of the newest sample and the newest pose, with their time offset."""

    sensor: int = 0
    robot: int = 0
    apart_s: float = 0.0  # how much older the one received last was


class WrenchService:
    """Service that filters every sensor sample and publishes the wrench at the control rate."""

    def __init__(self, bus: Bus, cell: CellConfig) -> None:
        """Create readers, publisher and inboxes; take mounting and payload from the cell."""
        self.period_s = 1.0 / cell.rates.control_hz
        self.fault = ""
        self._cell = cell
        self._mounting = Mounting(cell.sensor.T_flange_sensor.pose, cell.tool.T_flange_tcp.pose)
        self._p_sensor_tcp_in_sensor = self._mounting.p_sensor_tcp_in_sensor
        self._manager = CalibrationManager(cell, self._mounting, bus.clock.now_ns())
        self._bounds, self._history = ReadingLimits.of(cell), ReadingHistory()
        self._pairing = Pairing()
        # Largest time offset between wrench and pose: two periods of the slower one, or half of
        # the sensor's deadline, if the cell file makes that longer.
        slower_s = 1.0 / min(cell.rates.robot_hz, cell.rates.sensor_hz)
        deadline_s = cell.stale_after_s(topics.SENSOR_WRENCH)
        self._apart_max_s = max(2.0 * slower_s, 0.5 * deadline_s)
        self._fault, self._fault_until_ns = NO_FAULT, 0
        # A fault is published for this long: a reader that misses it finds the topic stale.
        self._fault_hold_ns = round(cell.stale_after_s(topics.WRENCH) * NS_PER_S)
        self._empty_filter = Filter(cell.filter.median, cell.filter.lowpass_s)
        self._filter = self._empty_filter
        inertial = cell.filter.inertial
        self._acceleration = AccelerationEstimator(cell, self._mounting) if inertial else None
        self._last_stamp_ns = 0
        self._next_put_ns = 0
        self._sensor = bus.reader(topics.SENSOR_WRENCH)
        self._robot = bus.reader(topics.ROBOT_STATE)
        self._target = bus.reader(topics.REGULATOR_TARGET)
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
            "sensor_spikes": self._history.spikes,
        }

    def numbers(self, now_ns: int) -> dict[str, float]:
        """Return the delay of the filter [s] and the age of the last tare [h]."""
        age_h = (now_ns - self._manager.zero_since_ns) / NS_PER_S / 3600.0
        return {"filter_delay_s": self._cell.filter_delay_s, "tare_age_h": age_h}

    def step(self, now_ns: int) -> None:
        """Filter the newest sample; publish at the control rate, at once when a fault begins."""
        sensor, robot = self._sensor.read(now_ns), self._robot.read(now_ns)
        T_base_flange = None if robot.fresh is None else pose_of(robot.fresh)
        was_valid = self._fault == NO_FAULT
        fault = self._take(sensor, robot, T_base_flange)
        if fault == NO_FAULT:
            fault = self._pose_fault(robot, T_base_flange)
        if fault != NO_FAULT:  # it is held until every reader must have received it
            waited_for = fault.text.endswith(" missing")
            self._fault_until_ns = now_ns + (0 if waited_for else self._fault_hold_ns)
        if fault != NO_FAULT or now_ns >= self._fault_until_ns:
            self._fault, self.fault = fault, fault.text
        target = self._target.read(now_ns).fresh
        context = RequestContext(
            now_ns,
            self._fault,
            T_base_flange,
            moving=robot.fresh is not None and robot.fresh.status.moving,
            feedback_runs=target is not None and target.valid,
        )
        for inbox, answer in self._requests:
            for each in inbox.take_all():
                each.reply(answer(context, each.request))
        if now_ns >= self._next_put_ns or (was_valid and self._fault != NO_FAULT):
            # Half a sensor period early is on time: samples and periods are not aligned.
            slack_ns = round(0.5 / self._cell.rates.sensor_hz * NS_PER_S)
            self._next_put_ns = now_ns + round(self.period_s * NS_PER_S) - slack_ns
            self._put(sensor, T_base_flange)

    def _take(
        self,
        sensor: Reading[SensorWrench],
        robot: Reading[RobotState],
        T_base_flange: pin.SE3 | None,
    ) -> WrenchFault:
        """Filter a new, valid sample; reset the filter after a gap or a fault."""
        sample, header = sensor.fresh, sensor.header
        if sample is not None and header is not None and sample.status == "ok":
            stamp_ns = header.stamp_ns
            if stamp_ns == self._last_stamp_ns:
                return NO_FAULT
            dt_s = max(stamp_ns - self._last_stamp_ns, 0) / NS_PER_S if self._last_stamp_ns else 0.0
            self._last_stamp_ns = stamp_ns
            reading = np.array(sample.force_N + sample.torque_Nm)
            self._history, fault = check_reading(self._history, reading, dt_s, self._bounds)
            if self._history.counts:
                self._filter = feed(self._filter, reading, dt_s)
                if T_base_flange is not None:
                    self._manager.recent.append((reading, T_base_flange))
        else:
            fault = sensor_fault(sensor)
            self._history = ReadingHistory(spikes=self._history.spikes)
        if fault != NO_FAULT:
            self._filter = self._empty_filter
            self._manager.recent.clear()
        self._pairing = pair(self._pairing, sensor, robot)
        if self._acceleration is not None:
            report = None
            if T_base_flange is not None and robot.header is not None:
                now = robot.header
                report = ReportedPose(now.epoch, now.seq, now.stamp_ns, T_base_flange)
            self._acceleration.update(report, self._manager.in_use.payload)
        return fault

    def _pose_fault(self, robot: Reading[RobotState], T_base_flange: pin.SE3 | None) -> WrenchFault:
        if T_base_flange is None:
            return WrenchFault(robot.code, robot.fault)
        if not is_finite_pose(T_base_flange):
            return WrenchFault("invalid", "robot/state holds a quaternion of length zero")
        apart_s = self._pairing.apart_s
        if apart_s > self._apart_max_s:
            text = f"wrench and pose are {apart_s * 1e3:.0f} ms apart"
            return WrenchFault(
                "misaligned", f"{text}, the limit is {self._apart_max_s * 1e3:.0f} ms"
            )
        return NO_FAULT

    def _put(self, sensor: Reading[SensorWrench], T_base_flange: pin.SE3 | None) -> None:
        filtered = self._filter.output
        if self.fault or filtered is None or T_base_flange is None or sensor.fresh is None:
            why = self._fault if self.fault else WrenchFault("not_ready", "no sample yet")
            self._out.put(WrenchAtTcp(valid=False, reason=why.text, code=why.code), sensor.origin)
            return
        T_base_sensor = T_base_flange * self._mounting.T_flange_sensor
        at_tcp_in_base = compensate(
            Wrench(filtered[:3], filtered[3:]),
            R_base_sensor=np.asarray(T_base_sensor.rotation),
            p_sensor_tcp_in_sensor=self._p_sensor_tcp_in_sensor,
            payload=self._manager.in_use.payload,
            a_com_m_s2=None if self._acceleration is None else self._acceleration.now(),
        )
        calibration_fault = self._manager.in_use.fault(sensor.fresh.serial)
        message = WrenchAtTcp(
            force_N=vec3(at_tcp_in_base.force_N),
            torque_Nm=vec3(at_tcp_in_base.torque_Nm),
            raw_force_N=sensor.fresh.force_N,
            raw_torque_Nm=sensor.fresh.torque_Nm,
            calibration=self._manager.in_use.name,
            calibrated=not calibration_fault,
            calibration_fault=calibration_fault,
            axes_checked=self._manager.in_use.axes_checked,
        )
        header = sensor.header
        self._out.put(message, None if header is None else Origin(header.stamp_ns, header.seq))


def sensor_fault(sensor: Reading[SensorWrench]) -> WrenchFault:
    """Return the fault that the sensor topic reports, before its numbers are checked."""
    if sensor.silent:
        return WrenchFault("sensor_silent", sensor.fault)
    sample = sensor.message
    if sample is not None and sample.status != "ok" and sensor.code in ("", "invalid"):
        code = "sensor_saturated" if sample.status == "saturated" else "sensor_fault"
        reason = f": {sample.reason}" if sample.reason else ""
        return WrenchFault(code, f"the sensor reports {sample.status}{reason}"[:LONGEST_FAULT])
    return WrenchFault("sensor_fault" if sensor.code == "invalid" else sensor.code, sensor.fault)


def pair(before: Pairing, sensor: Reading[Any], robot: Reading[Any]) -> Pairing:
    """Return the pairing with the time that a new message lies behind the other one.

    Only received messages are compared: a missing one is reported as silent, not as late.
    Clocks of two hosts are not compared.
    """
    if sensor.header is None or robot.header is None or sensor.header.boot != robot.header.boot:
        return before
    newer_s = (sensor.header.stamp_ns - robot.header.stamp_ns) / NS_PER_S
    behind_s = []
    if sensor.header.seq != before.sensor:
        behind_s.append(-newer_s)
    if robot.header.seq != before.robot:
        behind_s.append(newer_s)
    apart_s = max(behind_s, default=before.apart_s)
    return Pairing(sensor.header.seq, robot.header.seq, apart_s)
