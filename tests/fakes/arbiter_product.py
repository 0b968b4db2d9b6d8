"""The real arbiter and the robot's real gate side by side, small enough to walk through entirely.

One step is one period of both: requests, the arbiter's tick, its command on the way, the gate's
verdict. Time is stretched: the permission lasts so long that one step may pass every other time
that the arbiter waits for, so a walk needs no thousands of periods.
"""

from collections import deque
from dataclasses import dataclass, field, is_dataclass, replace
from functools import cache, lru_cache
from typing import Any

import numpy as np
import pinocchio as pin

from common.config.load import cell_from_tree, cell_hash
from common.motion.convert import record_of
from common.motion.permission import NO_COMMAND_YET, CommandGate, GateDecision
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
    Record,
    RegulatorTarget,
    RobotCommand,
    RobotState,
    SensorWrench,
    WrenchAtTcp,
)
from forcemesh.requests import Reply
from forcemesh.version import __version__
from services.arbiter.core import Arbiter
from services.arbiter.inputs import Inputs, Watched
from tests.fakes.arbiter_world import CELL, FIT, STOPPED, T_START, shifted, unfit

# A way to go back when it is pushed hard, so that all three ways to stop are walked.
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
ALWAYS_SAID: dict[str, Message] = {"sensor": SensorWrench(), "wrench": FREE, "health": HEALTH}
FIT_AND_MOVING = FIT.model_copy(update={"moving": True})
START = record_of(T_START)
OUTSIDE = record_of(pin.SE3(T_START.rotation, np.array([5.0, 0.5, 0.35])))
MOTIONS = ("goal", "setpoint", "feedback")
NO_GOAL, NO_COMMAND, NO_STATUS = GoalReport(), RobotCommand(), ArbiterStatus()
UNREST = tripped("moving", "the arm has been at rest for 0.00 s")
NEVER: Reading[RobotCommand] = Reading(
    None, None, float("inf"), "robot/command missing", silent=True, code="missing"
)

