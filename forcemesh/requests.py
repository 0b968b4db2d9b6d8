"""Requests to a cell and their reply: one class per request of forcemesh/topics.py."""

from typing import Annotated, Any, Literal

from msgspec import Meta

from forcemesh.messages import (
    ArmPurpose,
    Asker,
    AxisControl,
    Finite,
    Gains,
    Host,
    Law,
    Message,
    Mode,
    PoseRecord,
    Position,
    Preset,
    TaskFrame,
    Text,
)
from forcemesh.records import Record

# Bounds beyond any real arm, tool or law: values above them are rejected on decoding.
LARGEST_BETWEEN_RAD = 1.6  # between two poses of a path: a larger one has no clear direction
Angle = Annotated[float, Meta(ge=-100.0, le=100.0)]  # [rad]
Angles = Annotated[tuple[Angle, ...], Meta(min_length=1, max_length=16)]  # one for each joint
ForceP = Annotated[float, Meta(ge=0.0, le=1.0)]  # [m/N]: the packet holds 0.001
ForceI = Annotated[float, Meta(ge=0.0, le=10.0)]  # [m/(N s)]: the packet holds 0.1
TorqueP = Annotated[float, Meta(ge=0.0, le=10.0)]  # [rad/(N m)]: the packet holds 0.02
TorqueI = Annotated[float, Meta(ge=0.0, le=1000.0)]  # [rad/(N m s)]: the packet holds 1.7
LARGEST_SETPOINT_N = 10_000.0


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
    pose: PoseRecord | None = None
    joint_rad: Angles | None = None
    speed_m_s: Annotated[float, Meta(gt=0.0, le=5.0)] | None = None
    commander: Asker = "operator"


class SignalRequest(Record):
    """Request to switch a digital output that the cell file names."""

    signal: Annotated[str, Meta(max_length=40)]  # name, or number in the controller
    on: bool
    commander: Asker = "operator"


class TaskAxis(Record):
    """Control of one axis of a task frame: along it in SI units of length and force, or about it.

    Omitted limits are those of the cell file; a mass and a damping below what is stable are raised.
    """

    control: AxisControl = "held"
    setpoint: Annotated[float, Meta(ge=-LARGEST_SETPOINT_N, le=LARGEST_SETPOINT_N)] = 0.0
    deadband: Annotated[float, Meta(ge=0.0, le=1000.0)] | None = None  # [N] or [N m]
    speed_max: Annotated[float, Meta(gt=0.0, le=10.0)] | None = None  # [m/s] or [rad/s]
    deviation_max: Annotated[float, Meta(gt=0.0, le=10.0)] | None = None  # from the reference
    mass: Annotated[float, Meta(gt=0.0, le=1e4)] | None = None  # [kg] or [kg m2]
    damping: Annotated[float, Meta(gt=0.0, le=1e6)] | None = None  # [N s/m] or [N m s/rad]
    stiffness: Annotated[float, Meta(ge=0.0, le=1e6)] = 0.0  # [N/m] or [N m/rad]


HELD = TaskAxis()


class ForceTask(Record):
    """Force control along and about each axis of a task frame.

    A set point is the force or torque of the tool on its environment. A compliant axis is a virtual
    mass, damper and spring about the pose at the start, which a path moves.
    """

    frame: TaskFrame = "tool"
    pose: PoseRecord | None = None  # of the frame in base, for frame `pose`
    axes: tuple[TaskAxis, TaskAxis, TaskAxis, TaskAxis, TaskAxis, TaskAxis]  # x y z rx ry rz


class ForceStartRequest(Record):
    """Request to start force feedback: a mode of the specification, or a task.

    The set point of a mode acts along the tool's z axis.
    """

    mode: Mode = "position"
    task: ForceTask | None = None  # in place of mode, set point, axes and frame
    host: Host = "pc"
    setpoint_N: Annotated[float, Meta(ge=0.0, le=LARGEST_SETPOINT_N)] = 0.0
    law: Law | None = None  # default: that of the cell file
    preset: Preset | None = None  # initial gains; default: those set last
    # Free axes: along and about x, y, z of the task frame, which is fixed to base or tool.
    axes: tuple[bool, bool, bool, bool, bool, bool] = (True, True, True, True, True, True)
    frame: Literal["base", "tool"] = "base"
    commander: Asker = "operator"  # the client; the regulator then commands, with the lowest rank


class PathRequest(Record):
    """Request to follow points or poses while force feedback runs on the PC; without both: stop.

    Points act only perpendicular to the tool axis; along that axis the force is controlled. Poses
    turn the tool as well, and act along every axis that the force does not control.
    """

    points_m: Annotated[tuple[Position, ...], Meta(max_length=60)] = ()  # of the TCP, base axes
    poses: Annotated[tuple[PoseRecord, ...], Meta(max_length=30)] = ()  # of the TCP in base
    blend_m: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.0  # before and after a corner
    append: bool = False  # append to the remaining points; otherwise replace them
    speed_m_s: Annotated[float, Meta(gt=0.0, le=2.0)] = 0.02
    accel_m_s2: Annotated[float, Meta(gt=0.0, le=5.0)] = 0.3
    in_contact: bool = True  # pause while there is no contact
    commander: Asker = "operator"


class GainsRequest(Record):
    """Request to set gains; omitted gains keep their values, or take those of the preset.

    Without any it is a question for the present ones, which every client may ask.
    """

    preset: Preset | None = None
    force_p_m_per_N: tuple[ForceP, ForceP, ForceP] | None = None
    force_i_m_per_Ns: tuple[ForceI, ForceI, ForceI] | None = None
    torque_p_rad_per_Nm: tuple[TorqueP, TorqueP, TorqueP] | None = None
    torque_i_rad_per_Nms: tuple[TorqueI, TorqueI, TorqueI] | None = None
    accept_unstable: bool = False  # otherwise gains that the gain rule calls unstable are refused
    commander: Asker = "operator"

    @property
    def changes(self) -> dict[str, Any]:
        """Preset and gains that are set, by name; empty in a question for the present ones."""
        named = self.replaced(accept_unstable=None, commander=None).as_dict()
        return {name: value for name, value in named.items() if value is not None}


class CalibrationRequest(Record):
    """Request to use another calibration from now on."""

    # common.config.calibration.CalibrationSection
    calibration_json: Annotated[str, Meta(max_length=3500)]


class AxesRequest(Record):
    """Report that axes and signs of the sensor were checked with this calibration."""

    calibration: Text  # revision, as in the wrench message
    torques: bool = False  # those of the torques as well


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
    value: Finite | None = None
    limit: Finite | None = None
    gains: Gains | None = None  # present gains of the regulator; in the reply to a gains request


class ServedRequest(Message):
    """`<role>/requests`: one request that a role has served, with its reply.

    Published only when there is one. A request beyond the bounds of forcemesh/served_requests.py is
    counted, not published.
    """

    request: Text = ""  # its key: request/arm
    sender: Text = ""  # program, process and host that sent it, by its own account
    payload: str = ""  # its fields as JSON; of one that cannot be decoded, its bytes in hexadecimal
    payload_bytes: int = 0  # length of `payload`, which is empty if it is too long
    fault: Text = ""  # why it cannot be decoded
    received_ns: int = 0  # when the role took it from its queue, before it was served
    client: Text = ""  # owner of what it starts, by its own account
    age_s: Finite | None = None  # its age then, at most; null: its client stated none
    wait_s: Finite = 0.5  # how long its client waited for the reply
    reply: Reply | None = None
    skipped: int = 0  # requests since the last message that were served and not published
