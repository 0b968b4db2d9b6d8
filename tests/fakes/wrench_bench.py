"""The wrench service on an in-memory bus, between a robot and a sensor that tests can change."""

import numpy as np
import pinocchio as pin

from common.config.cell import CellConfig
from common.motion.convert import record_of
from common.motion.frames import Oat, R_from_oat
from common.motion.weight import predict
from forcemesh import topics
from forcemesh.messages import RobotState, RobotStatus, SensorWrench, WrenchAtTcp
from services.wrench.service import WrenchService
from tests.fakes.bench import CELL, Bench

SENSOR_S = 1.0 / CELL.rates.sensor_hz
# An ideal sensor has no noise, so it may repeat itself.
IDEAL = CELL.model_copy(update={"sensor": CELL.sensor.model_copy(update={"frozen_s": 0.0})})
REPORT_S = CELL.stale_after_s(topics.WRENCH)  # duration of a fault's report
DOWN = R_from_oat(Oat(0.0, np.pi, 0.0))
BIAS_N, BIAS_NM = np.array(CELL.payload.bias_force_N), np.array(CELL.payload.bias_torque_Nm)
T_FLANGE_TCP, T_FLANGE_SENSOR = CELL.tool.T_flange_tcp.pose, CELL.sensor.T_flange_sensor.pose


class WrenchBench(Bench):
    """The service between a robot and a sensor that tests can silence or change."""

    def __init__(self, cell: CellConfig = IDEAL) -> None:
        """Start with a tool that hangs free, pointing down."""
        super().__init__("wrench", WrenchService, cell, step_s=SENSOR_S)
        self.R_base_flange, self.p_m = DOWN, np.array([0.0, 0.5, 0.35])
        self.force_N, self.torque_Nm = np.zeros(3), np.zeros(3)  # environment, base, at the TCP
        self.status = RobotStatus()
        self.sensor: dict[str, object] = {}  # fields to publish instead of the true ones
        self.silent: set[str] = set()
        self.before_step = self._publish_all
        self.out = self.watch(topics.WRENCH)

    def _publish_all(self) -> None:
        if "robot" not in self.silent:
            pose = record_of(pin.SE3(self.R_base_flange, self.p_m)).as_dict()
            self.put(topics.ROBOT_STATE, RobotState.from_dict({**pose, "status": self.status}))
        if "sensor" not in self.silent:
            self.put(topics.SENSOR_WRENCH, self.sample())

    def sample(self) -> SensorWrench:
        """Return the ideal reading: weight, environment and bias, in sensor axes."""
        R = self.R_base_flange @ T_FLANGE_SENSOR.rotation
        lever_m = T_FLANGE_TCP.translation - T_FLANGE_SENSOR.translation
        moment_Nm = np.cross(self.R_base_flange @ lever_m, self.force_N) + self.torque_Nm
        force_N, torque_Nm = predict(CELL.payload, R)
        truth = {
            "force_N": tuple((force_N + R.T @ self.force_N).tolist()),
            "torque_Nm": tuple((torque_Nm + R.T @ moment_Nm).tolist()),
        }
        return SensorWrench.from_dict(truth | self.sensor)

    def published(self) -> WrenchAtTcp:
        """Return the newest wrench."""
        message: WrenchAtTcp = self.newest(topics.WRENCH)
        return message

    def settle(self) -> WrenchAtTcp:
        """Advance until the filter has settled and old faults are reported."""
        self.pass_s(REPORT_S + 0.1)
        return self.published()
