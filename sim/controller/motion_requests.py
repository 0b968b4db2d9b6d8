"""Motion requests of a program: one motion with speed, accuracy and ramps. Values only."""

from dataclasses import dataclass
from typing import Literal

import pinocchio as pin

from common.motion.frames import Array

# 100 % of SPEED for a linear motion. Assumption: the manuals specify it per arm.
LINEAR_MAX_M_S = 2.0
# 100 % of ACCEL and DECEL: linear, and as the time of a joint to its full speed.
LINEAR_ACCEL_M_S2 = 2.0
JOINT_ACCEL_TIME_S = 0.3
BRAKE_FACTOR = 1.25  # deceleration of BRAKE and HOLD relative to 100 %: 2.5 m/s^2

SpeedUnit = Literal["%", "M/S", "S"]


@dataclass(frozen=True, slots=True)
class ProgramSpeed:
    """Program speed: a percentage, metres per second, or the duration of the motion in seconds."""

    value: float = 100.0
    unit: SpeedUnit = "%"

    def linear_m_s(self, extent_m: float) -> float:
        """Return the speed of a linear motion of this extent [m/s]."""
        if self.unit == "%":
            return LINEAR_MAX_M_S * self.value / 100.0
        return self.value if self.unit == "M/S" else extent_m / self.value

    def joint_fraction(self, full_speed_s: float) -> float:
        """Return the fraction of full joint speed, for a motion that takes `full_speed_s` at 1."""
        if self.unit == "%":
            return self.value / 100.0
        if self.unit == "M/S":  # "MM/S on a joint move is converted to a percentage"
            return min(1.0, self.value / LINEAR_MAX_M_S)
        return min(1.0, full_speed_s / self.value)


@dataclass(frozen=True, slots=True)
class MotionParameters:
    """Motion parameters: snapshot of the program's settings at the step of the motion."""

    speed: ProgramSpeed = ProgramSpeed()
    accuracy_m: float = 0.001
    accel_fraction: float = 1.0
    decel_fraction: float = 1.0
    T_flange_tcp: pin.SE3 | None = None


@dataclass(frozen=True, slots=True)
class MotionRequest:
    """One motion. Exactly one of the targets is set, or `pause_s` for DELAY and STABLE."""

    kind: Literal["linear", "joint", "pause"]
    manner: MotionParameters
    T_base_tcp: pin.SE3 | None = None
    q: Array | None = None
    pause_s: float = 0.0
