"""What may be asked of the cell, and the answer: one class per request of forcemesh/topics.py."""

from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from forcemesh.messages import (
    ArmPurpose,
    Asker,
    Gains,
    Host,
    Mode,
    PoseRecord,
    Preset,
    Record,
    StartLaw,
    Text,
)

# Bounds that no arm, tool or law needs: what is above them is refused before any service computes.
FARTHEST_M = 100.0
LONGEST_QUATERNION = 1.01
Coordinate = Annotated[float, Field(ge=-FARTHEST_M, le=FARTHEST_M)]
Place = tuple[Coordinate, Coordinate, Coordinate]
Angle = Annotated[float, Field(ge=-100.0, le=100.0)]  # [rad]
Angles = tuple[Angle, Angle, Angle, Angle, Angle, Angle]
ForceP = Annotated[float, Field(ge=0.0, le=1.0)]  # [m/N]: the packet holds 0.001
ForceI = Annotated[float, Field(ge=0.0, le=10.0)]  # [m/(N s)]: the packet holds 0.1
TorqueP = Annotated[float, Field(ge=0.0, le=10.0)]  # [rad/(N m)]: the packet holds 0.02
TorqueI = Annotated[float, Field(ge=0.0, le=1000.0)]  # [rad/(N m s)]: the packet holds 1.7
LARGEST_SETPOINT_N = 10_000.0


def _within_reach(pose: PoseRecord) -> PoseRecord:
    """Refuse numbers that no pose of an arm has."""
    farthest_m = max(map(abs, pose.position_m))
    if farthest_m > FARTHEST_M:
        raise ValueError(f"a position of {farthest_m:g} m is beyond {FARTHEST_M:g} m")
    if max(map(abs, pose.orientation_xyzw)) > LONGEST_QUATERNION:
        raise ValueError(f"quaternion {pose.orientation_xyzw} is longer than one")
    return pose


AskedPose = Annotated[PoseRecord, AfterValidator(_within_reach)]


class Empty(Record):
    """A request that carries nothing."""


class ArmRequest(Record):
    """Let motion begin; for `jog`, moves alone, which is possible in contact as well."""

    purpose: ArmPurpose = "all"


class BackOffRequest(Record):
    """Free an arm above a ceiling or outside the workspace; the arbiter computes the way.

    Along the measured force, or straight back in, at most 20 mm at 5 mm/s
    (common/motion/back_off.py).
    """

    without_force: bool = False  # confirmed again: where no force can be followed, along the tool


class HoldRequest(Record):
    """Stop the motion and hold, whoever commands."""

    reason: Text = "asked to hold"


class MoveRequest(Record):
    """Move the flange to a pose or the joints to or by angles."""

    kind: Literal["pose", "joints", "by"]
    pose: AskedPose | None = None
    joint_rad: Angles | None = None
    speed_m_s: float | None = Field(None, gt=0.0, le=5.0)
    commander: Asker = "operator"


class ForceStartRequest(Record):
    """Start force feedback; the set point presses along the tool's z axis."""

    mode: Mode
    host: Host = "pc"
    setpoint_N: float = Field(0.0, ge=0.0, le=LARGEST_SETPOINT_N)
    law: StartLaw | None = None  # without it the cell file's; guide: give way to a hand
    preset: Preset | None = None  # gains to begin with; without it those that were set last
    # What may move: x, y, z and about x, y, z of the task frame, which turns with the tool or not.
    axes: tuple[bool, bool, bool, bool, bool, bool] = (True, True, True, True, True, True)
    frame: Literal["base", "tool"] = "base"
    commander: Asker = "operator"  # who asks; what then commands is the regulator, of lowest rank


class PathRequest(Record):
    """Go along points while force feedback runs on the PC: no points: stand.

    It goes across the tool's axis alone; along that axis the force has the say.
    """

    points_m: tuple[Place, ...] = Field((), max_length=60)  # of the TCP, base axes
    append: bool = False  # behind the points that are still ahead, else in their place
    speed_m_s: float = Field(0.02, gt=0.0, le=2.0)
    accel_m_s2: float = Field(0.3, gt=0.0, le=5.0)
    in_contact: bool = True  # stand still while nothing is touched


class GainsRequest(Record):
    """Set gains; what is left out keeps its value, or takes that of the preset."""

    preset: Preset | None = None
    force_p_m_per_N: tuple[ForceP, ForceP, ForceP] | None = None
    force_i_m_per_Ns: tuple[ForceI, ForceI, ForceI] | None = None
    torque_p_rad_per_Nm: tuple[TorqueP, TorqueP, TorqueP] | None = None
    torque_i_rad_per_Nms: tuple[TorqueI, TorqueI, TorqueI] | None = None


class CalibrationRequest(Record):
    """Use another calibration from now on."""

    calibration_json: str = Field(max_length=3500)  # common.config.calibration.CalibrationSection


class AxesRequest(Record):
    """Axes and signs of the sensor were checked while this calibration was in use."""

    calibration: Text  # as the wrench names it


class RecordRequest(Record):
    """Record every topic until told to stop."""

    label: Text = ""  # goes into the name of the file
    past: bool = False  # begin with what memory still holds


class Reply(Record):
    """Answer to every request: accepted, or refused with a code and the number that broke it."""

    accepted: bool
    code: Text = "ok"
    rule: int = 0
    text: Text = ""
    value: float | None = None
    limit: float | None = None
    gains: Gains | None = None  # of the regulator, as they are now; to a request about gains
