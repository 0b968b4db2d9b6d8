"""Settings of the simulated arm: section `sim` of a cell file, and what it leaves out."""

import math

import numpy as np
import pinocchio as pin
from pydantic import ConfigDict, Field, ValidationInfo, field_validator

from common.config.arm import USUAL_ARM, JointAngles, read_arm
from common.config.cell import CellConfig
from common.config.cell_sim import SimSection
from common.config.payload import DOWN, Direction
from common.motion.frames import Array
from forcemesh.errors import SimulationError

TICK_S = 0.001  # of physics and set-point generator; dead time and smoothing are whole ticks
PLATE_CORNER_M = 0.025  # the plate rests on four springs at (+-25, +-25) mm
PLATE_DAMPING_RATIO = 0.4  # for a mass of DAMPED_MASS_KG; the plate has no mass
DAMPED_MASS_KG = 0.3
FRICTION = 0.3  # of the disc on the plate
HOUSING_MASS_KG = 0.3  # sensor part on the flange side: not measured by the sensor


def _mount(z_m: float, turn_deg: float) -> pin.SE3:
    return pin.SE3(pin.utils.rotate("z", math.radians(turn_deg)), np.array([0.0, 0.0, z_m]))


class SimSettings(SimSection):
    """Section `sim`, with the values that other sections hold or that no cell file changes."""

    model_config = ConfigDict(arbitrary_types_allowed=True)

    arm: str = USUAL_ARM  # its folder in arms/
    home_deg: JointAngles = read_arm(USUAL_ARM).home_deg
    servo_lag_s: float = Field(0.0072, ge=0.004, le=0.1)  # kv / kp; 0.024 for a slow robot
    gravity_direction_in_base: Direction = DOWN
    T_flange_sensor: pin.SE3 = Field(default_factory=lambda: _mount(0.040, 30.0))
    T_sensor_tcp: pin.SE3 = Field(default_factory=lambda: _mount(0.120, 0.0))
    force_range_N: float = 500.0  # per axis; beyond it the sample's status is "saturated"
    torque_range_Nm: float = 20.0

    @classmethod
    def of(cls, cell: CellConfig) -> "SimSettings":
        """Return the settings of a cell. Raises SimulationError without a section `sim`."""
        if cell.sim is None:
            raise SimulationError("the cell file has no section `sim`")
        sensor, T_flange_sensor = cell.sensor, cell.sensor.T_flange_sensor.pose
        return cls(
            **cell.sim.model_dump(),
            arm=cell.robot.model,
            home_deg=read_arm(cell.robot.model).home_deg,
            gravity_direction_in_base=cell.gravity_direction_in_base,
            T_flange_sensor=T_flange_sensor,
            T_sensor_tcp=T_flange_sensor.inverse() * cell.tool.T_flange_tcp.pose,
            force_range_N=sensor.force_range_N,
            torque_range_Nm=sensor.torque_range_Nm,
        )

    @field_validator("delay_s", "smoothing_s")
    @classmethod
    def _is_whole_ticks(cls, value: float, info: ValidationInfo) -> float:
        if abs(value - round(value / TICK_S) * TICK_S) > 1e-9:
            raise SimulationError(
                f"simulated cell: {info.field_name} is {value:g}, "
                "must be a whole number of milliseconds"
            )
        return value

    @property
    def home_rad(self) -> Array:
        """Home joint angles [rad]. Shape (n,)."""
        return np.asarray(np.radians(self.home_deg))

    @property
    def T_flange_tcp(self) -> pin.SE3:
        """Centre of the disc's face, z out of the tool."""
        return self.T_flange_sensor * self.T_sensor_tcp

    @property
    def plate_tilt_stiffness_Nm_rad(self) -> float:
        """Rotational stiffness of the plate about either axis in its plane [Nm/rad]."""
        if self.tilt_stiffness_Nm_rad is not None:
            return self.tilt_stiffness_Nm_rad
        return self.stiffness_N_m * PLATE_CORNER_M**2

    @property
    def plate_relaxation_s(self) -> float:
        """Damping over stiffness of the plate's springs: 3 ms at 2e4 N/m."""
        return 2.0 * PLATE_DAMPING_RATIO * math.sqrt(DAMPED_MASS_KG / self.stiffness_N_m)

    @property
    def delay_ticks(self) -> int:
        """Dead time in whole ticks."""
        return round(self.delay_s / TICK_S)

    @property
    def smoothing_ticks(self) -> int:
        """Length of the moving average in whole ticks, at least one."""
        return round(self.smoothing_s / TICK_S)
