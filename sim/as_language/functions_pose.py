"""Pose functions of AS (reference manual, chapter 9). Millimetres and degrees."""

import math

import numpy as np
import pinocchio as pin

from sim.as_language.errors import AsError
from sim.as_language.functions import function
from sim.as_language.machine_api import MachineInterface
from sim.as_language.values import (
    Joints,
    Pose,
    Transformation,
    joints,
    se3_of,
    single,
    transformation,
    transformation_of,
)

PARALLEL_AXES = 1e-9


def _place(machine: MachineInterface, pose: Pose) -> Transformation:
    return machine.transformation_of(pose) if isinstance(pose, Joints) else pose


def shift(
    place: Transformation, dx: float = 0.0, dy: float = 0.0, dz: float = 0.0
) -> Transformation:
    """SHIFT(p BY x,y,z): along the base axes; the orientation is unchanged."""
    return transformation(place.x + dx, place.y + dy, place.z + dz, place.o, place.a, place.t)


def _about(axis: tuple[float, float, float], degrees: float) -> Transformation:
    return transformation_of(pin.SE3(pin.exp3(np.array(axis) * math.radians(degrees)), np.zeros(3)))


def frame(
    x_from: Transformation, x_to: Transformation, y_side: Transformation, origin: Transformation
) -> Transformation:
    """Return the frame whose X axis points from the first to the second point.

    The third lies on the +Y side of the XY plane, the fourth is the origin.
    """
    a, b, c = (np.array(place.numbers()[:3]) for place in (x_from, x_to, y_side))
    x_axis = b - a
    z_axis = np.cross(x_axis, c - a)
    if np.linalg.norm(x_axis) < PARALLEL_AXES or np.linalg.norm(z_axis) < PARALLEL_AXES:
        raise AsError("E0106", "FRAME: the first three points are collinear")
    x_axis /= np.linalg.norm(x_axis)
    z_axis /= np.linalg.norm(z_axis)
    R = np.column_stack([x_axis, np.cross(z_axis, x_axis), z_axis])
    return transformation_of(pin.SE3(R, se3_of(origin).translation))


def component(pose: Pose, number: float) -> float:
    """DEXT(p,n): one of the six numbers."""
    if not 1 <= int(number) <= 6:
        raise AsError("E0106", f"DEXT: components are 1 to 6, not {int(number)}")
    return pose.numbers()[int(number) - 1]


def distance(machine: MachineInterface, first: Pose, second: Pose) -> float:
    """DISTANCE(p,q)."""
    return single(math.dist(_place(machine, first)[:3], _place(machine, second)[:3]))


def in_range(machine: MachineInterface, pose: Pose, near: Joints | None = None) -> float:
    """INRANGE(p,#j)."""
    return float(machine.in_range(pose, near))


FUNCTIONS = {
    "HERE": function("m", lambda machine: machine.here()),
    "#HERE": function("m", lambda machine: machine.here_joints()),
    "DEST": function("m", lambda machine: machine.destination()),
    "#DEST": function("m", lambda machine: machine.destination_joints()),
    "#HOME": function("mr", lambda machine, number=1.0: machine.home_joints(int(number))),
    "BASE": function("m", lambda machine: machine.base()),
    "TOOL": function("m", lambda machine: machine.tool()),
    "NULL": function("", Transformation),
    "TRANS": function("r*", transformation, most=6),
    "#PPOINT": function("r*", joints, most=6),
    "SHIFT": function("trrr", shift),
    "RX": function("r", lambda degrees: _about((1.0, 0.0, 0.0), degrees)),
    "RY": function("r", lambda degrees: _about((0.0, 1.0, 0.0), degrees)),
    "RZ": function("r", lambda degrees: _about((0.0, 0.0, 1.0), degrees)),
    "FRAME": function("tttt", frame),
    "DX": function("mp", lambda machine, pose: _place(machine, pose).x),
    "DY": function("mp", lambda machine, pose: _place(machine, pose).y),
    "DZ": function("mp", lambda machine, pose: _place(machine, pose).z),
    "DEXT": function("pr", component),
    "DISTANCE": function("mpp", distance),
    "INRANGE": function("mpj", in_range),
}
