"""Arbiter and gate together, stepped event by event, for an exhaustive walk (test_states_walk.py).

Two nodes are the same when every quantity that decides is the same: times only by whether each wait
is over, numbers of leases and of ownership only by whether they are the present ones. One step is
one period of both machines. Time is scaled: the permission outlasts every other wait.
"""

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, is_dataclass
from functools import cache, lru_cache
from typing import Any

import numpy as np
import pinocchio as pin

from common.config.load import cell_from_tree, cell_hash
from common.motion.back_off import LONGEST_BACK_OFF_S
from common.motion.convert import record_of
from common.motion.joint_space import JointSpace
from common.motion.permission import NO_COMMAND_YET, CommandGate, GateDecision
from forcemesh.bus import Reading
from forcemesh.clock import NS_PER_S
from forcemesh.codec import Header
from forcemesh.faults import tripped
from forcemesh.messages import (
    MAY_MOVE,
    ArbiterStatus,
    Feedback,
    Gains,
    GoalReport,
    Health,
    PoseRecord,
    RegulatorTarget,
    RobotCommand,
    RobotState,
    SensorWrench,
)
from forcemesh.records import Record
from forcemesh.requests import Reply
from forcemesh.version import __version__
from services.arbiter.commanders import REST_S, SETTLE_WITHIN_S
from services.arbiter.core import OWN_HOLDS, ROBOT_ANSWERS_WITHIN_S, Arbiter
from services.arbiter.inputs import Inputs, Monitored
from services.arbiter.preflight import PREFLIGHT_S
from services.arbiter.stream import RETREAT_WITHIN_S
from tests.fakes.arbiter_world import (
    CELL,
    FIT,
    FREE,
    MOVE_DOWN,
    STOPPED,
    T_START,
    shifted,
    with_fault,
)

RETREATS = {"retreat_m": 0.002, "retreat_m_s": 0.005}  # so that all three kinds of stop are walked
TREE = CELL.model_dump()
WALKED = cell_from_tree(TREE | {"force": TREE["force"] | RETREATS}, "walk")
DEADLINE_S = 4.0
A_WHILE_S = 0.35  # a rest counts, and a robot that holds has had its time to reply
LONG_S = 3.2  # every wait of the arbiter is over
TOO_LONG_S = DEADLINE_S + 0.1  # the permission is over
MOTIONS = ("goal", "setpoint", "feedback")
START = record_of(T_START)
OUTSIDE = record_of(pin.SE3(T_START.rotation, np.array([5.0, 0.5, 0.35])))
CONSTANT = {
    "sensor": SensorWrench(),
    "wrench": FREE,
    "health": Health(config_hash=cell_hash(WALKED), version=__version__),
}
TARGETS = {
    "stopped": STOPPED,
    "near": RegulatorTarget(mode="position", pose=shifted(x_m=1e-3)),
    "feedback": RegulatorTarget(
        mode="position", host="controller", feedback=Feedback(mode="position", gains=Gains())
    ),
    "outside": RegulatorTarget(mode="position", pose=OUTSIDE),
    "nothing": RegulatorTarget(mode="position"),
    "gave up": RegulatorTarget(valid=False, mode="position", reason="no contact", code="travel"),
    "swings": RegulatorTarget(valid=False, mode="position", reason="sign", code="sensor_sign"),
}
AT_REST_TARGETS = ("stopped", "near", "feedback")
# Faults of the inputs, one at a time.
SILENT = {f"{name} silent": name for name in ("robot", "sensor", "wrench", "target", "health")}
FORCE_N = WALKED.limits.force_N
CHANGED: dict[str, tuple[str, dict[str, Any]]] = {
    "wrench invalid": ("wrench", {"valid": False, "reason": "no cable"}),
    "motors off": ("robot", {"status": with_fault("robot_motors")}),
    "robot holds": ("robot", {"hold": tripped("tracking", "HOLD on the pendant")}),
    "robot fails": ("robot", {"hold": tripped("unexplained_motion", "3 mm")}),
    "arm outside": ("robot", OUTSIDE.as_dict()),
    "pushed": ("wrench", {"force_N": (0.0, 0.0, 0.9 * FORCE_N)}),
    "crushed": ("wrench", {"force_N": (0.0, 0.0, 1.1 * FORCE_N)}),
    "late loop": ("health", {"overruns": 9}),
    "other cell file": ("health", {"config_hash": "0123456789ab"}),
}
OF_MOTION, OF_ARMING = ("pushed",), ("other cell file",)


# --- arbiter, gate, and a robot that follows its gate ---------------------------------------------


def new_arbiter() -> Arbiter:
    """Return an arbiter that has just been started."""
    return Arbiter(WALKED, command_deadline_s=DEADLINE_S)


@cache
def never_changes(kind: type) -> bool:
    """Return whether a class's objects may be shared."""
    if is_dataclass(kind) and kind is not Inputs:
        return bool(kind.__dataclass_params__.frozen)  # type: ignore[attr-defined]
    values = (str, int, float, tuple, frozenset, type(None), np.ndarray, pin.SE3, Record, Inputs)
    return issubclass(kind, (*values, JointSpace))


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


