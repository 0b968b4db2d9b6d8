"""Settings of the simulated cell: frozen values, validated once, units in the names."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from forcemesh.errors import SimulationError

TICK_S = 0.001  # of physics and set-point generator; dead time and smoothing are whole ticks
DAMPED_MASS_KG = 0.3  # of the plate, for its damping alone
PLATE_CORNER_M = 0.025  # the plate rests on four springs at (+-25, +-25) mm

Vector3 = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class SensorSettings:
    """Error model of the force/torque sensor, in sensor axes."""

    force_noise_N: float = 0.1  # standard deviation of one sample
    torque_noise_Nm: float = 0.005
    force_bias_N: Vector3 = (1.5, -0.8, 2.0)  # a new sensor has an offset
    torque_bias_Nm: Vector3 = (0.02, -0.03, 0.01)
    force_step_N: float = 0.01  # quantisation; 0 switches it off
    torque_step_Nm: float = 0.0005
    force_range_N: float = 500.0  # per axis; beyond it the sample's status is "saturated"
    torque_range_Nm: float = 20.0

    def __post_init__(self) -> None:
        """Raise SimulationError naming every invalid field."""
        _refuse(
            _not_finite("force_bias_N", self.force_bias_N),
            _not_finite("torque_bias_Nm", self.torque_bias_Nm),
            _outside("force_noise_N", self.force_noise_N, 0.0, 100.0),
            _outside("torque_noise_Nm", self.torque_noise_Nm, 0.0, 10.0),
            _outside("force_step_N", self.force_step_N, 0.0, 10.0),
            _outside("torque_step_Nm", self.torque_step_Nm, 0.0, 1.0),
            _outside("force_range_N", self.force_range_N, 1.0, 1e5),
            _outside("torque_range_Nm", self.torque_range_Nm, 0.1, 1e4),
        )


def _default_T_flange_sensor() -> pin.SE3:
    return pin.SE3(pin.utils.rotate("z", math.radians(30.0)), np.array([0.0, 0.0, 0.040]))


def _default_T_sensor_tcp() -> pin.SE3:
    return pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.120]))


@dataclass(frozen=True, slots=True)
class SimSettings:
    """One simulated cell. All values are SI except two angles in degrees."""

    home_deg: tuple[float, ...] = (0.0, 0.0, -90.0, 0.0, -90.0, 0.0)  # exactly tool down, A = 180

    delay_s: float = 0.0  # dead time of the controller, from command to servo
    smoothing_s: float = 0.008  # moving average over the set points
    servo_lag_s: float = 0.0072  # kv / kp of every servo; 0.024 for a slow robot

    T_flange_sensor: pin.SE3 = field(default_factory=_default_T_flange_sensor)
    T_sensor_tcp: pin.SE3 = field(default_factory=_default_T_sensor_tcp)
    housing_mass_kg: float = 0.3  # sensor part on the flange side: not measured by the sensor
    tool_mass_kg: float = 1.0  # mass measured by the sensor
    p_sensor_com_m: Vector3 = (0.012, -0.008, 0.055)  # centre of mass, sensor frame
    disc_radius_m: float = 0.025  # flat face of the tool; the TCP is its centre, z points out

    stiffness_N_m: float = 2.0e4  # of the plate, along its normal and within its plane
    tilt_stiffness_Nm_rad: float | None = None  # None: from corner springs of `stiffness_N_m`
    tilt_deg: float = 0.0  # of the plate about base x, through the point under the tool
    gap_m: float = 0.005  # at home, vertically from the disc's lowest edge
    plate_damping_ratio: float = 0.4  # for a mass of DAMPED_MASS_KG; the plate has no mass
    friction: float = 0.3

    sensor: SensorSettings = field(default_factory=SensorSettings)

    def __post_init__(self) -> None:
        """Raise SimulationError naming every invalid field."""
        _refuse(
            _not_six_joints(self.home_deg),
            _not_ticks("delay_s", self.delay_s, 0.0, 1.0),
            _not_ticks("smoothing_s", self.smoothing_s, TICK_S, 0.2),
            _outside("servo_lag_s", self.servo_lag_s, 0.004, 0.1),
            _not_a_pose("T_flange_sensor", self.T_flange_sensor),
            _not_a_pose("T_sensor_tcp", self.T_sensor_tcp),
            _outside("housing_mass_kg", self.housing_mass_kg, 0.01, 5.0),
            _outside("tool_mass_kg", self.tool_mass_kg, 0.05, 7.0),
            _not_finite("p_sensor_com_m", self.p_sensor_com_m),
            _outside("disc_radius_m", self.disc_radius_m, 0.005, 0.05),
            _outside("stiffness_N_m", self.stiffness_N_m, 500.0, 1e6),
            _outside("tilt_stiffness_Nm_rad", self.plate_tilt_stiffness_Nm_rad, 0.1, 1e5),
            _outside("tilt_deg", self.tilt_deg, 0.0, 20.0),
            _outside("gap_m", self.gap_m, 0.0, 0.1),
            _outside("plate_damping_ratio", self.plate_damping_ratio, 0.05, 5.0),
            _outside("friction", self.friction, 0.0, 2.0),
        )

    @property
    def plate_tilt_stiffness_Nm_rad(self) -> float:
        """Rotational stiffness of the plate about either axis in its plane [Nm/rad]."""
        if self.tilt_stiffness_Nm_rad is not None:
            return self.tilt_stiffness_Nm_rad
        return self.stiffness_N_m * PLATE_CORNER_M**2

    @property
    def plate_relaxation_s(self) -> float:
        """Damping over stiffness of the plate's springs: 3 ms at 2e4 N/m."""
        return 2.0 * self.plate_damping_ratio * math.sqrt(DAMPED_MASS_KG / self.stiffness_N_m)

    @property
    def delay_ticks(self) -> int:
        """Dead time in whole ticks."""
        return round(self.delay_s / TICK_S)

    @property
    def smoothing_ticks(self) -> int:
        """Length of the moving average in whole ticks, at least one."""
        return round(self.smoothing_s / TICK_S)


def _refuse(*checks: Iterator[str]) -> None:
    mistakes = [mistake for check in checks for mistake in check]
    if mistakes:
        raise SimulationError("simulated cell: " + "; ".join(mistakes))


def _outside(name: str, value: float, low: float, high: float) -> Iterator[str]:
    if not low <= value <= high:  # negated so that NaN is rejected too
        yield f"{name} is {value:g}, must be within {low:g} .. {high:g}"


def _not_finite(name: str, values: tuple[float, ...]) -> Iterator[str]:
    if len(values) != 3 or not all(math.isfinite(value) for value in values):
        yield f"{name} is {values}, must be three finite numbers"


def _not_six_joints(home_deg: tuple[float, ...]) -> Iterator[str]:
    if len(home_deg) != 6 or not all(math.isfinite(angle) for angle in home_deg):
        yield f"home_deg is {home_deg}, must be six finite angles"


def _not_a_pose(name: str, T: pin.SE3) -> Iterator[str]:
    if not np.isfinite(T.homogeneous).all() or abs(np.linalg.det(T.rotation) - 1.0) > 1e-6:
        yield f"{name} is not a rigid transform"


def _not_ticks(name: str, value: float, low: float, high: float) -> Iterator[str]:
    yield from _outside(name, value, low, high)
    if math.isfinite(value) and abs(value - round(value / TICK_S) * TICK_S) > 1e-9:
        yield f"{name} is {value:g}, must be a whole number of milliseconds"
