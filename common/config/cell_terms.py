"""Common base class and field types of the sections of a cell file."""

from math import radians
from typing import TYPE_CHECKING, Annotated

from pydantic import Field

from forcemesh.connection import ConfigSection

if TYPE_CHECKING:
    import pinocchio as pin

Positive = Annotated[float, Field(gt=0.0)]
Coordinate = Annotated[float, Field(ge=-2.0, le=2.0)]  # [m] in the flange frame
LARGEST_ANGLE_DEG = 720.0
Angle = Annotated[float, Field(ge=-LARGEST_ANGLE_DEG, le=LARGEST_ANGLE_DEG)]  # [degrees]
AxisGain = Annotated[float, Field(ge=0.5, le=1.5)]
Fraction = Annotated[float, Field(gt=0.0, le=1.0)]


class FrameSection(ConfigSection):
    """Pose of one frame in another, as on the pendant."""

    position_m: tuple[Coordinate, Coordinate, Coordinate]
    oat_deg: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)

    @property
    def pose(self) -> "pin.SE3":
        """The pose."""
        # Importing the maths takes half a second, and most verbs only need the bus's address.
        from common.motion.frames import Oat, R_from_oat, pose  # noqa: PLC0415

        return pose(self.position_m, R_from_oat(Oat(*(radians(angle) for angle in self.oat_deg))))
