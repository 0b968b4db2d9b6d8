"""Travel limit of force control along sensor axes that are not verified. Pure.

A sensor with a wrong sign or axis moves the tool along a force that does not exist, and the actual
force does not fall. A hand that guides the tool produces the same readings, so they cannot
distinguish the two. Along the unverified axes of the tool together, the travel is therefore at most

    LIMIT_M + (F_most - F) / SOFTEST_N_M

The force of a released contact falls with the travel, that of a wrong axis does not. The axes are
verified by `forcemesh check axes`, the one along the tool also by a touch from free space.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import degrees, hypot

from common.motion.frames import Vector, dot, product, scaled
from forcemesh.faults import tripped
from forcemesh.messages import ZERO3, Trip, Vec3

LIMIT_M = 0.002  # a force that falls by chance and braking add to it: 5 mm in all
LIMIT_RAD = 0.1
SOFTEST_N_M = 1000.0  # contact whose release is still recognised as one
IDLE_BANDS = 1.5  # of the deadband: below it the tool is idle and its travel is reset
AXES = "xyz"
Flags = Sequence[bool]  # of three axes


@dataclass(slots=True)
class YieldTravel:
    """Travel along the force since the tool was idle, along the tool's axes; advanced in place."""

    travel_m: Vector = ZERO3
    most_N: Vector = ZERO3
    turn_rad: float = 0.0  # about the force, or about any axis while there is no force

    def update(
        self,
        force_tool_N: Vec3,
        *,
        moved_tool_m: Vec3,
        turned_rad: Vec3,
        force_N: Vec3,
        torque_Nm: Vec3,
        limited: Flags,
        idle_N: float,
        idle_Nm: float,
    ) -> None:
        """Add one more period.

        Args:
            force_tool_N: Force of the environment on the tool, the tool's axes.
            moved_tool_m: Travel of the contact point in this period, the tool's axes.
            turned_rad: Rotation in this period, base axes.
            force_N: The same force, base axes.
            torque_Nm: About the TCP, base axes.
            limited: Axes whose travel is limited.
            idle_N: Force below which the tool is idle.
            idle_Nm: Torque below which it is idle.
        """
        size_N, travel_m = [*map(abs, force_tool_N)], [0.0] * 3
        if hypot(*product(force_tool_N, limited)) > idle_N:
            for axis, step_m in enumerate(moved_tool_m):
                yielded_m = abs(step_m) if force_tool_N[axis] * step_m > 0.0 else -abs(step_m)
                travel_m[axis] = max(self.travel_m[axis] + yielded_m, 0.0)
                if travel_m[axis] > 0.0:
                    size_N[axis] = max(self.most_N[axis], size_N[axis])
        self.travel_m, self.most_N = travel_m, size_N
        spin_Nm = torque_Nm
        if (square := dot(force_N, force_N)) > idle_N**2:
            spin_Nm = scaled(force_N, dot(torque_Nm, force_N) / square)
        spin = hypot(*spin_Nm)
        turn_rad = self.turn_rad + dot(turned_rad, spin_Nm) / spin if spin > idle_Nm else 0.0
        self.turn_rad = max(turn_rad, 0.0)

    def trip(self, force_tool_N: Vec3, limited: Flags, *, rotates: bool) -> Trip | None:
        """Return why force feedback must end, if it must; `force_tool_N` along the tool's axes."""
        # Before the travel that the force allows.
        too_far = hypot(*product(self.travel_m, limited)) > LIMIT_M
        too_turned = rotates and self.turn_rad > LIMIT_RAD and any(limited)
        if not too_far and not too_turned:
            return None
        # The force of a released contact falls as a whole. With swapped axes, the force along one
        # axis may fall by chance while it grows along the others, so the fall of the whole is the
        # limit.
        size_N = [abs(axis_N) for axis_N in force_tool_N]
        yields = [axis for axis in range(3) if limited[axis] and self.travel_m[axis] > 0.0]
        before_N, now_N = (hypot(*(N[axis] for axis in yields)) for N in (self.most_N, size_N))
        fallen_N = max(before_N - now_N, 0.0)
        unpaid_m = [0.0] * 3
        for axis in yields:
            paid_m = min(self.most_N[axis] - size_N[axis], fallen_N) / SOFTEST_N_M
            unpaid_m[axis] = max(self.travel_m[axis] - paid_m, 0.0)
        unexplained_m, at = hypot(*unpaid_m), unpaid_m.index(max(unpaid_m))
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
            text = f"the tool yielded to a torque by {degrees(self.turn_rad):.1f} degrees, {rest}"
            return tripped("sensor_sign", text, value=self.turn_rad, limit=LIMIT_RAD, unit="rad")
        return None
