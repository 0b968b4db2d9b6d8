"""The wrench service on the bus: sensor reading and robot pose in, wrench at the TCP out."""

from collections import deque

import numpy as np

from common import topics
from common.cell import Cell
from common.clock import NS_PER_S
from common.convert import pose_of, vec3
from common.endpoints import Bus, Origin, Reading
from common.faults import refusal
from common.frames import Array, is_finite_pose, rotation_between
from common.messages import Reply, RobotState, SensorWrench, WrenchAtTcp
from common.payload import Payload
from services.wrench.compensation import Mounting, Wrench, compensate
from services.wrench.smoothing import Filter, feed
from services.wrench.tare import TareLimits, tare

TARE_WINDOW_S = 0.25
REST_POSITION_M = 2e-4  # the flange moved less than this during the window: at rest
REST_TURN_RAD = 2e-3  # the same for its orientation: 2 g of a kilogram


class WrenchService:
    """Filters every sensor sample; publishes the environment's wrench at the control rate."""

    def __init__(self, bus: Bus, cell: Cell) -> None:
        """Take the topics of this role, the mounting and the payload of this cell."""
        self.period_s = 1.0 / cell.rates.control_hz
        self.fault = ""
        self._sensor_period_s = 1.0 / cell.rates.sensor_hz
        self._mounting = Mounting(cell.sensor.T_flange_sensor.pose, cell.tool.T_flange_tcp.pose)
        self._payload = Payload(**cell.payload.model_dump(exclude={"accept_uncalibrated"}))
        self._calibration = "cell file"
        self._range_N, self._range_Nm = cell.sensor.force_range_N, cell.sensor.torque_range_Nm
        self._tare_limits = TareLimits(cell.force.tare_max_N, cell.force.tare_max_Nm)
        self._empty_filter = Filter(cell.filter.median, cell.filter.lowpass_s)
        self._filter = self._empty_filter
        window = round(TARE_WINDOW_S * cell.rates.sensor_hz)
        self._recent: deque[tuple[Array, RobotState]] = deque(maxlen=window)
        self._last_stamp_ns = 0
        self._next_put_ns = 0
        self._sensor = bus.reader(topics.SENSOR_WRENCH)
        self._robot = bus.reader(topics.ROBOT_STATE)
        self._out = bus.publisher(topics.WRENCH)
        self._tares = bus.inbox(topics.TARE)
        self.trigger = self._sensor

    def counters(self) -> dict[str, int]:
        """Return what the sensor reader dropped."""
        counters = self._sensor.counters
        return {"sensor_superseded": counters.superseded, "sensor_repeated": counters.repeated}

    def step(self, now_ns: int) -> None:
        """Filter the newest sample; at the control rate, compensate and publish."""
        sensor, robot = self._sensor.read(now_ns), self._robot.read(now_ns)
        self._take(sensor, robot)
        for request in self._tares.take_all():
            request.reply(self._tare(sensor, robot))
        if now_ns >= self._next_put_ns:
            # Half a sensor period early is on time: samples and periods do not line up.
            slack_ns = round(0.5 * self._sensor_period_s * NS_PER_S)
            self._next_put_ns = now_ns + round(self.period_s * NS_PER_S) - slack_ns
            self._put(sensor, robot)

    def _take(self, sensor: Reading[SensorWrench], robot: Reading[RobotState]) -> None:
        """Feed a sample that is new and good; after a gap the filter starts anew."""
        if self._sensor_complaint(sensor) or sensor.message is None or sensor.header is None:
            self._filter = self._empty_filter
            self._recent.clear()
            return
        stamp_ns = sensor.header.stamp_ns
        if stamp_ns == self._last_stamp_ns:
            return
        dt_s = max(stamp_ns - self._last_stamp_ns, 0) / NS_PER_S
        self._last_stamp_ns = stamp_ns
        reading = np.array(sensor.message.force_N + sensor.message.torque_Nm)
        self._filter = feed(self._filter, reading, dt_s)
        if robot.fresh is not None:
            self._recent.append((reading, robot.fresh))

    def _put(self, sensor: Reading[SensorWrench], robot: Reading[RobotState]) -> None:
        self.fault = self._complaint(sensor, robot)
        filtered = self._filter.output
        if self.fault or filtered is None or robot.fresh is None or sensor.fresh is None:
            reason = self.fault or "no sample yet"
            self._out.put(WrenchAtTcp(valid=False, reason=reason), sensor.origin)
            return
        T_base_sensor = pose_of(robot.fresh) * self._mounting.T_flange_sensor
        at_tcp_in_base = compensate(
            Wrench(filtered[:3], filtered[3:]),
            R_base_sensor=np.asarray(T_base_sensor.rotation),
            p_sensor_tcp_in_sensor=self._mounting.p_sensor_tcp_in_sensor,
            payload=self._payload,
        )
        message = WrenchAtTcp(
            force_N=vec3(at_tcp_in_base.force_N),
            torque_Nm=vec3(at_tcp_in_base.torque_Nm),
            raw_force_N=sensor.fresh.force_N,
            raw_torque_Nm=sensor.fresh.torque_Nm,
            calibration=self._calibration,
        )
        header = sensor.header
        self._out.put(message, None if header is None else Origin(header.stamp_ns, header.seq))

    def _complaint(self, sensor: Reading[SensorWrench], robot: Reading[RobotState]) -> str:
        complaint = self._sensor_complaint(sensor) or robot.fault
        if complaint or robot.fresh is None or is_finite_pose(pose_of(robot.fresh)):
            return complaint
        return "robot/state holds a quaternion of length zero"

    def _sensor_complaint(self, sensor: Reading[SensorWrench]) -> str:
        """Say why a sample is no measurement: then it must not reach the filter either."""
        sample = sensor.fresh
        if sample is None:
            return sensor.fault
        if sample.status != "ok":
            return f"the sensor says {sample.status}"
        limits = (self._range_N, self._range_Nm)
        for vector, limit in zip((sample.force_N, sample.torque_Nm), limits, strict=True):
            if max(abs(number) for number in vector) > limit:
                return f"the sensor reads beyond its range of {limit:g}"
        return ""

    def _motion(self, robot: RobotState) -> Reply | None:
        """Refuse when the flange moved or turned during the window."""
        poses = [pose_of(state) for _, state in self._recent]
        moved_m = float(np.max(np.ptp([T.translation for T in poses], axis=0)))
        turns = [rotation_between(poses[-1].rotation, T.rotation) for T in poses]
        turned_rad = max(float(np.linalg.norm(turn)) for turn in turns)
        value, limit = moved_m, REST_POSITION_M
        if moved_m <= limit and turned_rad > REST_TURN_RAD:
            value, limit = turned_rad, REST_TURN_RAD
        if value <= limit and not robot.status.moving:
            return None
        text = (
            f"the arm moved {moved_m * 1e3:.2f} mm and turned {np.degrees(turned_rad):.2f} degrees "
            f"within {TARE_WINDOW_S:g} s: let it rest"
        )
        return refusal("moving", text, value=value, limit=limit)

    def _tare(self, sensor: Reading[SensorWrench], robot: Reading[RobotState]) -> Reply:
        fault = self._complaint(sensor, robot)
        if fault or robot.fresh is None:
            return refusal((sensor if sensor.fault else robot).code or "invalid", fault)
        if len(self._recent) < (self._recent.maxlen or 1):
            return refusal("wait", "not enough samples yet, ask again")
        motion = self._motion(robot.fresh)
        if motion is not None:
            return motion
        R = np.asarray((pose_of(robot.fresh) * self._mounting.T_flange_sensor).rotation)
        readings = [reading for reading, _ in self._recent]
        self._payload, reply = tare(self._payload, readings, R, self._tare_limits)
        if reply.accepted:
            self._calibration = "cell file, tared"
        return reply
