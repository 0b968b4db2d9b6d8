"""Payload of the force/torque sensor: in cell file, calibration and payload file, and at run time.

SI units, sensor axes, from the sensor's origin. common/motion/weight.py has the readings that it
causes.
"""

from pathlib import Path
from typing import Annotated

import yaml
from pydantic import AfterValidator, Field, field_validator, model_validator

from common.config.cell_terms import AxisGain
from common.config.state_file import replace_file
from forcemesh.connection import ConfigSection
from forcemesh.errors import DataError
from forcemesh.messages import Vec3
from forcemesh.records import checked_unit
from forcemesh.units import mounting_objection

DOWN: Vec3 = (0.0, 0.0, -1.0)
# Keys of earlier versions, and the values with which they corrected nothing.
FORMER: dict[str, tuple[object, ...]] = {
    "torque_gain": ([1.0, 1.0, 1.0], (1.0, 1.0, 1.0)),
    "drift": (None,),
}
MOVED = (
    "gravity_direction_in_base is a key of the cell, not of its payload: write it at "
    "the top level of the cell file"
)


def _of_unit_length(direction: Vec3) -> Vec3:
    try:
        return checked_unit(direction, "the direction")
    except DataError as error:
        raise ValueError(str(error)) from None


Direction = Annotated[Vec3, AfterValidator(_of_unit_length)]
ComPart = Annotated[float, Field(ge=-1.0, le=1.0)]  # [m] from the sensor's origin
ForcePart = Annotated[float, Field(ge=-1000.0, le=1000.0)]  # [N] of a bias
TorquePart = Annotated[float, Field(ge=-100.0, le=100.0)]  # [N m] of a bias
BiasForce = tuple[ForcePart, ForcePart, ForcePart]
BiasTorque = tuple[TorquePart, TorquePart, TorquePart]


class Payload(ConfigSection):
    """Weight on the sensor and bias of the sensor.

    The fields with defaults are corrections that a fit may identify; their defaults correct
    nothing. `mounting_rotation_rad` is a rotation vector w: R_base_true = R_base_recorded
    @ exp([w]x), and all other fields and all readings are in the axes of the true sensor.
    """

    mass_kg: float = Field(ge=0.0, le=50.0)
    com_m: tuple[ComPart, ComPart, ComPart]
    bias_force_N: BiasForce = (0.0, 0.0, 0.0)
    bias_torque_Nm: BiasTorque = (0.0, 0.0, 0.0)
    gravity_direction_in_base: Direction = DOWN  # identified, tilt of the base included
    mounting_rotation_rad: Vec3 = (0.0, 0.0, 0.0)
    force_gain: tuple[AxisGain, AxisGain, AxisGain] = (1.0, 1.0, 1.0)  # reading per unit of load
    accept_uncalibrated: bool = False  # arm for force feedback although mass and centre are zero

    @model_validator(mode="before")
    @classmethod
    def _former_keys_correct_nothing(cls, values: object) -> object:
        if not isinstance(values, dict):
            return values
        kept = {key: value for key, value in values.items() if key not in FORMER}
        for key in values.keys() - kept.keys():
            if values[key] not in FORMER[key]:
                text = f"{key} is not corrected any more: calibrate again"
                raise ValueError(f"{text}, with `forcemesh calibrate`")
        return kept

    @field_validator("mass_kg", mode="before")
    @classmethod
    def _mass_is_a_number(cls, mass_kg: object) -> object:
        if isinstance(mass_kg, bool):
            raise ValueError(f"must be a number, found {mass_kg}")  # noqa: TRY004 - pydantic's
        return mass_kg

    @model_validator(mode="after")
    def _rotation_is_a_correction(self) -> "Payload":
        if objection := mounting_objection(self.mounting_rotation_rad):
            raise ValueError(objection)
        return self

    @property
    def weighs(self) -> bool:
        """Whether mass or centre of mass is set."""
        return self.mass_kg > 0.0 or any(self.com_m)


class CellPayload(Payload):
    """Payload in a cell file, whose gravity is the cell's."""

    gravity_direction_in_base: Direction = Field(DOWN, exclude=True)

    @model_validator(mode="before")
    @classmethod
    def _gravity_is_the_cells(cls, values: object) -> object:
        if isinstance(values, dict) and "gravity_direction_in_base" in values:
            raise ValueError(MOVED)
        return values


def save(payload: Payload, path: Path) -> None:
    """Write a payload file. Raises DataError when it cannot be written."""
    data = payload.model_dump(mode="json", exclude_none=True, exclude={"accept_uncalibrated"})
    text = "# forcemesh payload: kg, m, N, Nm, rad; sensor axes, from the sensor origin\n"
    text += yaml.safe_dump(data, sort_keys=False, default_flow_style=None)
    replace_file(path, text)
