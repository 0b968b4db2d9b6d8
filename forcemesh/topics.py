"""Roles of a cell, topics and requests of its bus: writer, readers, type, rate, deadline of each key.

Roles, topics and requests outside these tables do not exist. Process table, certificates, access
control, status and fault injection follow from the roles; docker-compose.yml is compared with them. Every key is prefixed with `<cell>/`.
Rates are names; the cell file gives their values in hertz. An input is stale after three of its
periods, but not before the deadline of its class in the cell file.
tests/unit/forcemesh/test_topics.py checks the rules; tools/pages.py writes docs/bus.md from this file.
"""

from dataclasses import dataclass
from typing import Generic, Literal, TypeVar

from forcemesh import messages as m
from forcemesh import requests as q
from forcemesh.records import Record

M = TypeVar("M", bound=m.Message)
Q = TypeVar("Q", bound=Record)

Rate = Literal["robot", "sensor", "control", "status", "health"]
Deadline = Literal["command", "sensor", "status", "health"]
Qos = Literal["stream", "report"]  # stream: real-time priority; both drop when congested

INFO = "info"  # query to the hub; the reply holds the facts of the cell that a client needs
SELF_TEST = "self-test"  # readable by every role, writable by none: proves that the ACL is active
DESCRIBE = "describe"  # query to the hub; the reply holds all tables and their JSON Schema
CLIENT = "client"  # any observer: command line, panel, notebook, any Zenoh program


@dataclass(frozen=True, slots=True)
class Role:
    """One row of the role table: a process that publishes on the bus, its health at least."""

    name: str
    modules: dict[str, str | None]  # by implementation in the cell file; None: the cell starts none
    is_helper: bool = False  # optional: no control loop depends on it


@dataclass(frozen=True, slots=True)
class Topic(Generic[M]):
    """One row of the topic table: exactly one role publishes a key."""

    key: str
    message: type[M]
    rate: Rate
    deadline: Deadline
    writer: str
    readers: tuple[str, ...]
    qos: Qos
    summary: str
    occasional: bool = False  # published when something happens: its silence is no fault


@dataclass(frozen=True, slots=True)
class Request(Generic[Q]):
    """One row of the request table: from a client to a role; the answer is always a `Reply`."""

    key: str
    message: type[Q]
    server: str
    summary: str
    # Of a request that stops motion, which is executed at any age: used in place of one that cannot
    # be decoded. None: late or undecodable, it is refused.
    unreadable: Q | None = None


# fmt: off
ROLE_TABLE = (
    Role("hub",       {"": "services.hub"}),
    Role("robot",     {"sim": "sim.robot", "gateway": "services.gateway", "external": None}),
    Role("sensor",    {"sim": "sim.robot", "driver": "services.sensor", "external": None}),
    Role("wrench",    {"": "services.wrench"}),
    Role("regulator", {"": "services.regulator"}),
    Role("arbiter",   {"": "services.arbiter"}),
    Role("recorder",  {"": "services.recorder"}, is_helper=True),
)
# fmt: on
ROLES = tuple(row.name for row in ROLE_TABLE if not row.is_helper)
HELPERS = tuple(row.name for row in ROLE_TABLE if row.is_helper)

UNREADABLE_HOLD = q.HoldRequest(reason="hold requested by a message that cannot be decoded")

# fmt: off
ROBOT_STATE      = Topic("robot/state",      m.RobotState,      "robot",   "command", "robot",     ("wrench", "regulator", "arbiter", CLIENT),         "stream", "flange pose in base, joints, status bits, last accepted command, link health")
ROBOT_SIGNALS    = Topic("robot/signals",    m.RobotSignals,    "status",  "status",  "robot",     (CLIENT,),                                          "report", "state of the digital signals that the cell file names, when it names any", occasional=True)
SENSOR_WRENCH    = Topic("sensor/wrench",    m.SensorWrench,    "sensor",  "sensor",  "sensor",    ("wrench", "arbiter", CLIENT),                      "stream", "load on the sensor, sensor axes, status, sample counter")
WRENCH           = Topic("wrench",           m.WrenchAtTcp,     "control", "sensor",  "wrench",    ("regulator", "arbiter", "robot", CLIENT),          "stream", "force and torque of the environment, base axes, about the TCP; raw values alongside")
REGULATOR_TARGET = Topic("regulator/target", m.RegulatorTarget, "control", "command", "regulator", ("wrench", "arbiter", CLIENT),                      "stream", "proposed flange pose, mode, contact state, reason when not valid")
CONTACT          = Topic("contact",          m.ContactEvent,    "status",  "status",  "regulator", ("wrench", CLIENT),                                 "report", "state of the contact at each change and at the status rate: impact, contact, sliding, lost")
ROBOT_COMMAND    = Topic("robot/command",    m.RobotCommand,    "control", "command", "arbiter",   ("robot", "regulator", CLIENT),                     "stream", "goal, setpoint, feedback or hold, with the permission under which the robot acts")
ARBITER_STATUS   = Topic("arbiter/status",   m.ArbiterStatus,   "status",  "status",  "arbiter",   ("regulator", CLIENT),                              "report", "state, commander, every tripped limit with its value, what clears it")

