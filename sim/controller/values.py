"""What AS computes with: single-precision reals, strings, transformations, joint values.

A real is a Python float that is exactly a 32-bit float; an integer (`@n`) is a Python int.
Transformations and joint values hold millimetres and degrees, as AS does.
"""

import math
import struct
from dataclasses import astuple, dataclass

import pinocchio as pin

from common.frames import Oat, R_from_oat, oat_from_R, pose
from sim.controller.errors import AsError

TRUE = -1.0
FALSE = 0.0
MAX_CHARACTERS = 255
MM = 1e-3

# Twice as fast as numpy.float32, and the same rounding; this runs for every operator.
_write_single = struct.Struct("<f").pack
_read_single = struct.Struct("<f").unpack


@dataclass(frozen=True, slots=True)
class Transformation:
    """A pose: X, Y, Z in millimetres, O, A, T in degrees."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    o: float = 0.0
    a: float = 0.0
    t: float = 0.0

    def numbers(self) -> tuple[float, ...]:
        """Return the six numbers in AS's order."""
        return astuple(self)


@dataclass(frozen=True, slots=True)
class Joints:
    """Joint values JT1..JT6 in degrees."""

    values: tuple[float, float, float, float, float, float]

    def numbers(self) -> tuple[float, ...]:
        """Return the six numbers in AS's order."""
        return self.values


Value = float | int | str | Transformation | Joints
Pose = Transformation | Joints


def single(number: float) -> float:
    """Round to single precision; beyond its range is an error of the program (E0106)."""
    try:
        return _read_single(_write_single(number))[0]  # type: ignore[no-any-return]
    except (OverflowError, struct.error):
        raise AsError("E0106", f"{number:g} is beyond the largest real, 3.4E38") from None


def truth(condition: bool) -> float:  # noqa: FBT001 (a value, not an option)
    """Return AS's TRUE (-1) or FALSE (0)."""
    return TRUE if condition else FALSE


def text(characters: str) -> str:
    """Return the string if AS can hold it: 255 characters (E0110)."""
    if len(characters) > MAX_CHARACTERS:
        raise AsError("E0110", f"{len(characters)} characters; {MAX_CHARACTERS} are the most")
    return characters


def transformation(*numbers: float) -> Transformation:
    """Return a transformation of numbers rounded to single precision."""
    return Transformation(*(single(number) for number in numbers))


def joints(*numbers: float) -> Joints:
    """Return joint values rounded to single precision; missing ones are zero."""
    six = [single(number) for number in numbers] + [0.0] * 6
    return Joints((six[0], six[1], six[2], six[3], six[4], six[5]))


def se3_of(place: Transformation) -> pin.SE3:
    """Return the pose [m] of a transformation."""
    oat = Oat(math.radians(place.o), math.radians(place.a), math.radians(place.t))
    return pose((place.x * MM, place.y * MM, place.z * MM), R_from_oat(oat))


def transformation_of(T: pin.SE3, previous: Transformation | None = None) -> Transformation:
    """Return the transformation of a pose [m]; at a pole O keeps its previous value, else 0."""
    before = None
    if previous is not None:
        before = Oat(*(math.radians(angle) for angle in (previous.o, previous.a, previous.t)))
    oat = oat_from_R(T.rotation, before)
    x, y, z = T.translation / MM
    return transformation(float(x), float(y), float(z), *(math.degrees(angle) for angle in oat))


def compose(first: Transformation, second: Transformation) -> Transformation:
    """Return first + second: second is expressed in the frame first (ASM 3-16)."""
    return transformation_of(se3_of(first) * se3_of(second))


def inverse(place: Transformation) -> Transformation:
    """Return -place."""
    return transformation_of(se3_of(place).inverse())