@dataclass
class Product:
    """Both state machines, the wire between them, and the robot."""

    core: Arbiter = field(default_factory=new_arbiter)
    gate: CommandGate = field(default_factory=lambda: CommandGate(1))
    now_ns: int = NS_PER_S
    epoch: int = 1  # of the arbiter's process
    seq: int = 0
    disturbance: str = ""
    target: str = "stopped"
    moving: bool = False
    goal: GoalReport = GoalReport()  # noqa: RUF009 - immutable
    place: PoseRecord = START
    wrench_epoch: int = 1
    command: RobotCommand = RobotCommand()  # noqa: RUF009
    wire: tuple[Header, RobotCommand] | None = None  # last command that the robot received
    verdict: GateDecision = NO_COMMAND_YET
    status: ArbiterStatus = ArbiterStatus()  # noqa: RUF009
    # For the rules, though neither machine depends on it:
    dead: frozenset[tuple[int, int]] = frozenset()  # leases that the gate has ended
    armed: int = 0  # by a person, since this start of the arbiter
    replies: list[Reply] = field(default_factory=list)

    @property
    def may_move(self) -> bool:
        """The arbiter permits or would permit a commander to move the arm."""
        return self.core.state in MAY_MOVE

    def _reading(self, name: str, message: Any) -> Reading[Any]:
        who, changes = CHANGED.get(self.disturbance, ("", {}))
        message = message.replaced(**changes) if who == name else message
        silent = SILENT.get(self.disturbance) == name
        code = "" if message.valid else message.code or "invalid"
        code = "stale" if silent else code
        header = header_at(self.now_ns, self.wrench_epoch if name == "wrench" else 1)
        fault = f"{name} is {code}" if code else ""
        return Reading(message, header, 0.0, fault, silent=silent, code=code)

    def live(self, duration_s: float = 0.004) -> Inputs:
        """Advance to the next step; return the inputs of the arbiter."""
        self.now_ns += round(duration_s * NS_PER_S)
        self.replies = []
        robot = RobotState(
            position_m=self.place.position_m,
            orientation_xyzw=self.place.orientation_xyzw,
            joint_rad=(0.0,) * 6,
            status=FIT.replaced(moving=self.moving),
            goal=self.goal,
            accepted=self.verdict.accepted,
            hold=self.verdict.hold,
            challenge=self.gate.challenge,
        )
        return Inputs(
            now_ns=self.now_ns,
            robot=self._reading("robot", robot),
            sensor=self._reading("sensor", CONSTANT["sensor"]),
            wrench=self._reading("wrench", CONSTANT["wrench"]),
            target=self._reading("target", TARGETS[self.target]),
            health={"regulator": self._reading("health", CONSTANT["health"])},
            monitored=Monitored(rest_s=0.0) if self.moving else Monitored(),
        )

    def close(self, inputs: Inputs, *, lost: bool = False) -> None:
        """Step the arbiter; the robot judges its command, or, where that is lost, the last one."""
        self.command, self.seq = self.core.tick(inputs), self.seq + 1
        self.status = self.core.status()
        header = Header(seq=self.seq, epoch=self.epoch, boot="walk", stamp_ns=self.now_ns)
        if not lost:
            self.wire = (header, self.command)
        reading: Reading[RobotCommand] = Reading(None, None, 9.0, "missing", code="missing")
        if self.wire is not None:
            age_s = (self.now_ns - self.wire[0].stamp_ns) / NS_PER_S
            reading = Reading(self.wire[1], self.wire[0], age_s, "")
        self._obey(self.gate.judge(reading, self.now_ns))

    def _obey(self, verdict: GateDecision) -> None:
        """Move to a permitted set point, begin a goal, or stop on a hold."""
        was, self.verdict, command = self.verdict.command, verdict, verdict.command
        if command is None:
            if was is not None and was.permission is not None and verdict.accepted:
                self.dead |= {(verdict.accepted.epoch, was.permission.lease)}
            if self.goal.state == "running":
                self.goal = self.goal.replaced(state="refused", reason="held")
            return
        self.moving |= command.kind in MOTIONS
        if command.kind == "setpoint" and command.pose is not None:
            self.place = command.pose
        if command.goal is not None and command.goal.id != self.goal.id:
            self.goal = GoalReport(id=command.goal.id, state="running")


# --- events ---------------------------------------------------------------------------------------

Event = Callable[[Product], None]


def _request(product: Product, name: str, inputs: Inputs) -> Reply:
    """Send a request; count what a person arms."""
    core, lease = product.core, product.core.status().lease
    match name.split():
        case ["arm", purpose]:
            reply = core.arm(inputs, "jog" if purpose == "jog" else "all")
        case ["back", "off"]:
            reply = core.back_off(inputs, confirmed=True)
        case ["hold"]:
            reply = core.hold("a client")
        case ["clear"]:
            reply = core.clear(inputs)
        case _:
            commander: Any = name.split(maxsplit=1)[0]
            reply = core.move(MOVE_DOWN.replaced(commander=commander), inputs)
    product.armed += core.status().lease - lease
    return reply


