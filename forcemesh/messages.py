"""Messages of the bus: one class per message, one class per frame, units in the names.

Every message that is published or received is well-formed: encoding and decoding check the type of
every field, that every number is finite and every quaternion of unit length. A constructor checks
nothing. A publisher without a valid result publishes `valid=False` with a reason at its usual rate:
an idle service must differ from a dead one.

Sign convention: a positive force or torque means that the environment pushes the robot.
"""

import sys
from typing import Annotated, Literal

from msgspec import Meta, field

from forcemesh.patterns import LAW_NAME, NO_BREAK
from forcemesh.records import ROTATION, Record

LARGEST = sys.float_info.max
Finite = Annotated[float, Meta(ge=-LARGEST, le=LARGEST)]  # neither infinite nor NaN
Vec3 = tuple[Finite, Finite, Finite]
FARTHEST_M = 100.0  # beyond any pose of an arm
Coordinate = Annotated[float, Meta(ge=-FARTHEST_M, le=FARTHEST_M)]
Position = tuple[Coordinate, Coordinate, Coordinate]
Joints = Annotated[tuple[Finite, ...], Meta(max_length=16)]  # one angle for each joint [rad]
Quaternion = Annotated[tuple[Finite, Finite, Finite, Finite], ROTATION]
Gain = Annotated[float, Meta(ge=0.0, le=LARGEST)]  # a negative gain would push instead of yield
Gain3 = tuple[Gain, Gain, Gain]
Fraction = Annotated[float, Meta(gt=0.0, le=1.0)]
Text = Annotated[str, Meta(max_length=500)]
Challenge = Annotated[int, Meta(ge=0, lt=2**53)]  # exact where every number is a float; 0: none
MAX_ITEMS = 64  # of any list or map
MAX_SIGNALS = 24  # in one message, which stays below 1 kB
Texts = Annotated[tuple[Text, ...], Meta(max_length=MAX_ITEMS)]
Counters = Annotated[dict[str, int], Meta(max_length=MAX_ITEMS)]
Numbers = Annotated[dict[str, Finite], Meta(max_length=MAX_ITEMS)]

Mode = Literal["position", "orientation", "both"]
Host = Literal["pc", "controller"]
Law = Annotated[str, Meta(pattern=LAW_NAME + NO_BREAK)]  # the regulator refuses one that it lacks
LAWS_THAT_SHIP = ("plain", "adaptive")
Preset = Literal["gentle", "normal", "stiff"]  # of gains
Commander = Literal["none", "regulator", "program", "operator"]
Asker = Literal["operator", "program"]  # clients that may request motion
ArmPurpose = Literal["all", "jog"]  # purpose of arming
Purpose = Literal["all", "jog", "back_off"]  # the same, plus the arbiter's back-off

AxisControl = Literal["held", "force", "compliant"]  # of one axis of a task frame
TaskFrame = Literal["base", "tool", "sensor", "pose", "path"]

ZERO3: Vec3 = (0.0, 0.0, 0.0)
UNIT_QUATERNION: Quaternion = (0.0, 0.0, 0.0, 1.0)


class Message(Record):
    """Base of every topic's message.

    A new field has a default, so that older recordings open. A renamed or restructured field raises
    SCHEMA_VERSION of forcemesh/codec.py and gets a rule in forcemesh/recorded_messages.py.
    """

    valid: bool = True
    reason: Text = ""  # why it is not valid
    code: Text = ""  # the reason as a code of forcemesh/faults.py


class PoseRecord(Record):
    """Pose of a frame in base: position [m] and unit quaternion x, y, z, w."""

    position_m: Position
    orientation_xyzw: Quaternion


class Trip(Record):
    """A rule that stopped the arm or keeps it from moving: code, and the value that broke it."""

    code: Text  # row of forcemesh/faults.py
    rule: int  # number of that row
    text: Text
    value: Finite | None = None
    limit: Finite | None = None
    unit: Text = ""  # of value and limit, empty while the text names it


Trips = Annotated[tuple[Trip, ...], Meta(max_length=MAX_ITEMS)]


