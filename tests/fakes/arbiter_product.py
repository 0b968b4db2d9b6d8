"""The real arbiter and the robot's real permission check together, for an exhaustive walk.

One step is one period of both: requests, the arbiter's tick, its command in transit, the robot's
verdict. Time is scaled: the permission lasts so long that one step may exceed every other wait of
the arbiter, so a walk needs no thousands of periods.
"""

from collections import deque
from dataclasses import dataclass, field, is_dataclass
from functools import cache, lru_cache
from typing import Any

import numpy as np
import pinocchio as pin

from common.config.load import cell_from_tree, cell_hash
from common.motion.convert import record_of
from common.motion.joint_space import JointSpace
from common.motion.permission import NO_COMMAND_YET, CommandGate, GateDecision
from common.motion.unexplained import UnexplainedMotion
from forcemesh.bus import Reading
from forcemesh.clock import NS_PER_S
from forcemesh.codec import Header
from forcemesh.faults import tripped
from forcemesh.messages import (
    MAY_MOVE,
    ArbiterState,
    ArbiterStatus,
    Feedback,
    Gains,
    GoalReport,
    Health,
    Message,
    PoseRecord,
    RegulatorTarget,
    RobotCommand,
    RobotState,
    SensorWrench,
    WrenchAtTcp,
)
from forcemesh.records import Record
from forcemesh.requests import Reply
from forcemesh.version import __version__
from services.arbiter.core import Arbiter
from services.arbiter.inputs import Inputs, Watched
from tests.fakes.arbiter_world import CELL, FIT, STOPPED, T_START, shifted, with_fault

# A permitted back-off, so that all three kinds of stop are walked.
FREE = WrenchAtTcp(calibrated=True)  # nothing touches the tool
WALKED = cell_from_tree(
    CELL.model_dump()
    | {"force": CELL.model_dump()["force"] | {"retreat_m": 0.002, "retreat_m_s": 0.005}},
    "walk",
)
DEADLINE_S = 4.0
PERIOD_S = 0.004
FORCE_N = WALKED.limits.force_N
HEALTH = Health(config_hash=cell_hash(WALKED), version=__version__)
CONSTANT_MESSAGES: dict[str, Message] = {"sensor": SensorWrench(), "wrench": FREE, "health": HEALTH}
FIT_AND_MOVING = FIT.replaced(moving=True)
START = record_of(T_START)
OUTSIDE = record_of(pin.SE3(T_START.rotation, np.array([5.0, 0.5, 0.35])))
MOTIONS = ("goal", "setpoint", "feedback")
NO_GOAL, NO_COMMAND, NO_STATUS = GoalReport(), RobotCommand(), ArbiterStatus()
NEVER: Reading[RobotCommand] = Reading(
    None, None, float("inf"), "robot/command missing", silent=True, code="missing"
)

TARGETS: dict[str, RegulatorTarget] = {
    "stopped": STOPPED,
    "near": RegulatorTarget(mode="position", pose=shifted(x_m=1e-3)),
    "outside": RegulatorTarget(mode="position", pose=OUTSIDE),
    "nothing": RegulatorTarget(mode="position"),
    "feedback": RegulatorTarget(
        mode="position", host="controller", feedback=Feedback(mode="position", gains=Gains())
    ),
    "gave up": RegulatorTarget(valid=False, mode="position", reason="no contact", code="travel"),
    "swings": RegulatorTarget(valid=False, mode="position", reason="sign", code="sensor_sign"),
}
# Faults of the arbiter's inputs, one at a time.
SILENT = {f"{name} silent": name for name in ("robot", "sensor", "wrench", "target", "health")}
INVALID = {f"{name} invalid": name for name in ("robot", "sensor", "wrench")}
CHANGED_MESSAGES: dict[str, tuple[str, dict[str, Any]]] = {
    "motors off": ("robot", {"status": with_fault("robot_motors")}),
    "error": ("robot", {"status": with_fault("robot_error")}),
    "robot holds": ("robot", {"hold": tripped("tracking", "HOLD on the pendant")}),
    "robot fails": ("robot", {"hold": tripped("unexplained_motion", "3 mm")}),
    "arm outside": ("robot", OUTSIDE.as_dict()),
    "pushed": ("wrench", {"force_N": (0.0, 0.0, 0.9 * FORCE_N)}),
    "crushed": ("wrench", {"force_N": (0.0, 0.0, 1.1 * FORCE_N)}),
    "late loop": ("health", {"overruns": 9}),
    "other cell file": ("health", {"config_hash": "0123456789ab"}),
}
WATCHED = {
    "misaligned": Watched(faults=(tripped("misaligned", "pose and wrench are apart"),)),
    "payload": Watched(residual=tripped("payload", "9 N are left")),
}
RIVALS = {"two writers": "sensor"}
SPINS = "joint spins"  # a joint is elsewhere at each check
TROUBLES = (*SILENT, *INVALID, *CHANGED_MESSAGES, *WATCHED, *RIVALS, SPINS)
FOR_ARMING = ("other cell file", "payload")  # that prevent arming alone
OF_MOTION = ("pushed", SPINS)  # that end motion, not permission for motion
SPUN_RAD = 2.5