WISHES: dict[str, RegulatorTarget] = {
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
# What can be wrong with what the arbiter reads. One thing at a time.
SILENT = {f"{name} silent": name for name in ("robot", "sensor", "wrench", "target", "health")}
INVALID = {f"{name} invalid": name for name in ("robot", "sensor", "wrench")}
SAYS: dict[str, tuple[str, dict[str, Any]]] = {
    "motors off": ("robot", {"status": unfit("robot_motors")}),
    "error": ("robot", {"status": unfit("robot_error")}),
    "robot holds": ("robot", {"hold": tripped("tracking", "HOLD on the pendant")}),
    "robot fails": ("robot", {"hold": tripped("link_slow", "the link is slow")}),
    "arm outside": ("robot", OUTSIDE.model_dump()),
    "pushed": ("wrench", {"force_N": (0.0, 0.0, 0.9 * FORCE_N)}),
    "crushed": ("wrench", {"force_N": (0.0, 0.0, 1.1 * FORCE_N)}),
    "late loop": ("health", {"overruns": 9}),
    "stranger": ("health", {"config_hash": "0123456789ab"}),
}
WATCHED = {
    "misaligned": Watched(faults=(tripped("misaligned", "pose and wrench are apart"),)),
    "payload": Watched(residual=tripped("payload", "9 N are left")),
}
RIVALS = {"two writers": "sensor"}
SPINS = "joint spins"  # a joint is elsewhere at each look
TROUBLES = (*SILENT, *INVALID, *SAYS, *WATCHED, *RIVALS, SPINS)
FOR_ARMING = ("stranger", "payload")  # that bar arming alone
OF_MOTION = ("pushed", SPINS)  # that end what somebody does, not that somebody might
SPUN_RAD = 2.5


class SeenArbiter(Arbiter):
    """The arbiter itself; each change of its state is written down."""

    changes: list[tuple[ArbiterState, ArbiterState]]

    def __setattr__(self, name: str, value: Any) -> None:
        """Keep the trace of `state`."""
        if name == "state":
            before = self.__dict__.get("state", value)
            self.__dict__.setdefault("changes", [])
            if before != value:
                self.changes.append((before, value))
        super().__setattr__(name, value)


@cache
def never_changes(kind: type) -> bool:
    """Tell whether a class's objects may be shared: frozen ones, numbers, poses."""
    if is_dataclass(kind):
        return bool(kind.__dataclass_params__.frozen)  # type: ignore[attr-defined]
    values = (str, int, float, tuple, frozenset, type(None), np.ndarray, pin.SE3, Record)
    return issubclass(kind, values)


def fork(thing: Any) -> Any:
    """Return a copy that shares only what never changes."""
    kind: Any = type(thing)
    if never_changes(kind):
        return thing
    if kind is dict:
        return {key: fork(value) for key, value in thing.items()}
    if kind in {list, set, deque}:
        return kind(fork(value) for value in thing)
    copied = kind.__new__(kind)
    copied.__dict__.update({name: fork(value) for name, value in vars(thing).items()})
    return copied


@lru_cache(maxsize=2)
def header_at(now_ns: int, epoch: int) -> Header:
    """Return what stands before what somebody said just now: the same for all who did."""
    return Header(seq=1, epoch=epoch, boot="walk", stamp_ns=now_ns)


def new_arbiter() -> SeenArbiter:
    """Return an arbiter that has just been started."""
    return SeenArbiter(WALKED, command_deadline_s=DEADLINE_S)


@dataclass
class Product:
    """Both state machines, the wire between them, and a robot that does as its gate says."""

    core: SeenArbiter = field(default_factory=new_arbiter)
    gate: CommandGate = field(default_factory=CommandGate)
    now_ns: int = NS_PER_S
    epoch: int = 1  # of the arbiter's process
    seq: int = 0
    trouble: str = ""
    wish: str = "stopped"
    moving: bool = False
    goal: GoalReport = NO_GOAL
    place: PoseRecord = START
    wrench_epoch: int = 1
    turned: bool = False  # a joint is elsewhere
    command: RobotCommand = NO_COMMAND  # that the arbiter gave last
    wire: tuple[Header, RobotCommand] | None = None  # what the robot heard last
    before: tuple[Header, RobotCommand] | None = None  # the last command of the owner before
    verdict: GateDecision = NO_COMMAND_YET
    status: ArbiterStatus = NO_STATUS  # that the arbiter told last
    # What must be remembered to judge, though neither machine depends on it:
    dead: frozenset[tuple[int, int]] = frozenset()  # leases that the gate has ended
    armed: int = 0  # by a person, in this life of the arbiter
    replies: list[Reply] = field(default_factory=list)

    @property
    def may_move(self) -> bool:
        """The arbiter lets somebody move the arm, or would."""
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
            )
        else:
            message = WISHES[self.wish] if name == "target" else ALWAYS_SAID[name]
        who, changes = SAYS.get(self.trouble, ("", {}))
        return message.model_copy(update=changes) if who == name else message

    def _reading(self, name: str) -> Reading[Any]:
        header = header_at(self.now_ns, self.wrench_epoch if name == "wrench" else 1)
        message, silent = self._message(name), SILENT.get(self.trouble) == name
        code = "" if message.valid else message.code or "invalid"
        if silent or INVALID.get(self.trouble) == name:
            code = "stale" if silent else "invalid"
        fault = f"{name} is {code}" if code else ""
        rival = RIVALS.get(self.trouble) == name
        return Reading(message, header, 0.0, fault, silent=silent, code=code, conflict=rival)

    def inputs(self) -> Inputs:
        """Return what the arbiter knows now."""
        seen = Inputs(
            now_ns=self.now_ns,
            robot=self._reading("robot"),
            sensor=self._reading("sensor"),
            wrench=self._reading("wrench"),
            target=self._reading("target"),
            health={"regulator": self._reading("health")},
            watched=WATCHED.get(self.trouble, Watched()),
        )
        return replace(seen, watched=replace(seen.watched, unrest=UNREST)) if self.moving else seen

    # --- one period -------------------------------------------------------------------------------

    def live(self, duration_s: float = PERIOD_S) -> Inputs:
        """Let time pass up to the next step; return what the arbiter reads then."""
        self.now_ns += round(duration_s * NS_PER_S)
        self.turned ^= self.trouble == SPINS
        self.replies = []
        self.core.changes = []
        return self.inputs()

    def close(self, inputs: Inputs, *, deliver: str = "new") -> None:
        """Let the arbiter judge, and the robot hear what it said: `new`, `lost` or `old`."""
        self.command, self.seq = self.core.tick(inputs), self.seq + 1
        self.status = self.core.status()
        self._forget_trouble()
        header = Header(seq=self.seq, epoch=self.epoch, boot="walk", stamp_ns=self.now_ns)
        said = (header, self.command)
        if deliver == "new":
            if self.wire is not None and _owner(self.wire) not in {None, _owner(said)}:
                self.before = self.wire
            self.wire = said
        reading = NEVER
        heard = self.before if deliver == "old" else self.wire
        if heard is not None:
            age_s = 0.0 if deliver == "old" else (self.now_ns - heard[0].stamp_ns) / NS_PER_S
            reading = Reading(heard[1], heard[0], age_s, "")
        self._obey(self.gate.judge(reading, self.now_ns))

    def _forget_trouble(self) -> None:
        """Let go what nobody asks about any more: it would only double the nodes."""
        state = self.core.state
        if self.may_move and self.trouble in FOR_ARMING:
            self.trouble = ""
        if state in {"ARMED", "SETTLING"} and self.trouble in OF_MOTION:
            self.trouble = ""
        self.turned &= state == "SETTLING" or self.trouble == SPINS

    def _obey(self, verdict: GateDecision) -> None:
        """Be a robot: go where a permitted set point says, begin a goal, stop on a hold."""
        was, self.verdict, command = self.verdict.command, verdict, verdict.command
        if command is None:
            if was is not None and was.permission is not None and self.verdict.accepted:
                self.dead |= {(self.verdict.accepted.epoch, was.permission.lease)}
            if self.goal.state == "running":
                self.goal = self.goal.model_copy(update={"state": "refused", "reason": "held"})
            return
        self.moving |= command.kind in MOTIONS
        if command.kind == "setpoint" and command.pose is not None:
            self.place = command.pose
        if command.goal is not None and command.goal.id != self.goal.id:
            self.goal = GoalReport(id=command.goal.id, state="running")

    def restart_arbiter(self) -> None:
        """Let another process play the arbiter."""
        self.core, self.epoch, self.seq, self.armed = new_arbiter(), self.epoch + 1, 0, 0


def _owner(said: tuple[Header, RobotCommand]) -> tuple[int, int, int] | None:
    header, command = said
    if command.permission is None:
        return None
    return header.epoch, command.permission.lease, command.permission.ownership