class KawasakiStatus(Record):
    """Status bits of a Kawasaki controller beyond those of any robot, and its error."""

    motor_power: bool = False
    repeat_mode: bool = False
    teach_lock_off: bool = False
    program_running: bool = False
    watchdog_latched: bool = False
    target_refused: bool = False
    error: bool = False
    error_code: int = 0  # 0: none


CONTROLLER_BITS = tuple(name for name in KawasakiStatus.__struct_fields__ if name != "error_code")


class RobotStatus(Record):
    """Status of any robot: whether it would follow a command, and what prevents it."""

    ready: bool = False  # drives on, automatic mode, program running, no fault
    moving: bool = False
    held: bool = False
    feedback: Mode | None = None  # force feedback that runs inside the controller
    faults: Trips = ()  # what keeps it from being ready
    kawasaki: KawasakiStatus | None = None  # None for other robots


class Accepted(Record):
    """Echo of the last command that the robot accepted, with the sensor sample it is based on."""

    epoch: int
    seq: int
    ownership: int = 0  # of its permission
    at_ns: int  # robot's monotonic clock
    sensor_stamp_ns: int | None = None
    sensor_seq: int | None = None


GoalState = Literal["none", "queued", "running", "done", "refused"]


class GoalReport(Record):
    """State of the last goal sent to the robot."""

    id: int = 0
    state: GoalState = "none"
    reason: Text = ""


class LinkHealth(Record):
    """Health of the link from this process to the arm."""

    connected: bool = False
    round_trip_s: Finite | None = None
    reconnects: int = 0
    errors: int = 0


class RobotState(Message):
    """`robot/state`: flange pose in base, joint angles, status, echo of the last command."""

    position_m: Vec3 = ZERO3
    orientation_xyzw: Quaternion = UNIT_QUATERNION
    joint_rad: Joints = ()  # one angle for each joint of the arm
    status: RobotStatus = RobotStatus()
    goal: GoalReport = GoalReport()
    accepted: Accepted | None = None
    sent: PoseRecord | None = None  # last set point sent to the arm, flange in base
    hold: Trip | None = None  # why the robot holds; None while it may move
    link: LinkHealth = LinkHealth()
    challenge: Challenge = 0  # drawn at the start of the process and after each dead lease

    @property
    def hold_reason(self) -> str:
        """Text of `hold`, empty while the robot may move."""
        return "" if self.hold is None else self.hold.text

    @property
    def hold_code(self) -> str:
        """Code of `hold`, empty while the robot may move."""
        return "" if self.hold is None else self.hold.code


class RobotSignals(Message):
    """`robot/signals`: digital signals that the cell file names, by name; True is on.

    Not valid and empty while the robot does not report them: a state is never assumed.
    """

    on: Annotated[dict[Text, bool], Meta(max_length=MAX_ITEMS)] = field(default_factory=dict)


class SensorWrench(Message):
    """`sensor/wrench`: load on the sensor about its origin, in sensor axes, weight included."""

    force_N: Vec3 = ZERO3
    torque_Nm: Vec3 = ZERO3
    status: Literal["ok", "saturated", "fault"] = "ok"
    counter: int = 0
    serial: Text = ""  # serial number of the sensor, empty while unknown


class WrenchAtTcp(Message):
    """`wrench`: force and torque of the environment on the tool, base axes, about the TCP.

    Filtered; bias and tool weight are subtracted; the raw reading is kept alongside.
    """

    force_N: Vec3 = ZERO3
    torque_Nm: Vec3 = ZERO3
    raw_force_N: Vec3 = ZERO3  # as read, sensor axes
    raw_torque_Nm: Vec3 = ZERO3  # as read, sensor axes, about the sensor origin
    calibration: Text = ""  # revision of the subtracted payload and bias
    tared: bool = False  # the bias is from a tare since
    calibrated: bool = False  # whether force feedback may rely on it
    calibration_fault: Text = ""  # why not
    axes_checked: bool = False  # axes and signs of the force are known to be right with it
    torques_checked: bool = False  # those of the torque as well
    mounting_rotation_rad: Vec3 = ZERO3  # of it: from the axes of the cell file to the true ones


