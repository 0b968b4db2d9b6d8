"""Every event of arbiter and permission check, tried in every state that it leads to.

Two nodes are the same when every quantity that decides in either machine is the same: times only by
whether each wait is over, numbers of leases and of ownership only by whether they are the present
ones. The walk ends when no event leads to a new node.
"""

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from common.motion.back_off import LONGEST_BACK_OFF_S
from forcemesh.clock import NS_PER_S
from forcemesh.messages import MAY_MOVE
from forcemesh.requests import MoveRequest, Reply
from services.arbiter.commanders import REST_S, SETTLE_WITHIN_S
from services.arbiter.core import OWN_HOLDS, ROBOT_ANSWERS_WITHIN_S
from services.arbiter.inputs import Inputs
from services.arbiter.preflight import PREFLIGHT_S
from services.arbiter.stream import RETREAT_WITHIN_S
from tests.fakes.arbiter_product import (
    DEADLINE_S,
    FOR_ARMING,
    OF_MOTION,
    TARGETS,
    TROUBLES,
    Product,
    fork,
)
from tests.fakes.arbiter_world import MOVE_DOWN

# The target is in range from the joint's first position, not from its turned position.
TURN = MoveRequest(kind="by", joint_rad=(1.0, 0.0, 0.0, 0.0, 0.0, 0.0))
Key = tuple[Any, ...]
Event = Callable[[Product], None]
SendRequest = Callable[[Product, Inputs], Reply]
A_WHILE_S = 0.35  # a rest counts, and a robot that holds has had its time to reply
LONG_S = 3.2  # every wait of the arbiter is over
CREEP_S = 2.5  # a joint turns slowly
TOO_LONG_S = DEADLINE_S + 0.1  # the permission is over


def arm(product: Product, inputs: Inputs, purpose: Any = "all") -> Reply:
    """Arm as a person does."""
    before = product.may_move
    reply = product.core.arm(inputs, purpose)
    product.armed += reply.accepted and not before
    return reply


def back_off(product: Product, inputs: Inputs) -> Reply:
    """Request back-off as a person who confirms it."""
    before = product.core.status().lease
    reply = product.core.back_off(inputs, confirmed=True)
    product.armed += product.core.status().lease - before
    return reply


def move(product: Product, inputs: Inputs, request: MoveRequest, who: str) -> Reply:
    """Request a move."""
    return product.core.move(request.replaced(commander=who), inputs)


REQUESTS: dict[str, SendRequest] = {
    "arm all": arm,
    "arm jog": partial(arm, purpose="jog"),
    "back off": back_off,
    "hold": lambda product, _: product.core.hold("a client"),
    "clear": lambda product, inputs: product.core.clear(inputs),
    "operator moves": partial(move, request=MOVE_DOWN, who="operator"),
    "program moves": partial(move, request=MOVE_DOWN, who="program"),
}
TOGETHER = (("clear", "arm all"), ("arm all", "hold"), ("arm all", "operator moves"),
            ("operator moves", "hold"))  # fmt: skip


def _requested(*names: str) -> Event:
    def happen(product: Product) -> None:
        inputs = product.live()
        product.replies = [REQUESTS[name](product, inputs) for name in names]
        product.close(inputs)

    return happen


def _passes(duration_s: float = 0.004, *, deliver: str = "new", **changes: Any) -> Event:
    def happen(product: Product) -> None:
        for name, value in changes.items():
            setattr(product, name, value)
        product.close(product.live(duration_s), deliver=deliver)

    return happen


def _reports(state: Any) -> Event:
    def happen(product: Product) -> None:
        product.goal = product.goal.replaced(state=state)
        product.close(product.live())

    return happen


def _restarts(product: Product) -> None:
    product.restart_arbiter()
    product.close(product.live())


def _another_wrench(product: Product) -> None:
    product.wrench_epoch = 3 - product.wrench_epoch
    product.close(product.live())


