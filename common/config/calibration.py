"""Calibration of a cell's sensor: payload and bias, their validity, and the fit residuals.

`forcemesh calibrate` writes it to a separate file, named in the cell file, and so never overwrites
a file written by hand. SI units; payload in sensor axes, from the sensor's origin.
"""

import hashlib
from pathlib import Path
from typing import Annotated, Literal

import yaml
from pydantic import AwareDatetime, Field, model_validator

from common.config.cell_terms import FrameSection
from common.config.payload import Payload
from common.config.state_file import replace_file
from forcemesh.connection import ConfigSection

REVISION_CHARS = 8


Size = Annotated[float, Field(ge=0.0, le=1e6)]  # the arithmetic is tested up to here


class Residuals(ConfigSection):
    """Residuals of a payload over its poses, in free space."""

    poses: int = Field(ge=1, le=1_000_000)
    force_mean_N: Size
    force_max_N: Size
    torque_mean_Nm: Size
    torque_max_Nm: Size


class AxesCheck(ConfigSection):
    """Evidence that axes and signs of the sensor are those of the cell file."""

    calibration: str  # its revision, which covers tool, mounting and sensor
    arm: str  # model
    made_at: AwareDatetime
    method: Literal["calibrate", "arm", "push"]  # with its poses, or by `forcemesh check axes`
    torques: bool  # those of the torques as well


class CalibrationSection(ConfigSection):
    """A payload with its provenance: tool, sensor, date, method, residuals."""

    revision: str = ""  # hash of all fields below but `axes`; empty in a file: it is computed
    cell: str
    made_at: AwareDatetime
    method: Literal["arm", "manual", "recording"]  # moved by the wizard, by a person, not at all
    tool: str = ""  # name of the tool, as in the cell file
    T_flange_tcp: FrameSection
    T_flange_sensor: FrameSection
    sensor: str = ""  # serial number, if the sensor reports one
    fit: Residuals
    verified: Residuals | None = None  # at poses not used in the fit
    payload: Payload
    axes: AxesCheck | None = None

    @model_validator(mode="after")
    def _revision_belongs_to_it(self) -> "CalibrationSection":
        text = self.model_copy(update={"revision": ""}).model_dump_json(exclude={"axes"})
        revision = hashlib.sha256(text.encode()).hexdigest()[:REVISION_CHARS]
        if self.revision not in ("", revision):
            raise ValueError(
                f"revision {self.revision} is of other content: the file was changed after it was "
                "written; delete the line `revision` if the change is intended, else move the file "
                "away, start the cell and calibrate"
            )
        object.__setattr__(self, "revision", revision)
        return self

    def axes_of(self, arm: str) -> AxesCheck | None:
        """Return the check of the axes with this calibration and this model of arm, if any."""
        axes = self.axes
        of_this = axes is not None and (axes.calibration, axes.arm) == (self.revision, arm)
        return axes if of_this else None

    def with_axes(
        self,
        arm: str,
        method: Literal["calibrate", "arm", "push"],
        made_at: AwareDatetime,
        *,
        torques: bool,
    ) -> "CalibrationSection":
        """Return this calibration with the evidence of a check of the axes."""
        axes = AxesCheck(
            calibration=self.revision, arm=arm, made_at=made_at, method=method, torques=torques
        )
        return self.model_copy(update={"axes": axes})

    def save(self, path: Path) -> None:
        """Write the calibration file. Raises DataError when it cannot be written."""
        text = "# Written by forcemesh calibrate. SI units; payload in sensor axes.\n"
        tree = self.model_dump(mode="json", exclude_none=True)
        text += yaml.safe_dump(tree, sort_keys=False, default_flow_style=None)
        replace_file(path, text)


# Calibration of a cell: `none` when its file states that it works with its section `payload`, and
# None where the file that it names is not there, or where it names none.
CellCalibration = CalibrationSection | Literal["none"] | None
NO_FILE: Literal["none"] = "none"