class Gains(Record):
    """PI gains about the base axes x, y, z (specification 1.4 f).

    Force: m/N and m/(N s). Torque: rad/(N m) and rad/(N m s).
    """

    force_p_m_per_N: Gain3 = ZERO3
    force_i_m_per_Ns: Gain3 = ZERO3
    torque_p_rad_per_Nm: Gain3 = ZERO3
    torque_i_rad_per_Nms: Gain3 = ZERO3


class Feedback(Record):
    """Parameters of the force feedback that the host `controller` runs."""

    mode: Mode
    setpoint_force_N: Vec3 = ZERO3  # force of the environment on the tool, base axes
    setpoint_torque_Nm: Vec3 = ZERO3  # its torque about the TCP, base axes
    lever_m: Vec3 = ZERO3  # from the TCP to the tool's centre of rotation, flange axes
    gains: Gains
    # Limit of command 5 to the speed of the tool; None: that of the robot alone.
    speed_m_s: Annotated[float, Meta(gt=0.0, le=5.0)] | None = None


class AxisState(Record):
    """Present state of one axis of the task frame: in N and m along it, in N m and rad about it."""

    control: AxisControl
    setpoint: Finite  # ramped
    exerted: Finite  # force or torque of the tool on its environment
    deviation: Finite  # from the reference
    at_limit: bool = False  # of its deviation


class RegulatorTarget(Message):
    """`regulator/target`: the pose that the regulator proposes, not valid while it is stopped."""

    mode: Mode | None = None
    host: Host = "pc"
    law: Law | None = None
    setpoint_N: Finite | None = None  # requested, along the tool's z axis; reached by a ramp
    pose: PoseRecord | None = None  # flange in base
    feedback: Feedback | None = None
    contact: Literal["free", "approach", "contact"] = "free"
    error_force_N: Vec3 = ZERO3
    error_torque_Nm: Vec3 = ZERO3
    frame: TaskFrame | None = None  # of a task, None for a mode
    axes: tuple[AxisState, ...] = ()  # of a task: x y z, about x y z
    path_left_m: Finite | None = None  # remaining length of the path
    path_missed_m: Finite | None = None  # travelled without contact or with another force
    path_speed_m_s: Finite | None = None  # present speed along the path
    wrench_stamp_ns: int | None = None  # stamp of the wrench that the pose follows
    round_trip_s: Finite | None = None  # estimated delay of the loop, while force feedback runs
    modelled_round_trip_s: Finite | None = None  # the same by the cell file
    gain_share: Fraction = 1.0  # of the gains: less while the delay is longer, or after oscillation


ContactState = Literal["unknown", "free", "approach", "impact", "contact", "sliding", "lost"]
TOUCHING: tuple[ContactState, ...] = ("impact", "contact", "sliding")


class ContactEvent(Message):
    """`contact`: state of the contact, numbered by its changes, with what ended before it.

    Published at each change and at the status rate; not valid while the state is unknown. Times are
    those of the wrench, forces are lengths of its force, poses are measured ones.
    """

    number: int = 0  # of this change, since the start of the regulator
    state: ContactState = "unknown"
    since_ns: int = 0  # stamp of the wrench with which it began
    duration_s: Finite = 0.0  # until this message
    peak_N: Finite = 0.0  # largest force since it began while the tool touches, else 0
    position_m: Vec3 = ZERO3  # of the TCP in base when it began
    normal: Vec3 = ZERO3  # out of the surface, base axes, when it began; zero: not known
    before: ContactState = "unknown"
    before_s: Finite = 0.0  # duration of the state before
    before_peak_N: Finite = 0.0  # its largest force while the tool touched, else 0
    impact_m_s: Finite = 0.0  # speed against the normal before the last impact
    slid_m: Finite = 0.0  # path of the contact across the normal since that impact


