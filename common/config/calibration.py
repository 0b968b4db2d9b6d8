"""Calibration of a cell's sensor: payload and bias, their validity, and the fit residuals.

`forcemesh calibrate` writes it to a separate file, named in the cell file, and so never overwrites
a file written by hand. SI units; payload in sensor axes, from the sensor's origin.
"""

import hashlib
from dataclasses import asdict
from math import hypot
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import yaml
from pydantic import AwareDatetime, Field, model_validator

from common.config.cell_terms import AxisGain, FrameSection, NotNegative
from forcemesh.connection import ConfigSection
from forcemesh.errors import DataError
from forcemesh.messages import Vec3
from forcemesh.units import mounting_objection

if TYPE_CHECKING:
    from common.config.payload import Payload

Gains = tuple[AxisGain, AxisGain, AxisGain]
REVISION_CHARS = 8
UNIT_TOLERANCE = 1e-3  # of the length of a unit vector


ComPart = Annotated[float, Field(ge=-1.0, le=1.0)]  # [m] from the sensor's origin
ForcePart = Annotated[float, Field(ge=-1000.0, le=1000.0)]  # [N] of a bias
TorquePart = Annotated[float, Field(ge=-100.0, le=100.0)]  # [N m] of a bias
BiasForce = tuple[ForcePart, ForcePart, ForcePart]
BiasTorque = tuple[TorquePart, TorquePart, TorquePart]


class DriftSection(ConfigSection):
    """Bias drift during the recording of a fit: stored with the payload, not used at run time."""

    start_s: float
    end_s: float
    force_N: BiasForce
    torque_Nm: BiasTorque
    force_bend_N: BiasForce = (0.0, 0.0, 0.0)
    torque_bend_Nm: BiasTorque = (0.0, 0.0, 0.0)


class PayloadSection(ConfigSection):
    """Payload on the sensor and sensor bias, as written by `forcemesh payload fit --out`."""

    mass_kg: float = Field(ge=0.0, le=50.0)
    com_m: tuple[ComPart, ComPart, ComPart]
    bias_force_N: BiasForce = (0.0, 0.0, 0.0)
    bias_torque_Nm: BiasTorque = (0.0, 0.0, 0.0)
    gravity_direction_in_base: Vec3 = (0.0, 0.0, -1.0)
    mounting_rotation_rad: Vec3 = (0.0, 0.0, 0.0)
    force_gain: Gains = (1.0, 1.0, 1.0)  # reading of each axis per unit of load
    torque_gain: Gains = (1.0, 1.0, 1.0)
    drift: DriftSection | None = None
    accept_uncalibrated: bool = False  # arm for force feedback although mass and centre are zero

    @model_validator(mode="after")
    def _gravity_is_a_direction(self) -> "PayloadSection":
        length = hypot(*self.gravity_direction_in_base)
        if abs(length - 1.0) > UNIT_TOLERANCE:
            raise ValueError(f"gravity_direction_in_base must have length 1, it has {length:g}")
        return self

    @model_validator(mode="after")
    def _rotation_is_a_correction(self) -> "PayloadSection":
        if objection := mounting_objection(self.mounting_rotation_rad):
            raise ValueError(objection)
        return self

    @classmethod
    def of(cls, payload: "Payload") -> "PayloadSection":
        """Return the file section of a payload."""
        return cls(**asdict(payload))

    @property
    def payload(self) -> "Payload":
        """The run-time payload: the bias at the end of the recording, without its drift."""
        from common.config.payload import Payload  # noqa: PLC0415 - its imports take half a second

        return Payload(**self.model_dump(exclude={"accept_uncalibrated", "drift"}))

    @property
    def weighs(self) -> bool:
        """Whether mass or centre of mass is set."""
        return self.mass_kg > 0.0 or any(self.com_m)


class Residuals(ConfigSection):
    """Residuals of a payload over its poses, in free space."""

    poses: int = Field(ge=1)
    force_mean_N: NotNegative
    force_max_N: NotNegative
    torque_mean_Nm: NotNegative
    torque_max_Nm: NotNegative


class CalibrationSection(ConfigSection):
    """A payload with its provenance: tool, sensor, date, method, residuals."""

    revision: str = ""  # hash of all fields below; empty in a file: it is computed
    cell: str
    made_at: AwareDatetime
    method: Literal["arm", "manual", "recording"]  # moved by the wizard, by a person, not at all
    tool: str = ""  # name of the tool, as in the cell file
    T_flange_tcp: FrameSection
    T_flange_sensor: FrameSection
    sensor: str = ""  # serial number, if the sensor reports one
    fit: Residuals
    verified: Residuals | None = None  # at poses not used in the fit
    payload: PayloadSection

    @model_validator(mode="after")
    def _revision_belongs_to_it(self) -> "CalibrationSection":
        text = self.model_copy(update={"revision": ""}).model_dump_json()
        revision = hashlib.sha256(text.encode()).hexdigest()[:REVISION_CHARS]
        if self.revision not in ("", revision):
            raise ValueError(
                f"revision {self.revision} is of other content: the file was changed after it was "
                "written; delete the line `revision` if the change is intended, else move the file "
                "away, start the cell and calibrate"
            )
        object.__setattr__(self, "revision", revision)
        return self

    def save(self, path: Path) -> None:
        """Write the calibration file. Raises DataError when it cannot be written."""
        text = "# Written by forcemesh calibrate. SI units; payload in sensor axes.\n"
        tree = self.model_dump(mode="json", exclude_none=True)
        text += yaml.safe_dump(tree, sort_keys=False, default_flow_style=None)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            unfinished = path.with_name(f".{path.name}.new")
            unfinished.write_text(text, encoding="utf-8")
            unfinished.replace(path)  # atomic
        except OSError as error:
            raise DataError(f"{path}: cannot be written: {error.strerror}") from error
