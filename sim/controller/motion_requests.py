"""Motion requests of a program: target, speed, accuracy and ramps, with their ranges and units."""

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import pinocchio as pin

from common.motion.frames import Array
from common.motion.paths import TURN_RADIUS_M
from sim.as_language.errors import AsError
from sim.as_language.values import single

# 100 % of SPEED for a linear motion. Assumption: the manuals specify it per arm.
LINEAR_MAX_M_S = 2.0
# 100 % of ACCEL and DECEL: linear, and as the time of a joint to its full speed.
LINEAR_ACCEL_M_S2 = 2.0
JOINT_ACCEL_TIME_S = 0.3
LINEAR_TURN_MAX_RAD_S = LINEAR_MAX_M_S / TURN_RADIUS_M  # of the same, its rotation: 100 %
BRAKE_FACTOR = 1.25  # deceleration of BRAKE and HOLD relative to 100 %: 2.5 m/s^2

LEAST_PERCENT, MOST_PERCENT = 0.01, 100.0
SECONDS = (0.1, 3601.0)
# To metres per second.
UNITS_M_S = {
    "MM/S": 1e-3, "MM/MIN": 1e-3 / 60.0, "CM/S": 1e-2, "CM/MIN": 1e-2 / 60.0,
    "M/S": 1.0, "M/MIN": 1.0 / 60.0,
}  # fmt: skip

SpeedUnit = Literal["%", "M/S", "S"]


class ProgramSpeed(NamedTuple):
    """Program speed: a percentage, metres per second, or the duration of the motion in seconds."""

    value: float = 100.0
    unit: SpeedUnit = "%"

    def at_most(self, percent: float) -> "ProgramSpeed":
        """Return the speed, or a percentage if that is slower; seconds always become it."""
        full = {"%": 100.0, "M/S": LINEAR_MAX_M_S, "S": 0.0}[self.unit]
        slow = ProgramSpeed(percent)
        return slow if self.unit == "S" or self.value > full * percent / 100.0 else self

    @property
    def linear_share(self) -> float:
        """Fraction of the full speed of a linear motion; not of a speed in seconds."""
        full = 100.0 if self.unit == "%" else LINEAR_MAX_M_S
        return min(1.0, self.value / full)

    def linear_s(self, travel_m: float, turn_rad: float) -> float:
        """Return the duration of a linear motion without its ramps [s].

        A speed is that of the TCP: the rotation then has 100 % of its own speed, or the same
        percentage.
        """
        if self.unit == "S":
            return self.value
        turn_share = self.linear_share if self.unit == "%" else 1.0
        travel_s = travel_m / (self.linear_share * LINEAR_MAX_M_S)
        return max(travel_s, turn_rad / (turn_share * LINEAR_TURN_MAX_RAD_S))

    def joint_fraction(self, full_speed_s: float) -> float:
        """Return the fraction of full joint speed, for a motion that takes `full_speed_s` at 1."""
        if self.unit == "%":
            return self.value / 100.0
        if self.unit == "M/S":  # "MM/S on a joint move is converted to a percentage"
            return min(1.0, self.value / LINEAR_MAX_M_S)
        return min(1.0, full_speed_s / self.value)


class MotionParameters(NamedTuple):
    """Motion parameters: snapshot of the program's settings at the step of the motion."""

    T_flange_tcp: pin.SE3
    speed: ProgramSpeed = ProgramSpeed()
    accuracy_m: float = 0.001
    accel_fraction: float = 1.0
    decel_fraction: float = 1.0
    absolute: bool = False  # ABS.SPEED: a speed in MM/S is not scaled by the monitor speed
    accel_time_s: float = 0.0  # to the motion's own speed at 100 %; 0: a constant acceleration
    straight_wrist_rad: float = 0.0  # SINGULAR: JT5 may not come closer to zero on a TCP path
    keeps_configuration: bool = False  # CONF_VARIABLE OFF: of the joint values of a TCP path's end


class MotionRequest(NamedTuple):
    """One motion. Exactly one of the targets is set, or `pause_s` for DELAY and STABLE."""

    kind: Literal["linear", "joint", "pause"]
    manner: MotionParameters
    T_base_tcp: pin.SE3 | None = None
    q: Array | None = None
    pause_s: float = 0.0
    circle_m: Array | None = None  # linear: on the arc whose circle goes through this point, too


class MotionSettings:
    """SPEED, ACCURACY, ACCEL and DECEL: for all motions, or for the next one only."""

    def __init__(self) -> None:
        """Start with the defaults of a program: 100 %, 1 mm."""
        self._always: dict[str, Any] = {}
        self._next: dict[str, Any] = {}

    def change(self, field: str, value: Any, *, always: bool) -> None:
        """Set one field of `MotionParameters`, permanently or for the next motion only."""
        self._next.pop(field, None)
        (self._always if always else self._next)[field] = value

    def take(self, T_flange_tcp: pin.SE3, speed: ProgramSpeed | None = None) -> MotionParameters:
        """Return the parameters of the motion to be queued, optionally with its own speed."""
        manner = MotionParameters(T_flange_tcp, **(self._always | self._next))
        self._next = {}
        return manner if speed is None else manner._replace(speed=speed)


def checked(value: float, least: float, most: float, name: str) -> float:
    """Return a value if it is within its range. Raises AsError E0106.

    The range tolerates single-precision rounding: a program's 0.01 is slightly less than 0.01.
    """
    if not least <= value <= most and not single(least) <= value <= single(most):
        raise AsError("E0106", f"{name} is {value:g}, must be within {least:g} .. {most:g}")
    return value


def percent(value: float, name: str) -> float:
    """Return a percentage. Raises AsError E0106."""
    return checked(value, LEAST_PERCENT, MOST_PERCENT, name)


def speed_of(value: float, modifiers: Sequence[str]) -> ProgramSpeed:
    """Return the speed of a value with its unit; without a unit it is a percentage.

    Raises AsError E0106 outside its range, E0111 for a unit that is not emulated.
    """
    unit = next((word for word in modifiers if word in UNITS_M_S), "")
    if unit:
        speed_m_s = value * UNITS_M_S[unit]
        return ProgramSpeed(checked(speed_m_s, 1e-5, 20.0, "SPEED in m/s"), "M/S")
    if "S" in modifiers:
        return ProgramSpeed(checked(value, *SECONDS, "SPEED in seconds"), "S")
    if "DEG/S" in modifiers or "DEG/MIN" in modifiers:
        raise AsError("E0111", "a rotational SPEED is an option of the controller")
    return ProgramSpeed(percent(value, "SPEED"))
