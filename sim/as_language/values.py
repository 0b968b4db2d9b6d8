"""Value types of AS: single-precision reals, strings, transformations, joint values.

A real is a Python float that is exactly a 32-bit float; an integer (`@n`) is a Python int.
Transformations and joint values hold millimetres and degrees, as AS does.
"""

import math
import struct
from typing import NamedTuple

import pinocchio as pin

from common.motion.frames import Oat, R_from_oat, oat_from_R, pose
from sim.as_language.errors import AsError

TRUE = -1.0
FALSE = 0.0
MAX_CHARACTERS = 255
MM = 1e-3
ZEROS = (0.0,) * 6

NUMBER = (float, int)  # for isinstance: `float | int` would be rebuilt at each evaluation

# Twice as fast as numpy.float32, and the same rounding; this runs for every operator.
_write_single = struct.Struct("<f").pack
_read_single = struct.Struct("<f").unpack
_write_six = struct.Struct("<6f").pack
_read_six = struct.Struct("<6f").unpack

Six = tuple[float, float, float, float, float, float]


class Transformation(NamedTuple):
    """A pose: X, Y, Z in millimetres, O, A, T in degrees."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    o: float = 0.0
    a: float = 0.0
    t: float = 0.0

    def numbers(self) -> tuple[float, ...]:
        """Return the six numbers in AS's order."""
        return tuple(self)


class Joints(NamedTuple):
    """Joint values JT1..JT6 in degrees."""

    values: Six

    def numbers(self) -> tuple[float, ...]:
        """Return the six numbers in AS's order."""
        return self.values


Value = float | int | str | Transformation | Joints
Pose = Transformation | Joints


def single(number: float) -> float:
    """Round to single precision; E0106 outside its range."""
    try:
        return _read_single(_write_single(number))[0]  # type: ignore[no-any-return]
    except (OverflowError, struct.error):
        raise AsError("E0106", f"{number:g} is beyond the largest real, 3.4E38") from None


def singles(six: Six) -> Six:
    """Round six numbers to single precision (E0106), at the cost of two."""
    try:
        return _read_six(_write_six(*six))
    except (OverflowError, struct.error):
        for number in six:
            single(number)  # raises for the one that is out of range
        raise


def truth(condition: bool) -> float:  # noqa: FBT001 (a value, not an option)
    """Return AS's TRUE (-1) or FALSE (0)."""
    return TRUE if condition else FALSE


def text(characters: str) -> str:
    """Return the string if it has at most 255 characters (E0110)."""
    if len(characters) > MAX_CHARACTERS:
        raise AsError("E0110", f"{len(characters)} characters, limit {MAX_CHARACTERS}")
    return characters


def transformation(*numbers: float) -> Transformation:
    """Return a transformation of numbers rounded to single precision; missing ones are zero."""
    return Transformation(*singles(_six(numbers)))


def joints(*numbers: float) -> Joints:
    """Return joint values rounded to single precision; missing ones are zero."""
    return Joints(singles(_six(numbers)))


def se3_of(place: Transformation) -> pin.SE3:
    """Return the pose [m] of a transformation."""
    oat = Oat(*map(math.radians, place[3:]))
    return pose((place.x * MM, place.y * MM, place.z * MM), R_from_oat(oat))


def transformation_of(T: pin.SE3, previous: Transformation | None = None) -> Transformation:
    """Return the transformation of a pose [m]; at a pole O keeps its previous value, else 0."""
    before = None if previous is None else Oat(*map(math.radians, previous[3:]))
    o, a, t = oat_from_R(T.rotation, before)
    x, y, z = T.translation.tolist()
    return transformation(x / MM, y / MM, z / MM, math.degrees(o), math.degrees(a), math.degrees(t))


def compose(first: Transformation, second: Transformation) -> Transformation:
    """Return first + second: second is expressed in the frame first (ASM 3-16)."""
    return transformation_of(se3_of(first) * se3_of(second))


def inverse(place: Transformation) -> Transformation:
    """Return -place."""
    return transformation_of(se3_of(place).inverse())


def _six(numbers: tuple[float, ...]) -> Six:
    a, b, c, d, e, f = (*numbers, *ZEROS)[:6]
    return (a, b, c, d, e, f)