class TracedArbiter(Arbiter):
    """The arbiter with a record of each change of its state."""

    changes: list[tuple[ArbiterState, ArbiterState]]

    def __setattr__(self, name: str, value: Any) -> None:
        """Record each change of `state`."""
        if name == "state":
            before = self.__dict__.get("state", value)
            self.__dict__.setdefault("changes", [])
            if before != value:
                self.changes.append((before, value))
        super().__setattr__(name, value)


@cache
def never_changes(kind: type) -> bool:
    """Return whether a class's objects may be shared: frozen ones, numbers, poses, inputs."""
    if is_dataclass(kind) and kind is not Inputs:
        return bool(kind.__dataclass_params__.frozen)  # type: ignore[attr-defined]
    values = (str, int, float, tuple, frozenset, type(None), np.ndarray, pin.SE3, Record, Inputs)
    return issubclass(kind, (*values, JointSpace, NoMonitor))


def fork(original: Any) -> Any:
    """Return a copy that shares only immutable objects."""
    kind: Any = type(original)
    if never_changes(kind):
        return original
    if kind is dict:
        return {key: fork(value) for key, value in original.items()}
    if kind in {list, set, deque}:
        return kind(fork(value) for value in original)
    copied = kind.__new__(kind)
    for name in vars(original) if hasattr(original, "__dict__") else kind.__slots__:
        object.__setattr__(copied, name, fork(getattr(original, name)))
    return copied


@lru_cache(maxsize=2)
def header_at(now_ns: int, epoch: int) -> Header:
    """Return the header before a message of now: the same for all publishers."""
    return Header(seq=1, epoch=epoch, boot="walk", stamp_ns=now_ns)


class NoMonitor(UnexplainedMotion):
    """Finds nothing: the product's arm jumps. The robot reports what it would find."""

    def judge(self, T_base_flange: pin.SE3, at_ns: int) -> None:
        """Find nothing."""


NO_MONITOR = NoMonitor(WALKED)


def new_arbiter() -> TracedArbiter:
    """Return an arbiter that has just been started."""
    arbiter = TracedArbiter(WALKED, command_deadline_s=DEADLINE_S)
    arbiter._resting = NO_MONITOR
    return arbiter


