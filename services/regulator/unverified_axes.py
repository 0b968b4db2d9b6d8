"""Travel limit of force control along sensor axes that are not verified. Pure.

A sensor with a wrong sign or axis moves the tool along a force that does not exist, and the actual
force does not fall. A hand that guides the tool produces the same readings, so they cannot
distinguish the two. Along the unverified axes of the tool together, the travel is therefore at most

    LIMIT_M + (F_most - F) / SOFTEST_N_M

The force of a released contact falls with the travel, that of a wrong axis does not. The axes are
verified by `forcemesh check axes`, the one along the tool also by a touch from free space.
"""

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from common.config.cell import CellConfig
from common.motion.frames import Array, cross, length, rotation_between
from forcemesh.faults import tripped
from forcemesh.messages import Trip, WrenchAtTcp

LIMIT_M = 0.002  # a force that falls by chance and braking add to it: 5 mm in all
LIMIT_RAD = 0.1
SOFTEST_N_M = 1000.0  # contact whose release is still recognised as one
IDLE_BANDS = 1.5  # of the deadband: below it the tool is idle and its travel is reset
AXES = "xyz"
TARED = ", tared"  # suffix of a calibration's name after a tare, which changes no axis
Flags = npt.NDArray[np.bool_]


def limited_axes(wrench: WrenchAtTcp, touched: str, *, rotates: bool) -> Flags:
    """Return along which axes of the tool the travel is limited. Shape (3,).

    A wrong torque turns the tool into its contact, and the force then pushes it back along every
    axis: while the tool may turn, a touch alone exempts no axis.

    Args:
        wrench: With its calibration, and whether `forcemesh check axes` passed with it.
        touched: Calibration verified along the tool by a touch from free space.
        rotates: Whether the mode controls torques.
    """
    z_is_proved = touched == wrench.calibration.removesuffix(TARED) and not rotates
    return np.array([True, True, not z_is_proved]) & (not wrench.axes_checked)


@dataclass(frozen=True, slots=True)
class ToolMotion:
    """Motion of one period, base axes."""

    moved_m: Array  # of the contact point. Shape (3,)
    turned_rad: Array  # shape (3,)


def motion_between(T_from: pin.SE3, T_to: pin.SE3, lever_m: Array | None) -> ToolMotion:
    """Return the motion of the contact point, including that of a rotation about the TCP."""
    turned_rad = rotation_between(T_from.rotation, T_to.rotation)
    moved_m = T_to.translation - T_from.translation
    if lever_m is not None:
        moved_m = moved_m + cross(turned_rad, lever_m)
    return ToolMotion(moved_m, turned_rad)


@dataclass(frozen=True, slots=True)
class YieldSettings:
    """Force and torque below which the tool is idle."""

    idle_N: float
    idle_Nm: float

    @classmethod
    def of(cls, cell: CellConfig) -> "YieldSettings":
        """Return the settings of a cell."""
        return cls(IDLE_BANDS * cell.force.deadband_N, IDLE_BANDS * cell.force.deadband_Nm)


@dataclass(frozen=True, slots=True)
class YieldTravel:
    """Travel along the force since the tool was idle; along the tool's axes, shape (3,)."""

    travel_m: Array = field(default_factory=lambda: np.zeros(3))
    most_N: Array = field(default_factory=lambda: np.zeros(3))
    turn_rad: float = 0.0  # about the force, or about any axis while there is no force


def update(
    before: YieldTravel,
    motion: ToolMotion,
    R_base_tcp: Array,
    *,
    force_N: Array,
    torque_Nm: Array,
    limited: Flags,
    settings: YieldSettings,
) -> YieldTravel:
    """Return the travel after one more period.

    Args:
        before: Travel so far.
        motion: Motion of this period.
        R_base_tcp: Orientation of the tool, shape (3, 3).
        force_N: Of the environment on the tool, base axes, shape (3,).
        torque_Nm: About the TCP, base axes, shape (3,).
        limited: Axes whose travel is limited. Shape (3,).
        settings: When the tool is idle.
    """
    force, moved_m = R_base_tcp.T @ force_N, R_base_tcp.T @ motion.moved_m
    size = np.abs(force)
    if length(force * limited) <= settings.idle_N:
        travel_m, most_N = np.zeros(3), size
    else:
        step_m = np.abs(moved_m)
        step_m = np.where(force * moved_m > 0.0, step_m, -step_m)
        travel_m = np.maximum(before.travel_m + step_m, 0.0)
        most_N = np.where(travel_m > 0.0, np.maximum(before.most_N, size), size)
    spin_Nm = torque_Nm
    if (square := float(force_N @ force_N)) > settings.idle_N**2:
        spin_Nm = force_N * float(torque_Nm @ force_N) / square
    turn_rad = before.turn_rad
    if (spin := length(spin_Nm)) <= settings.idle_Nm:
        turn_rad = 0.0
    else:
        yielded_rad = float(motion.turned_rad @ spin_Nm) / spin
        turn_rad = max(turn_rad + yielded_rad, 0.0)
    return YieldTravel(travel_m, most_N, turn_rad)


def trip_of(now: YieldTravel, force_tool_N: Array, limited: Flags, *, rotates: bool) -> Trip | None:
    """Return why force feedback must end, if it must; `force_tool_N` in tool axes, shape (3,)."""
    too_far = length(now.travel_m * limited) > LIMIT_M  # before the travel that the force allows
    too_turned = rotates and now.turn_rad > LIMIT_RAD and limited.any()
    if not too_far and not too_turned:
        return None
    paid_m = _fallen_N(now, np.abs(force_tool_N), limited) / SOFTEST_N_M
    unpaid_m = np.where(limited, np.maximum(now.travel_m - paid_m, 0.0), 0.0)
    unexplained_m, at = length(unpaid_m), int(np.argmax(unpaid_m))
    rest = (
        "and the sensor's axes and signs are not verified: run `forcemesh "
        "check axes`, once for each calibration"
    )
    if unexplained_m > LIMIT_M:
        text = (
            f"the tool yielded by {unexplained_m * 1e3:.1f} mm, mainly along its {AXES[at]} "
            f"axis, the force did not fall, {rest}"
        )
        return tripped("sensor_sign", text, value=unexplained_m, limit=LIMIT_M, unit="m")
    if too_turned:
        text = f"the tool yielded to a torque by {np.degrees(now.turn_rad):.1f} degrees, {rest}"
        return tripped("sensor_sign", text, value=now.turn_rad, limit=LIMIT_RAD, unit="rad")
    return None


def _fallen_N(now: YieldTravel, size_N: Array, limited: Flags) -> Array:
    """Return by how much yielding has reduced the force along each axis [N]. Shape (3,).

    The force of a released contact falls as a whole. With swapped axes, the force along one axis
    may fall by chance while it grows along the others, so the fall of the whole is the limit.

    Args:
        now: Travel so far.
        size_N: Magnitude of the force along the tool's axes. Shape (3,).
        limited: Axes whose travel is limited. Shape (3,).
    """
    yields = limited & (now.travel_m > 0.0)
    all_N = length(now.most_N[yields]) - length(size_N[yields])
    return np.minimum(now.most_N - size_N, max(all_N, 0.0))