ALWAYS: dict[str, Event] = {
    **{name: _requested(name) for name in REQUESTS},
    **{" + ".join(names): _requested(*names) for names in TOGETHER},
    "a period": _passes(),
    "a while": _passes(A_WHILE_S),
    "long": _passes(LONG_S),
    "command lost": _passes(deliver="lost"),
    "silence": _passes(TOO_LONG_S, deliver="lost"),
    "arbiter restarts": _restarts,
}
# At rest the arbiter asks only whether there is a fault: one of each kind is enough.
AT_REST_TROUBLES = (
    "robot silent",
    "wrench invalid",
    "motors off",
    "robot fails",
    "crushed",
    "other cell file",
    "payload",
)
AT_REST_TARGETS = ("stopped", "near", "feedback")
IN_MOTION_TROUBLES = tuple(name for name in TROUBLES if name not in FOR_ARMING)


def _turns(product: Product) -> None:
    inputs = product.live()
    product.replies = [product.core.move(TURN, inputs)]
    product.close(inputs)


REMOVE_DISTURBANCE = _passes(disturbance="")


def happenings(product: Product) -> Iterator[tuple[str, Event]]:
    """Yield the possible events, without those that change nothing."""
    yield from ALWAYS.items()
    yield ("rests", _passes(moving=False)) if product.moving else ("moves", _passes(moving=True))
    if product.goal.state == "running":
        yield "goal done", _reports("done")
        yield "goal refused", _reports("refused")
    pending = product.core._commanders.pending_move
    if pending is not None and pending.goal.kind == "by" and not product.turned:
        yield "a joint creeps", _passes(CREEP_S, turned=True)
    if product.before is not None and product.may_move:
        yield "old command", _passes(deliver="old")
    if product.disturbance:
        yield "trouble removed", REMOVE_DISTURBANCE
        return
    works = product.status.commander == "regulator"
    if works:  # once is enough: to begin from where the arm has come to rest meanwhile
        yield "operator turns", _turns
    for target in TARGETS if works else AT_REST_TARGETS:
        if target != product.target:
            yield f"regulator: {target}", _passes(target=target)
    for disturbance in _disturbances(product):
        yield disturbance, _passes(disturbance=disturbance)
    if product.may_move:
        yield "another wrench", _another_wrench


def _disturbances(product: Product) -> tuple[str, ...]:
    if not product.may_move:
        return AT_REST_TROUBLES
    if product.core.state == "ACTIVE":
        return IN_MOTION_TROUBLES
    return tuple(disturbance for disturbance in IN_MOTION_TROUBLES if disturbance not in OF_MOTION)


# --- which nodes are the same ---------------------------------------------------------------------


def _over(since_ns: int | None, now_ns: int, *waits_s: float) -> int:
    """Return how many waits are over; minus one when none has begun."""
    if since_ns is None:
        return -1
    return sum((now_ns - since_ns) / NS_PER_S > wait_s for wait_s in waits_s)


def key_of(product: Product) -> Key:
    """Return the quantities that decide about all later steps.

    The latched code is judged on every edge but decides nothing. Quantities of motion alone are
    left out at rest.
    """
    core, now_ns = product.core, product.now_ns
    commanders, stopping = core._commanders, core._stopping
    turn, pending = commanders.ownership, commanders.pending_move
    moves = core.state in MAY_MOVE
    motion = (
        core._armed_for,
        _freeing_key(product),
        commanders._regulator_rested,
        _over(core._lease_since_ns, now_ns, ROBOT_ANSWERS_WITHIN_S),
        product.verdict.hold_code in OWN_HOLDS,
    )
    arbiter = (
        core.state,
        turn.commander,
        turn.host,
        None if turn.motion is None else turn.motion.is_at_rest,
        turn.goal is not None and turn.goal.id == product.goal.id and product.goal.state,
        None if pending is None else (pending.commander, pending.goal.kind, product.turned),
        None if pending is None else _over(pending.since_ns, now_ns, SETTLE_WITHIN_S),
        None if stopping is None else (stopping.T_back is None, stopping.motion.is_at_rest),
        None if stopping is None else _over(stopping.since_ns, now_ns, RETREAT_WITHIN_S),
        _over(commanders._rest_since_ns, now_ns, REST_S),
        _over(core._good_since_ns, now_ns, PREFLIGHT_S),
        _over(core._blind_since_ns, now_ns, PREFLIGHT_S),
        motion if moves else (),
    )
    target = product.target
    if turn.commander != "regulator" and not TARGETS[target].valid:
        target = "stopped"
    here = (product.disturbance, target, product.moving, product.goal.state == "running")
    return (*arbiter, *_gate_key(product), *here)