class Speed(Record):
    """Speeds and accelerations of goals (specification 1.4 e).

    The real speed is the mechanical one times the modular fraction.
    """

    accel_fraction: Fraction = 1.0
    decel_fraction: Fraction = 1.0
    modular_fraction: Fraction = 1.0
    mechanical_m_s: Annotated[float, Meta(gt=0.0, le=5.0)] = 0.05


class Goal(Record):
    """A move as one packet: commands 1 to 3 of the specification."""

    id: int
    kind: Literal["pose", "joints", "by"]
    pose: PoseRecord | None = None  # flange in base, for kind "pose"
    joint_rad: Joints | None = None  # for kinds "joints" (absolute) and "by" (relative)


class Permission(Record):
    """Permission to move, with a deadline: without it the robot holds."""

    host: Host
    lease: int  # a new number at each arming
    deadline_s: Finite
    ownership: int = 0  # a new number each time ownership ends; at most one owner each
    purpose: Purpose = (
        "all"  # of the lease; back_off: other limits apply (common/motion/back_off.py)
    )
    challenge: Challenge = 0  # of the robot when the arm was armed: of no other start or lease


class RobotCommand(Message):
    """`robot/command`: command released by the arbiter. A hold carries no permission."""

    kind: Literal["hold", "idle", "goal", "setpoint", "feedback"] = "hold"
    commander: Commander = "none"
    permission: Permission | None = None
    speed: Speed = Speed()
    goal: Goal | None = None
    pose: PoseRecord | None = None  # flange in base, for kind "setpoint"
    limited: bool = False  # clipped by a limit: the regulator continues from this pose
    feedback: Feedback | None = None


ArbiterState = Literal[
    "BOOT", "IDLE", "ARMED", "SETTLING", "ACTIVE", "STOPPING", "HOLDING", "FAULT"
]
OPERATIONAL: tuple[ArbiterState, ...] = ("ARMED", "SETTLING", "ACTIVE")
MAY_MOVE: tuple[ArbiterState, ...] = (*OPERATIONAL, "STOPPING")


class ArbiterStatus(Message):
    """`arbiter/status`: state, commander, the trips that stopped the arm, and what clears them."""

    state: ArbiterState = "BOOT"
    commander: Commander = "none"
    next_commander: Commander = "none"  # takes over when the arm is at rest
    goal_id: int = 0  # the current or pending move; 0 for none
    lease: int = 0
    ownership: int = 0  # of the present owner under this lease
    armed_for: Purpose = "all"
    trips: Trips = ()
    not_ready: Texts = ()  # reasons why arming would be refused
    clears: Text = ""

    @property
    def may_move(self) -> bool:
        """Whether the arm may still move, if only to come to rest."""
        return self.state in MAY_MOVE

    @property
    def operational(self) -> bool:
        """Whether the arm may move and no trip has stopped it."""
        return self.state in OPERATIONAL


class RecorderStatus(Message):
    """`recorder/status`: state of recording and ring buffer; not valid when it cannot write."""

    recording: bool = False
    cause: Text = ""  # "asked", or the code of the fault that triggered the recording
    file: Text = ""  # the present or last file
    file_bytes: int = 0
    messages: int = 0  # in this recording, all of its files together
    lost: int = 0  # of them, from gaps in the sequence numbers
    recorded_s: Finite = 0.0
    memory_s: Finite = 0.0  # time span of the ring buffer
    memory_bytes: int = 0  # size of the ring buffer
    free_bytes: int = 0  # on the disk


class Health(Message):
    """`<role>/health`: published by each process from its own loop."""

    pid: int = 0
    rate_hz: Finite = 0.0
    lateness_p99_s: Finite = 0.0
    overruns: int = 0  # periods far too long, within the last second
    longest_gap_s: Finite = 0.0  # between two steps, within the last second
    late_cause: Text = ""  # of the last overrun within this second
    counters: Counters = field(default_factory=dict)
    # measured, units in the names; unknown values are omitted
    numbers: Numbers = field(default_factory=dict)
    version: Text = ""
    config_hash: Text = ""
    fault: Text = ""