RECORDER_STATUS  = Topic("recorder/status",  m.RecorderStatus,  "health",  "health",  "recorder",  (CLIENT,),                                          "report", "state and file of the recording, lost messages, time span of the ring buffer")

ARM         = Request("request/arm",         q.ArmRequest,         "arbiter",   "enable motion, after the preflight")
HOLD        = Request("request/hold",        q.HoldRequest,        "arbiter",   "stop motion and hold; accepted from any client at any time, even when it cannot be decoded", UNREADABLE_HOLD)
BACK_OFF    = Request("request/back_off",    q.BackOffRequest,     "arbiter",   "free an arm above a ceiling or outside the workspace, along a path that the arbiter computes")
CLEAR       = Request("request/clear",       q.Empty,              "arbiter",   "acknowledge a hold or a fault, back to IDLE")
MOVE        = Request("request/move",        q.MoveRequest,        "arbiter",   "move to a pose, to joint angles, or by joint angles")
SPEED       = Request("request/speed",       m.Speed,              "arbiter",   "speeds and accelerations of the following moves; force control is no faster")
FORCE_START = Request("request/force/start", q.ForceStartRequest,  "regulator", "start force feedback with a mode, host and set point")
FORCE_STOP  = Request("request/force/stop",  q.Empty,              "regulator", "stop force feedback; the arm stays where it is; accepted from any client at any time, as a hold is", q.Empty())
GAINS       = Request("request/force/gains", q.GainsRequest,       "regulator", "set the regulator's gains")
FORCE_PATH  = Request("request/force/path",  q.PathRequest,        "regulator", "follow points across the tool axis, or poses, while the force is controlled")
SIGNAL      = Request("request/signal",      q.SignalRequest,      "robot",     "switch a digital output that the cell file names, as far as it permits")
TARE        = Request("request/tare",        q.Empty,              "wrench",    "take the present reading as zero; refused in motion or contact")
AXES        = Request("request/axes",        q.AxesRequest,        "wrench",    "record that `forcemesh check axes` verified axes and signs with the calibration in use")
CALIBRATE   = Request("request/calibration", q.CalibrationRequest, "wrench",    "use the calibration found by `forcemesh calibrate`; refused in motion or contact")
# fmt: on
RECORD_START = Request(
    "request/record/start",
    q.RecordRequest,
    "recorder",
    "record every topic to a file, from now on or from the start of the ring buffer",
)
RECORD_STOP = Request("request/record/stop", q.Empty, "recorder", "end the recording")


def _health_of(role: Role) -> Topic[m.Health]:
    # The arbiter watches every role; nothing that moves the arm waits for a helper.
    watched = not role.is_helper and role.name != "arbiter"
    readers = ("arbiter", CLIENT) if watched else (CLIENT,)
    summary = "loop rate, lateness, counters, version, config hash, last fault of this role"
    return Topic(
        f"{role.name}/health", m.Health, "health", "health", role.name, readers, "report", summary
    )


def _requests_of(role: str) -> Topic[q.ServedRequest]:
    summary = "each request that this role has served, with its reply, when there is one"
    return Topic(
        f"{role}/requests", q.ServedRequest, "status", "status", role, (CLIENT,), "report", summary,
        occasional=True,
    )  # fmt: skip


REQUESTS: tuple[Request[Record], ...] = tuple(
    value for value in list(globals().values()) if isinstance(value, Request)
)
HEALTH = {row.name: _health_of(row) for row in ROLE_TABLE}
SERVED = {role: _requests_of(role) for role in dict.fromkeys(row.server for row in REQUESTS)}
TOPICS: tuple[Topic[m.Message], ...] = tuple(
    value
    for value in (*globals().values(), *HEALTH.values(), *SERVED.values())
    if isinstance(value, Topic)
)