def _freeing_key(product: Product) -> Key:
    freeing = product.core._freeing
    if freeing is None:
        return ()
    run = freeing.run
    late = _over(run.since_ns, product.now_ns, LONGEST_BACK_OFF_S)
    return (freeing.blind, freeing.plan.kind, run.load.lowest_N, run.load.first_N, late)


def _gate_key(product: Product) -> Key:
    gate, turn = product.gate, product.status.ownership
    lease = (product.epoch, product.status.lease)
    accepted, obeys = gate._accepted, product.verdict.command is not None
    live, last = gate._is_live, product.core._last_lease
    repeats = last.challenge == gate.challenge
    echo = accepted and (accepted.epoch, accepted.ownership) == (product.epoch, turn)
    if not product.may_move:
        used = repeats and product.now_ns <= last.expires_ns
        return (live, obeys, obeys and echo, used)
    old = None if product.before is None else product.before[0].epoch == product.epoch
    newest = repeats and gate._newest == (*lease, turn)  # without it, all is refused
    return (live, obeys, echo, repeats, newest, old)


# --- the walk -------------------------------------------------------------------------------------


@dataclass
class Edge:
    """One step: the state before, the event, the state after."""

    before: Product
    event: str
    after: Product


@dataclass
class Walk:
    """The graph as far as it has been walked."""

    judge: Callable[[Edge], None]
    leave_out: tuple[str, ...] = ()  # events that are excluded
    nodes: dict[Key, Product] = field(default_factory=dict)
    came: dict[Key, tuple[Key, str]] = field(default_factory=dict)
    back: dict[Key, set[Key]] = field(default_factory=dict)
    edges: int = 0

    def run(self, most_nodes: int = 100_000) -> "Walk":
        """Walk until no node is new; an edge that breaks a rule is reported with its path."""
        first = Product()
        start = key_of(first)
        self.nodes[start] = first
        waiting = deque([start])
        while waiting:
            here = waiting.popleft()
            for event, happen in happenings(self.nodes[here]):
                there = None
                if event not in self.leave_out:
                    there = self._step(here, event, happen)
                if there is not None:
                    waiting.append(there)
            assert len(self.nodes) < most_nodes, "the walk does not end"
        return self

    def _step(self, here: Key, event: str, happen: Event) -> Key | None:
        """Take one edge; return the node it leads to if that is new."""
        after = fork(self.nodes[here])
        happen(after)
        self.edges += 1
        try:
            self.judge(Edge(self.nodes[here], event, after))
        except AssertionError as error:
            path = " > ".join([*self.path(here), event])
            raise AssertionError(f"{path}: {error}") from error
        there = key_of(after)
        if event != "arbiter restarts":  # which would be a way out of everything
            self.back.setdefault(there, set()).add(here)
        if there in self.nodes:
            return None
        self.nodes[there], self.came[there] = after, (here, event)
        return there

    def path(self, key: Key) -> list[str]:
        """Return the events that lead to a node."""
        events: list[str] = []
        while key in self.came:
            key, event = self.came[key]
            events.insert(0, event)
        return events

    def from_where(self, is_goal: Callable[[Product], bool]) -> set[Key]:
        """Return the nodes from which a path leads to a goal."""
        reached = {key for key, product in self.nodes.items() if is_goal(product)}
        waiting = deque(reached)
        while waiting:
            for key in self.back.get(waiting.popleft(), set()) - reached:
                reached.add(key)
                waiting.append(key)
        return reached
