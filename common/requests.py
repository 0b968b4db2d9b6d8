"""What may be asked of the cell, and the answer: one class per request of common/topics.py."""

from typing import Literal

from pydantic import Field

from common.messages import (
    Asker,
    Gain3,
    Gains,
    Host,
    Mode,
    PoseRecord,
    Preset,
    Purpose,
    Record,
    StartLaw,
    Text,
    Vec3,
    Vec6,
)


class Empty(Record):
    """A request that carries nothing."""


class ArmRequest(Record):
    """Let motion begin; for `jog`, moves alone, which is possible in contact as well."""

    purpose: Purpose = "all"


class HoldRequest(Record):
    """Stop the motion and hold, whoever commands."""

    reason: Text = "asked to hold"


class MoveRequest(Record):
    """Move the flange to a pose or the joints to or by angles."""

    kind: Literal["pose", "joints", "by"]
    pose: PoseRecord | None = None
    joint_rad: Vec6 | None = None
    speed_m_s: float | None = Field(None, gt=0.0, le=5.0)
    commander: Asker = "operator"


class ForceStartRequest(Record):
    """Start force feedback; the set point presses along the tool's z axis."""

    mode: Mode
    host: Host = "pc"
    setpoint_N: float = Field(0.0, ge=0.0)
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

    points_m: tuple[Vec3, ...] = Field((), max_length=60)  # of the TCP, base axes
    append: bool = False  # behind the points that are still ahead, else in their place
    speed_m_s: float = Field(0.02, gt=0.0, le=2.0)
    accel_m_s2: float = Field(0.3, gt=0.0, le=5.0)
    in_contact: bool = True  # stand still while nothing is touched


class GainsRequest(Record):
    """Set gains; what is left out keeps its value, or takes that of the preset."""

    preset: Preset | None = None
    force_p_m_per_N: Gain3 | None = None
    force_i_m_per_Ns: Gain3 | None = None
    torque_p_rad_per_Nm: Gain3 | None = None
    torque_i_rad_per_Nms: Gain3 | None = None


class CalibrationRequest(Record):
    """Use another calibration from now on."""

    calibration_json: str = Field(max_length=3500)  # common.calibration.CalibrationSection


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