def _requests(names: str) -> Event:
    def happen(product: Product) -> None:
        inputs = product.live()
        product.replies = [_request(product, name, inputs) for name in names.split(" + ")]
        product.close(inputs)

    return happen


def _passes(duration_s: float = 0.004, *, lost: bool = False, **changes: Any) -> Event:
    def happen(product: Product) -> None:
        for name, value in changes.items():
            setattr(product, name, value)
        product.close(product.live(duration_s), lost=lost)

    return happen


def _restarts(product: Product) -> None:
    product.core, product.epoch, product.seq, product.armed = new_arbiter(), product.epoch + 1, 0, 0
    product.close(product.live())


REQUESTS = (
    "arm all", "arm jog", "back off", "hold", "clear", "operator moves", "program moves",
    "clear + arm all", "arm all + hold", "arm all + operator moves", "operator moves + hold",
)  # fmt: skip
ALWAYS: dict[str, Event] = {
    **{names: _requests(names) for names in REQUESTS},
    "a period": _passes(),
    "a while": _passes(A_WHILE_S),
    "long": _passes(LONG_S),
    "command lost": _passes(lost=True),
    "silence": _passes(TOO_LONG_S, lost=True),
    "arbiter restarts": _restarts,
}


def happenings(product: Product) -> Iterator[tuple[str, Event]]:
    """Yield the possible events, without those that change nothing."""
    yield from ALWAYS.items()
    yield ("rests", _passes(moving=False)) if product.moving else ("moves", _passes(moving=True))
    if product.goal.state == "running":
        for state in ("done", "refused"):
            yield f"goal {state}", _passes(goal=product.goal.replaced(state=state))
    if product.disturbance:
        yield "trouble removed", _passes(disturbance="")
        return
    for target in TARGETS if product.status.commander == "regulator" else AT_REST_TARGETS:
        if target != product.target:
            yield f"regulator: {target}", _passes(target=target)
    left_out = OF_ARMING if product.may_move else OF_MOTION
    for disturbance in (*SILENT, *CHANGED):
        if disturbance not in left_out:
            yield disturbance, _passes(disturbance=disturbance)
    if product.may_move:
        yield "another wrench", _passes(wrench_epoch=3 - product.wrench_epoch)


# --- which nodes are the same ---------------------------------------------------------------------

Key = tuple[Any, ...]


def _over(since_ns: int | None, now_ns: int, wait_s: float) -> bool | None:
    """Return whether a wait is over; None when it has not begun."""
    return None if since_ns is None else (now_ns - since_ns) / NS_PER_S > wait_s


def key_of(product: Product) -> Key:
    """Return the quantities that decide about all later steps."""
    core, now_ns = product.core, product.now_ns
    commanders, stopping, freeing = core._commanders, core._stopping, core._backing_off
    turn, pending = commanders.ownership, commanders.pending_move
    check = None if freeing is None else core._check
    load = None if check is None else check._load
    motion = (
        core._armed_for,
        freeing and (freeing.blind, freeing.plan.kind),
        load and (load.lowest_N, load.first_N),
        check and _over(check._since_ns, now_ns, LONGEST_BACK_OFF_S),
        commanders._regulator_rested,
        _over(core._lease_since_ns, now_ns, ROBOT_ANSWERS_WITHIN_S),
        product.verdict.hold_code in OWN_HOLDS,
    )
    target = product.target
    if turn.commander != "regulator" and not TARGETS[target].valid:
        target = "stopped"
    return (
        core.state,
        (turn.commander, turn.host, turn.motion and turn.motion.is_at_rest),
        turn.goal is not None and turn.goal.id == product.goal.id and product.goal.state,
        pending and (pending.commander, _over(pending.since_ns, now_ns, SETTLE_WITHIN_S)),
        stopping and (stopping.T_back is None, stopping.motion.is_at_rest),
        stopping and _over(stopping.since_ns, now_ns, RETREAT_WITHIN_S),
        _over(commanders._rest_since_ns, now_ns, REST_S),
        _over(core._good_since_ns, now_ns, PREFLIGHT_S),
        _over(core._blind_since_ns, now_ns, PREFLIGHT_S),
        motion if product.may_move else (),
        _gate_key(product),
        (product.disturbance, target, product.moving, product.goal.state == "running"),
    )


def _gate_key(product: Product) -> Key:
    gate, status, last = product.gate, product.status, product.core._last_lease
    accepted, obeys = gate._accepted, product.verdict.command is not None
    repeats = last.challenge == gate.challenge
    here = (product.epoch, status.ownership)
    echo = accepted and (accepted.epoch, accepted.ownership) == here
    if not product.may_move:
        used = repeats and product.now_ns <= last.expires_ns
        return (gate._is_live, obeys, obeys and echo, used)
    newest = repeats and gate._newest == (product.epoch, status.lease, status.ownership)
    return (gate._is_live, obeys, echo, repeats, newest)