@dataclass
class Product:
    """Both state machines, the wire between them, and a robot that follows its permission check."""

    core: TracedArbiter = field(default_factory=new_arbiter)
    gate: CommandGate = field(default_factory=lambda: CommandGate(1))
    now_ns: int = NS_PER_S
    epoch: int = 1  # of the arbiter's process
    seq: int = 0
    disturbance: str = ""
    target: str = "stopped"
    moving: bool = False
    goal: GoalReport = NO_GOAL
    place: PoseRecord = START
    wrench_epoch: int = 1
    turned: bool = False  # a joint is elsewhere
    command: RobotCommand = NO_COMMAND  # that the arbiter gave last
    wire: tuple[Header, RobotCommand] | None = None  # last command that the robot received
    before: tuple[Header, RobotCommand] | None = None  # the last command of the owner before
    verdict: GateDecision = NO_COMMAND_YET
    status: ArbiterStatus = NO_STATUS  # last permission that the arbiter published
    # Needed for the verdict, though neither machine depends on it:
    dead: frozenset[tuple[int, int]] = frozenset()  # leases that the gate has ended
    armed: int = 0  # by a person, since this start of the arbiter
    replies: list[Reply] = field(default_factory=list)

    @property
    def may_move(self) -> bool:
        """The arbiter permits or would permit a commander to move the arm."""
        return self.core.state in MAY_MOVE

    # --- what the arbiter reads -------------------------------------------------------------------

    def _message(self, name: str) -> Message:
        if name == "robot":
            message: Message = RobotState(
                position_m=self.place.position_m,
                orientation_xyzw=self.place.orientation_xyzw,
                joint_rad=(SPUN_RAD * self.turned, 0.0, 0.0, 0.0, 0.0, 0.0),
                status=FIT_AND_MOVING if self.moving else FIT,
                goal=self.goal,
                accepted=self.verdict.accepted,
                hold=self.verdict.hold,
                challenge=self.gate.challenge,
            )
        else:
            message = TARGETS[self.target] if name == "target" else CONSTANT_MESSAGES[name]
        who, changes = CHANGED_MESSAGES.get(self.disturbance, ("", {}))
        return message.replaced(**changes) if who == name else message

    def _reading(self, name: str) -> Reading[Any]:
        header = header_at(self.now_ns, self.wrench_epoch if name == "wrench" else 1)
        message, silent = self._message(name), SILENT.get(self.disturbance) == name
        code = "" if message.valid else message.code or "invalid"
        if silent or INVALID.get(self.disturbance) == name:
            code = "stale" if silent else "invalid"
        fault = f"{name} is {code}" if code else ""
        rival = RIVALS.get(self.disturbance) == name
        return Reading(message, header, 0.0, fault, silent=silent, code=code, conflict=rival)

    def inputs(self) -> Inputs:
        """Return the present inputs of the arbiter."""
        watched = WATCHED.get(self.disturbance, Watched())
        return Inputs(
            now_ns=self.now_ns,
            robot=self._reading("robot"),
            sensor=self._reading("sensor"),
            wrench=self._reading("wrench"),
            target=self._reading("target"),
            health={"regulator": self._reading("health")},
            watched=watched._replace(rest_s=0.0) if self.moving else watched,
        )

    # --- one period -------------------------------------------------------------------------------

    def live(self, duration_s: float = PERIOD_S) -> Inputs:
        """Advance to the next step; return the inputs of the arbiter."""
        self.now_ns += round(duration_s * NS_PER_S)
        self.turned ^= self.disturbance == SPINS
        self.replies = []
        self.core.changes = []
        return self.inputs()

    def close(self, inputs: Inputs, *, deliver: str = "new") -> None:
        """Step the arbiter and deliver its command to the robot: `new`, `lost` or `old`."""
        self.command, self.seq = self.core.tick(inputs), self.seq + 1
        self.status = self.core.status()
        self._delete_unread_faults()
        header = Header(seq=self.seq, epoch=self.epoch, boot="walk", stamp_ns=self.now_ns)
        sent = (header, self.command)
        if deliver == "new":
            if self.wire is not None and _owner(self.wire) not in {None, _owner(sent)}:
                self.before = self.wire
            self.wire = sent
        reading = NEVER
        delivered = self.before if deliver == "old" else self.wire
        if delivered is not None:
            age_s = 0.0 if deliver == "old" else (self.now_ns - delivered[0].stamp_ns) / NS_PER_S
            reading = Reading(delivered[1], delivered[0], age_s, "")
        self._obey(self.gate.judge(reading, self.now_ns))

    def _delete_unread_faults(self) -> None:
        """Delete faults that no code reads any more: they would only double the nodes."""
        state = self.core.state
        if self.may_move and self.disturbance in FOR_ARMING:
            self.disturbance = ""
        if state in {"ARMED", "SETTLING"} and self.disturbance in OF_MOTION:
            self.disturbance = ""
        self.turned &= state == "SETTLING" or self.disturbance == SPINS

    def _obey(self, verdict: GateDecision) -> None:
        """Move to a permitted set point, begin a goal, or stop on a hold."""
        was, self.verdict, command = self.verdict.command, verdict, verdict.command
        if command is None:
            if was is not None and was.permission is not None and self.verdict.accepted:
                self.dead |= {(self.verdict.accepted.epoch, was.permission.lease)}
            if self.goal.state == "running":
                self.goal = self.goal.replaced(state="refused", reason="held")
            return
        self.moving |= command.kind in MOTIONS
        if command.kind == "setpoint" and command.pose is not None:
            self.place = command.pose
        if command.goal is not None and command.goal.id != self.goal.id:
            self.goal = GoalReport(id=command.goal.id, state="running")

    def restart_arbiter(self) -> None:
        """Start the arbiter again as a new process."""
        self.core, self.epoch, self.seq, self.armed = new_arbiter(), self.epoch + 1, 0, 0


def _owner(sent: tuple[Header, RobotCommand]) -> tuple[int, int, int] | None:
    header, command = sent
    if command.permission is None:
        return None
    return header.epoch, command.permission.lease, command.permission.ownership
