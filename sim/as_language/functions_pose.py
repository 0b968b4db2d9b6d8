"""Pose functions of AS (reference manual, chapter 9). Millimetres and degrees."""

import math
from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from sim.as_language.errors import AsError
from sim.as_language.functions import Argument, function, number, table, whole
from sim.as_language.machine_api import MachineInterface
from sim.as_language.values import (
    Joints,
    Pose,
    Transformation,
    Value,
    joints,
    se3_of,
    single,
    transformation,
    transformation_of,
)

NULL = Transformation()
PARALLEL_AXES = 1e-9


def _place(value: Argument) -> Transformation:
    return value if isinstance(value, Transformation) else NULL


def _pose(value: Argument) -> Pose:
    return value if isinstance(value, Joints) else _place(value)


def _as_place(machine: MachineInterface, value: Argument) -> Transformation:
    return machine.transformation_of(value) if isinstance(value, Joints) else _place(value)


def shift(place: Transformation, dx: float, dy: float, dz: float) -> Transformation:
    """Translate along the base axes; the orientation is unchanged."""
    return transformation(place.x + dx, place.y + dy, place.z + dz, place.o, place.a, place.t)


def _shift(_: MachineInterface, a: Sequence[Argument]) -> Transformation:
    dx, dy, dz = (number(a[k]) if k < len(a) else 0.0 for k in (1, 2, 3))
    return shift(_place(a[0]), dx, dy, dz)


def _about(axis: tuple[float, float, float], degrees: float) -> Transformation:
    """Return the rotation about an axis."""
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


def _dext(_: MachineInterface, a: Sequence[Argument]) -> float:
    which = whole(a[1])
    if not 1 <= which <= 6:
        raise AsError("E0106", f"DEXT: components are 1 to 6, not {which}")
    return _pose(a[0]).numbers()[which - 1]


def _distance(machine: MachineInterface, a: Sequence[Argument]) -> float:
    first, second = (_as_place(machine, item).numbers()[:3] for item in a)
    return single(math.dist(first, second))


def _in_range(machine: MachineInterface, a: Sequence[Argument]) -> float:
    configuration = a[1] if len(a) > 1 and isinstance(a[1], Joints) else None
    return float(machine.in_range(_pose(a[0]), configuration))


def _home(machine: MachineInterface, a: Sequence[Argument]) -> Value:
    return machine.home_joints(whole(a[0], 1) if a else 1)


FUNCTIONS = table(
    function("HERE", "", lambda machine, _: machine.here()),
    function("#HERE", "", lambda machine, _: machine.here_joints()),
    function("DEST", "", lambda machine, _: machine.destination()),
    function("#DEST", "", lambda machine, _: machine.destination_joints()),
    function("#HOME", "(r)", _home),
    function("BASE", "", lambda machine, _: machine.base()),
    function("TOOL", "", lambda machine, _: machine.tool()),
    function("NULL", "", lambda _, __: NULL),
    function("TRANS", "(rrrrrr)", lambda _, a: transformation(*(number(item) for item in a))),
    function("#PPOINT", "(rrrrrr)", lambda _, a: joints(*(number(item) for item in a))),
    function("SHIFT", "t(rrr)", _shift),
    function("RX", "r", lambda _, a: _about((1.0, 0.0, 0.0), number(a[0]))),
    function("RY", "r", lambda _, a: _about((0.0, 1.0, 0.0), number(a[0]))),
    function("RZ", "r", lambda _, a: _about((0.0, 0.0, 1.0), number(a[0]))),
    function("FRAME", "tttt", lambda _, a: frame(*(_place(item) for item in a))),
    function("DX", "p", lambda machine, a: _as_place(machine, a[0]).x),
    function("DY", "p", lambda machine, a: _as_place(machine, a[0]).y),
    function("DZ", "p", lambda machine, a: _as_place(machine, a[0]).z),
    function("DEXT", "pr", _dext),
    function("DISTANCE", "pp", _distance),
    function("INRANGE", "p(j)", _in_range),
)
