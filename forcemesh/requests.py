"""Requests to a cell and their reply: one class per request of forcemesh/topics.py."""

from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from forcemesh.messages import (
    ArmPurpose,
    Asker,
    Gains,
    Host,
    Law,
    Mode,
    PoseRecord,
    Preset,
    Record,
    Text,
)

# Bounds beyond any real arm, tool or law: values above them are rejected on decoding.
FARTHEST_M = 100.0
LONGEST_QUATERNION = 1.01
Coordinate = Annotated[float, Field(ge=-FARTHEST_M, le=FARTHEST_M)]
Place = tuple[Coordinate, Coordinate, Coordinate]
Angle = Annotated[float, Field(ge=-100.0, le=100.0)]  # [rad]
Angles = Annotated[tuple[Angle, ...], Field(min_length=1, max_length=16)]  # one for each joint
ForceP = Annotated[float, Field(ge=0.0, le=1.0)]  # [m/N]: the packet holds 0.001
ForceI = Annotated[float, Field(ge=0.0, le=10.0)]  # [m/(N s)]: the packet holds 0.1
TorqueP = Annotated[float, Field(ge=0.0, le=10.0)]  # [rad/(N m)]: the packet holds 0.02
TorqueI = Annotated[float, Field(ge=0.0, le=1000.0)]  # [rad/(N m s)]: the packet holds 1.7
LARGEST_SETPOINT_N = 10_000.0


def _within_reach(pose: PoseRecord) -> PoseRecord:
    """Reject numbers that no pose of an arm has."""
    farthest_m = max(map(abs, pose.position_m))
    if farthest_m > FARTHEST_M:
        raise ValueError(f"a position of {farthest_m:g} m is beyond {FARTHEST_M:g} m")
    if max(map(abs, pose.orientation_xyzw)) > LONGEST_QUATERNION:
        raise ValueError(f"quaternion {pose.orientation_xyzw} is longer than one")
    return pose


AskedPose = Annotated[PoseRecord, AfterValidator(_within_reach)]


class Empty(Record):
    """A request without fields."""


class ArmRequest(Record):
    """Request to enable motion; for `jog`, moves only, which is also possible in contact."""

    purpose: ArmPurpose = "all"


class BackOffRequest(Record):
    """Request to free an arm above a ceiling or outside the workspace; the arbiter plans the path.

    Along the measured force, or straight back in, at most 20 mm at 5 mm/s
    (common/motion/back_off.py).
    """

    without_force: bool = False  # confirms a path along the tool when no force can be followed


class HoldRequest(Record):
    """Request to stop the motion and hold, whichever commander is active."""

    reason: Text = "asked to hold"


class MoveRequest(Record):
    """Request to move the flange to a pose, or the joints to or by angles."""

    kind: Literal["pose", "joints", "by"]
    pose: AskedPose | None = None
    joint_rad: Angles | None = None
    speed_m_s: float | None = Field(None, gt=0.0, le=5.0)
    commander: Asker = "operator"


class ForceStartRequest(Record):
    """Request to start force feedback; the set point acts along the tool's z axis."""

    mode: Mode
    host: Host = "pc"
    setpoint_N: float = Field(0.0, ge=0.0, le=LARGEST_SETPOINT_N)
    law: Law | None = None  # default: that of the cell file; admittance: hand guiding
    preset: Preset | None = None  # initial gains; default: those set last
    # Free axes: along and about x, y, z of the task frame, which is fixed to base or tool.
    axes: tuple[bool, bool, bool, bool, bool, bool] = (True, True, True, True, True, True)
    frame: Literal["base", "tool"] = "base"
    commander: Asker = "operator"  # the client; the regulator then commands, with the lowest rank


class PathRequest(Record):
    """Request to follow points while force feedback runs on the PC; without points: stop.

    The path acts only perpendicular to the tool axis; along that axis the force is controlled.
    """

    points_m: tuple[Place, ...] = Field((), max_length=60)  # of the TCP, base axes
    append: bool = False  # append to the remaining points; otherwise replace them
    speed_m_s: float = Field(0.02, gt=0.0, le=2.0)
    accel_m_s2: float = Field(0.3, gt=0.0, le=5.0)
    in_contact: bool = True  # pause while there is no contact


class GainsRequest(Record):
    """Request to set gains; omitted gains keep their values, or take those of the preset."""

    preset: Preset | None = None
    force_p_m_per_N: tuple[ForceP, ForceP, ForceP] | None = None
    force_i_m_per_Ns: tuple[ForceI, ForceI, ForceI] | None = None
    torque_p_rad_per_Nm: tuple[TorqueP, TorqueP, TorqueP] | None = None
    torque_i_rad_per_Nms: tuple[TorqueI, TorqueI, TorqueI] | None = None


class CalibrationRequest(Record):
    """Request to use another calibration from now on."""

    calibration_json: str = Field(max_length=3500)  # common.config.calibration.CalibrationSection


class AxesRequest(Record):
    """Report that axes and signs of the sensor were verified with this calibration."""

    calibration: Text  # revision, as in the wrench message


class RecordRequest(Record):
    """Request to record every topic until stopped."""

    label: Text = ""  # part of the file name
    past: bool = False  # begin with the content of the ring buffer


class Reply(Record):
    """Reply to every request: accepted, or refused with a code and the offending value."""

    accepted: bool
    code: Text = "ok"
    rule: int = 0
    text: Text = ""
    value: float | None = None
    limit: float | None = None
    gains: Gains | None = None  # present gains of the regulator; in the reply to a gains request
