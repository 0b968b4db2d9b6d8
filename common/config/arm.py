"""Section `robot` of a cell file, and the arm that it names.

The folder arms/<name> holds the arm's data sheet, arm.yaml, and its model, <name>.xml.
"""

from functools import cache
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, model_validator

from common.config.cell_terms import Angle
from common.config.probe import MotionsAhead
from forcemesh.connection import ConfigSection
from forcemesh.messages import Host
from forcemesh.units import SLOWEST_DEG_S, joints_in_radians
from forcemesh.yaml_file import read_model

ARMS = Path(__file__).resolve().parents[2] / "arms"
USUAL_ARM = "rs007l"  # of cell files that name none
UNKNOWN_ARM = "unknown"  # an arm without a folder

JointSpeed = Annotated[float, Field(gt=0.0, le=3000.0)]  # [degrees/s]
JointAngles = Annotated[tuple[Angle, ...], Field(min_length=6, max_length=7)]
JointSpeeds = Annotated[tuple[JointSpeed, ...], Field(min_length=6, max_length=7)]


class JointLimits(ConfigSection):
    """Range and largest speed of each of six or seven joints."""

    joint_min_deg: JointAngles
    joint_max_deg: JointAngles
    joint_speed_max_deg_s: JointSpeeds

    @model_validator(mode="after")
    def _joints_are_those_of_an_arm(self) -> "JointLimits":
        low, high, speeds = self.joint_min_deg, self.joint_max_deg, self.joint_speed_max_deg_s
        if joints_in_radians(low, high):
            raise ValueError(
                f"joint_min_deg {low} to joint_max_deg {high}: too small for an arm; "
                "is that in radians?"
            )
        if max(speeds) <= SLOWEST_DEG_S:
            raise ValueError(
                f"joint_speed_max_deg_s {speeds}: the fastest joint of an arm is faster than "
                f"{SLOWEST_DEG_S:g} degrees/s; is that in radians a second?"
            )
        if not len(low) == len(high) == len(speeds):
            raise ValueError(
                "joint_min_deg, joint_max_deg and joint_speed_max_deg_s must have one value for "
                f"each joint, they have {len(low)}, {len(high)} and {len(speeds)}"
            )
        ranges = enumerate(zip(low, high, strict=True), start=1)
        empty = [
            f"joint {n} has {low} and {high} degrees" for n, (low, high) in ranges if low >= high
        ]
        if empty:
            raise ValueError(
                f"joint_min_deg must be below joint_max_deg for each joint: {', '.join(empty)}"
            )
        return self

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.joint_min_deg)

    def outside(self, joint_deg: tuple[float, ...]) -> str:
        """Return why joint angles are outside these limits; empty when they are within."""
        if len(joint_deg) != self.joints:
            return f"there are {len(joint_deg)} joints, not {self.joints}"
        rows = zip(self.joint_min_deg, joint_deg, self.joint_max_deg, strict=True)
        for joint, (low, angle, high) in enumerate(rows, start=1):
            if not low <= angle <= high:
                return f"joint {joint} has {angle:g} degrees, its range is {low:g} to {high:g}"
        return ""


class Arm(JointLimits):
    """Data sheet of an arm."""

    home_deg: JointAngles  # start of the simulated arm: the tool points down
    controller: str = Field(min_length=1)  # controllers that drive it
    source: str = Field(min_length=1)  # of the numbers here and in the model
    licence: str = Field(min_length=1)

    @model_validator(mode="after")
    def _home_is_within_the_range(self) -> "Arm":
        if why := self.outside(self.home_deg):
            raise ValueError(f"home_deg: {why}")
        return self


def arm_names() -> list[str]:
    """Return the names of the arms that have a folder."""
    return sorted(path.parent.name for path in ARMS.glob("*/arm.yaml"))


@cache
def read_arm(name: str) -> Arm:
    """Return the data of an arm. Raise ConfigError, which lists every mistake in its arm.yaml."""
    return read_model(Arm, ARMS / name / "arm.yaml")


def model_file(name: str) -> Path:
    """Return the path of an arm's model: MJCF with joints joint1 to jointN and a site `flange`."""
    return ARMS / name / f"{name}.xml"


class RobotSection(JointLimits):
    """The arm, and robot parameters of the regulator, for any implementation of the robot.

    Joint limits that the file leaves out are those of the arm.
    """

    model: str = USUAL_ARM  # folder in arms/, or `unknown`: no kinematics, all limits in the file
    hosts: tuple[Host, ...] = ("pc",)  # hosts that can run force feedback
    delay_s: float = Field(0.0, ge=0.0, le=0.5)  # dead time from command to first motion
    lag_s: float = Field(0.012, gt=0.0, le=0.5)  # lag (area method) of servo and smoothing
    bandwidth_rad_s: float = Field(150.0, gt=0.0, le=5000.0)  # -3 dB of the same
    motions_ahead: MotionsAhead = 1  # that the controller takes from a program

    @model_validator(mode="before")
    @classmethod
    def _arm_gives_what_the_file_leaves_out(cls, values: Any) -> Any:
        name = values.get("model", USUAL_ARM) if isinstance(values, dict) else UNKNOWN_ARM
        if name == UNKNOWN_ARM:
            return values
        if name not in arm_names():
            valid = ", ".join([*arm_names(), UNKNOWN_ARM])
            raise ValueError(f"model: there is no folder arms/{name}, valid: {valid}")
        return read_arm(name).model_dump(include=set(JointLimits.model_fields)) | values

    @model_validator(mode="after")
    def _limits_are_within_those_of_the_arm(self) -> "RobotSection":
        arm = self if self.model == UNKNOWN_ARM else read_arm(self.model)
        if why := arm.outside(self.joint_min_deg) or arm.outside(self.joint_max_deg):
            raise ValueError(
                f"{why} with the arm {self.model}; name the right arm in robot.model "
                f"({UNKNOWN_ARM}: an arm without a folder in arms/)"
            )
        return self
