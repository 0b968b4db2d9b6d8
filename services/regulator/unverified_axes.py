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

from common.motion.frames import Array, length
from forcemesh.faults import tripped
from forcemesh.messages import Trip

LIMIT_M = 0.002  # a force that falls by chance and braking add to it: 5 mm in all
LIMIT_RAD = 0.1
SOFTEST_N_M = 1000.0  # contact whose release is still recognised as one
IDLE_BANDS = 1.5  # of the deadband: below it the tool is idle and its travel is reset
AXES = "xyz"
Flags = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class YieldTravel:
    """Travel along the force since the tool was idle; along the tool's axes, shape (3,)."""

    travel_m: Array = field(default_factory=lambda: np.zeros(3))
    most_N: Array = field(default_factory=lambda: np.zeros(3))
    turn_rad: float = 0.0  # about the force, or about any axis while there is no force


def update(
    before: YieldTravel,
    R_base_tcp: Array,
    *,
    moved_m: Array,
    turned_rad: Array,
    force_N: Array,
    torque_Nm: Array,
    limited: Flags,
    idle_N: float,
    idle_Nm: float,
) -> YieldTravel:
    """Return the travel after one more period.

    Args:
        before: Travel so far.
        R_base_tcp: Orientation of the tool, shape (3, 3).
        moved_m: Travel of the contact point in this period, base axes, shape (3,).
        turned_rad: Rotation in this period, base axes, shape (3,).
        force_N: Of the environment on the tool, base axes, shape (3,).
        torque_Nm: About the TCP, base axes, shape (3,).
        limited: Axes whose travel is limited. Shape (3,).
        idle_N: Force below which the tool is idle.
        idle_Nm: Torque below which it is idle.
    """
    force, step_m = R_base_tcp.T @ force_N, R_base_tcp.T @ moved_m
    size = np.abs(force)
    if length(force * limited) <= idle_N:
        travel_m, most_N = np.zeros(3), size
    else:
        yielded_m = np.where(force * step_m > 0.0, np.abs(step_m), -np.abs(step_m))
        travel_m = np.maximum(before.travel_m + yielded_m, 0.0)
        most_N = np.where(travel_m > 0.0, np.maximum(before.most_N, size), size)
    spin_Nm = torque_Nm
    if (square := float(force_N @ force_N)) > idle_N**2:
        spin_Nm = force_N * float(torque_Nm @ force_N) / square
    turn_rad = 0.0
    if (spin := length(spin_Nm)) > idle_Nm:
        turn_rad = max(before.turn_rad + float(turned_rad @ spin_Nm) / spin, 0.0)
    return YieldTravel(travel_m, most_N, turn_rad)


def trip_of(now: YieldTravel, force_tool_N: Array, limited: Flags, *, rotates: bool) -> Trip | None:
    """Return why force feedback must end, if it must; `force_tool_N` in tool axes, shape (3,)."""
    too_far = length(now.travel_m * limited) > LIMIT_M  # before the travel that the force allows
    too_turned = rotates and now.turn_rad > LIMIT_RAD and limited.any()
    if not too_far and not too_turned:
        return None
    # The force of a released contact falls as a whole. With swapped axes, the force along one axis
    # may fall by chance while it grows along the others, so the fall of the whole is the limit.
    size_N, yields = np.abs(force_tool_N), limited & (now.travel_m > 0.0)
    fallen_N = max(length(now.most_N[yields]) - length(size_N[yields]), 0.0)
    paid_m = np.minimum(now.most_N - size_N, fallen_N) / SOFTEST_N_M
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
