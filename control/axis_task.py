"""Force control of one period along and about each axis of a task frame. Pure.

Each axis either yields to the error of its set point or is held (hybrid force/position control:
M. T. Mason, Compliance and force control for computer controlled manipulators, 1981). The frame is
fixed to base or to the tool; the controlled point is the TCP, unless the frame has an origin.
"""

from dataclasses import dataclass
from math import hypot

import numpy as np

from common.motion.frames import Rows, Vector, plus, product, rotated, rotated_back, scaled
from forcemesh.messages import ZERO3, Mode, Vec3

Flags = tuple[bool, bool, bool]
NONE: Flags = (False, False, False)
ALL: Flags = (True, True, True)
Z: Vec3 = (0.0, 0.0, 1.0)
IDENTITY: Rows = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
AxisLimits = tuple[float | None, float | None, float | None]  # of three axes; None: the cell's
CELLS: AxisLimits = (None, None, None)


@dataclass(frozen=True, slots=True)
class VirtualMass:
    """Virtual mass, damper and spring of one axis: kg, N s/m, N/m, or kg m2, N m s/rad, N m/rad."""

    mass: float | None = None  # None: the least
    damping: float | None = None  # None: scheduled on the stiffness of the contact
    stiffness: float = 0.0


@dataclass(frozen=True, slots=True)
class AxisTask:
    """Task frame, controlled axes and set points of one period, in the axes of the frame."""

    force_along: Flags = ALL  # axes along which force control moves the tool
    torque_about: Flags = NONE  # axes about which torque control turns it
    force_N: Vec3 = ZERO3  # set point: force of the tool on its environment
    torque_Nm: Vec3 = ZERO3  # the same about the TCP, or about the origin
    R_task: Rows | None = None  # axes of the frame in base or in the TCP frame; None: tool axes
    in_base: bool = False  # fixed to base, otherwise to the tool
    searches: bool = True  # a force set point without contact begins with an approach
    origin_m: Vec3 | None = None  # centre of rotation, base axes; None: the TCP
    deadbands: tuple[AxisLimits, AxisLimits] = (CELLS, CELLS)  # of force [N] and torque [N m]
    speeds: tuple[AxisLimits | None, AxisLimits | None] = (None, None)  # [m/s], [rad/s]

    turns_freely: bool = False  # a hand may turn the tool: torque control at set point 0
    # Of each axis along and about which the tool complies; None: it does not.
    compliant_along: tuple[VirtualMass | None, ...] = (None,) * 3
    compliant_about: tuple[VirtualMass | None, ...] = (None,) * 3
    deviations: tuple[AxisLimits, AxisLimits] = (CELLS, CELLS)  # from the reference [m], [rad]

    @property
    def compliant(self) -> tuple[Flags, Flags]:
        """Axes along and about which a virtual mass moves the tool."""
        both = (*self.compliant_along, *self.compliant_about)
        x, y, z, rx, ry, rz = [each is not None for each in both]
        return (x, y, z), (rx, ry, rz)

    @property
    def complies(self) -> bool:
        """Whether an axis follows a virtual mass."""
        return self.compliant != (NONE, NONE)

    @property
    def moving(self) -> tuple[Flags, Flags]:
        """Axes along and about which a set point or compliance moves the tool."""
        forced = (*self.force_along, *self.torque_about)
        along, about = self.compliant
        x, y, z, rx, ry, rz = [a or b for a, b in zip(forced, (*along, *about), strict=True)]
        return (x, y, z), (rx, ry, rz)

    @property
    def held(self) -> tuple[Flags, Flags]:
        """The other axes."""
        (x, y, z), (rx, ry, rz) = self.moving
        return (not x, not y, not z), (not rx, not ry, not rz)

    @property
    def press_N(self) -> float:
        """Size of the force set point."""
        return hypot(*self.force_N)

    @property
    def press_axis(self) -> Vec3:
        """Direction of the force set point, the frame's z axis without one."""
        size_N = self.press_N
        x, y, z = self.force_N
        return (x / size_N, y / size_N, z / size_N) if size_N > 0.0 else Z

    @property
    def press_index(self) -> int:
        """Axis of the frame with the largest force set point, z without one."""
        x, y, z = map(abs, self.force_N)
        return 2 if z >= max(x, y) else int(y > x)

    def R_base_task(self, R_base_tcp: Rows) -> Rows:
        """Return the axes of the frame in base, at an orientation of the tool."""
        if self.R_task is None:
            return R_base_tcp
        if self.in_base:
            return self.R_task
        product_: Rows = (np.array(R_base_tcp) @ np.array(self.R_task)).tolist()
        return product_

    def arm_m(self, p_tcp_m: Vec3) -> Vec3:
        """Return the vector from the origin of the frame to the TCP, zero without one [m]."""
        return ZERO3 if self.origin_m is None else plus(p_tcp_m, self.origin_m, -1.0)


def mode_task(
    mode: Mode,
    setpoint_N: float,
    *,
    axes: tuple[bool, ...] = (True,) * 6,
    in_base: bool = False,
    press_axis: Vector = Z,
) -> AxisTask:
    """Return the task of a mode of the specification, whose set point is a press.

    Args:
        mode: Position controls the force, orientation the torque.
        setpoint_N: Press.
        axes: Free axes; the others are held.
        in_base: Whether they are base axes. With all of them free it makes no difference.
        press_axis: The tool's z axis in base.
    """
    x, y, z, rx, ry, rz = axes
    moves, turns = mode != "orientation", mode != "position"
    yields = (x and moves, y and moves, z and moves)
    fixed = in_base and not all(axes)
    press_N = scaled(press_axis, setpoint_N) if fixed else (0.0, 0.0, setpoint_N)
    return AxisTask(
        yields,
        (rx and turns, ry and turns, rz and turns),
        force_N=product(press_N, yields),
        R_task=IDENTITY if fixed else None,
        in_base=fixed,
    )


def masked(
    vector: Vec3,
    flags: Flags,
    R_base_task: Rows,
    limits: AxisLimits | None = None,
    *,
    share: float = 1.0,
) -> Vec3:
    """Return a vector in base axes without its parts along the held axes of the task frame.

    Args:
        vector: Motion or speed. Shape (3,).
        flags: Axes that are not held.
        R_base_task: The frame.
        limits: Largest speed along each axis; None: not limited here.
        share: Of the limits: the length of the period for a motion in it.
    """
    if all(flags) and limits is None:
        return vector
    if not any(flags):
        return ZERO3
    x, y, z = product(rotated_back(R_base_task, vector), flags)
    if limits is not None:
        x, y, z = clipped((x, y, z), limits, share)
    return rotated(R_base_task, (x, y, z))


def clipped(values: Vector, limits: AxisLimits | None, share: float = 1.0) -> Vec3:
    """Return values within a share of their limits, each for itself. Shape (3,)."""
    x, y, z = [
        value if limit is None else min(max(value, -limit * share), limit * share)
        for value, limit in zip(values, limits or CELLS, strict=True)
    ]
    return (x, y, z)
