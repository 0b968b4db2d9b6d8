"""Everything that can happen to arbiter and gate, tried in every state that it leads to.

Two nodes are the same when nothing that either machine decides by differs: times only by whether
each wait is over, numbers of leases and turns only by whether they are the present ones. The walk
ends when no event leads to a new node.
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
from services.arbiter.inputs import OWN_HOLDS, ROBOT_ANSWERS_WITHIN_S, Inputs
from services.arbiter.ownership import REST_S, SETTLE_WITHIN_S
from services.arbiter.preflight import PREFLIGHT_S
from services.arbiter.stops import RETREAT_WITHIN_S
from tests.fakes.arbiter_product import (
    DEADLINE_S,
    FOR_ARMING,
    OF_MOTION,
    TROUBLES,
    WISHES,
    Product,
    fork,
)
from tests.fakes.arbiter_world import MOVE_DOWN

# From where the joint was at first this is in its range, from where it is turned to it is not.
TURN = MoveRequest(kind="by", joint_rad=(1.0, 0.0, 0.0, 0.0, 0.0, 0.0))
Key = tuple[Any, ...]
Event = Callable[[Product], None]
Ask = Callable[[Product, Inputs], Reply]
A_WHILE_S = 0.35  # a rest counts, and a robot that holds has had its time to answer
LONG_S = 3.2  # every wait of the arbiter is over
CREEP_S = 2.5  # a joint turns slowly
TOO_LONG_S = DEADLINE_S + 0.1  # the permission is over


def arm(product: Product, inputs: Inputs, purpose: Any = "all") -> Reply:
    """Arm, as a person."""
    before = product.may_move
    reply = product.core.arm(inputs, purpose)
    product.armed += reply.accepted and not before
    return reply


def back_off(product: Product, inputs: Inputs) -> Reply:
    """Ask to free the arm, as a person who is sure."""
    before = product.core.status().lease
    reply = product.core.back_off(inputs, confirmed=True)
    product.armed += product.core.status().lease - before
    return reply


def move(product: Product, inputs: Inputs, wish: MoveRequest, who: str) -> Reply:
    """Ask for a move."""
    return product.core.move(wish.model_copy(update={"commander": who}), inputs)


ASKS: dict[str, Ask] = {
    "arm all": arm,
    "arm jog": partial(arm, purpose="jog"),
    "back off": back_off,
    "hold": lambda product, _: product.core.hold("somebody"),
    "clear": lambda product, inputs: product.core.clear(inputs),
    "operator moves": partial(move, wish=MOVE_DOWN, who="operator"),
    "program moves": partial(move, wish=MOVE_DOWN, who="program"),
}
TOGETHER = (("clear", "arm all"), ("arm all", "hold"), ("arm all", "operator moves"),
            ("operator moves", "hold"))  # fmt: skip


def _asked(*names: str) -> Event:
    def happen(product: Product) -> None:
        inputs = product.live()
        product.replies = [ASKS[name](product, inputs) for name in names]
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
        product.goal = product.goal.model_copy(update={"state": state})
        product.close(product.live())

    return happen


def _restarts(product: Product) -> None:
    product.restart_arbiter()
    product.close(product.live())


def _another_wrench(product: Product) -> None:
    product.wrench_epoch = 3 - product.wrench_epoch
    product.close(product.live())


ALWAYS: dict[str, Event] = {
    **{name: _asked(name) for name in ASKS},
    **{" + ".join(names): _asked(*names) for names in TOGETHER},
    "a period": _passes(),
    "a while": _passes(A_WHILE_S),
    "long": _passes(LONG_S),
    "command lost": _passes(deliver="lost"),
    "silence": _passes(TOO_LONG_S, deliver="lost"),
    "arbiter restarts": _restarts,
}
# At rest the arbiter asks only whether something is wrong: one trouble of each kind is enough.
AT_REST_TROUBLES = (
    "robot silent",
    "wrench invalid",
    "motors off",
    "crushed",
    "stranger",
    "payload",
)
AT_REST_WISHES = ("stopped", "near", "feedback")
IN_MOTION_TROUBLES = tuple(name for name in TROUBLES if name not in FOR_ARMING)


def _turns(product: Product) -> None:
    inputs = product.live()
    product.replies = [product.core.move(TURN, inputs)]
    product.close(inputs)


MENDS = _passes(trouble="")


def happenings(product: Product) -> Iterator[tuple[str, Event]]:
    """Yield what can happen now. Where it is as it would become already, nothing does."""
    yield from ALWAYS.items()
    yield ("rests", _passes(moving=False)) if product.moving else ("moves", _passes(moving=True))
    if product.goal.state == "running":
        yield "goal done", _reports("done")
        yield "goal refused", _reports("refused")
    claim = product.core._commanders.claim
    if claim is not None and claim.request.kind == "by" and not product.turned:
        yield "a joint creeps", _passes(CREEP_S, turned=True)
    if product.before is not None and product.may_move:
        yield "old command", _passes(deliver="old")
    if product.trouble:
        yield "mended", MENDS
        return
    works = product.status.commander == "regulator"
    if works:  # once is enough: to begin from where the arm has come to rest meanwhile
        yield "operator turns", _turns
    for wish in WISHES if works else AT_REST_WISHES:
        if wish != product.wish:
            yield f"regulator: {wish}", _passes(wish=wish)
    for trouble in _troubles(product):
        yield trouble, _passes(trouble=trouble)
    if product.may_move:
        yield "another wrench", _another_wrench


def _troubles(product: Product) -> tuple[str, ...]:
    if not product.may_move:
        return AT_REST_TROUBLES
    if product.core.state == "ACTIVE":
        return IN_MOTION_TROUBLES
    return tuple(trouble for trouble in IN_MOTION_TROUBLES if trouble not in OF_MOTION)


# --- which nodes are the same ---------------------------------------------------------------------


def _over(since_ns: int | None, now_ns: int, *waits_s: float) -> int:
    """Return how many waits are over; minus one when none has begun."""
    if since_ns is None:
        return -1
    return sum((now_ns - since_ns) / NS_PER_S > wait_s for wait_s in waits_s)


def key_of(product: Product) -> Key:
    """Return what decides about everything to come.

    Which code has latched is judged on every edge but decides nothing. What counts in motion alone
    is left out at rest.
    """
    core, now_ns = product.core, product.now_ns
    commanders, stopping = core._commanders, core._stopping
    turn, claim, stream = commanders.turn, commanders.claim, commanders.turn.stream
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
        None if stream is None else stream.pace.is_still,
        turn.goal is not None and turn.goal.id == product.goal.id and product.goal.state,
        None if claim is None else (claim.commander, claim.request.kind, product.turned),
        None if claim is None else _over(claim.since_ns, now_ns, SETTLE_WITHIN_S),
        None if stopping is None else (stopping.T_back is None, stopping.pace.is_still),
        None if stopping is None else _over(stopping.since_ns, now_ns, RETREAT_WITHIN_S),
        _over(commanders._rest.since_ns, now_ns, REST_S),
        _over(core._good_since_ns, now_ns, PREFLIGHT_S),
        _over(core._blind_since_ns, now_ns, PREFLIGHT_S),
        motion if moves else (),
    )
    wish = product.wish
    if turn.commander != "regulator" and not WISHES[wish].valid:
        wish = "stopped"
    here = (product.trouble, wish, product.moving, product.goal.state == "running")
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
    live = None if gate._live_lease is None else gate._live_lease == lease
    echo = accepted and (accepted.epoch, accepted.ownership) == (product.epoch, turn)
    if not product.may_move:
        return (live, obeys, obeys and echo)
    old = None if product.before is None else product.before[0].epoch == product.epoch
    return (live, obeys, echo, lease in gate._dead, gate._newest == (*lease, turn), old)


# --- the walk -------------------------------------------------------------------------------------


@dataclass
class Edge:
    """One step: what was, what happened, what is."""

    before: Product
    event: str
    after: Product


@dataclass
class Walk:
    """The graph, as far as it has been walked."""

    judge: Callable[[Edge], None]
    leave_out: tuple[str, ...] = ()  # events that do not happen
    nodes: dict[Key, Product] = field(default_factory=dict)
    came: dict[Key, tuple[Key, str]] = field(default_factory=dict)
    back: dict[Key, set[Key]] = field(default_factory=dict)
    edges: int = 0

    def run(self, most_nodes: int = 100_000) -> "Walk":
        """Walk until nothing is new; an edge that breaks a rule is told with the way to it."""
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
        """Go along one edge; return the node it leads to if that is new."""
        after = fork(self.nodes[here])
        happen(after)
        self.edges += 1
        try:
            self.judge(Edge(self.nodes[here], event, after))
        except AssertionError as error:
            way = " > ".join([*self.way(here), event])
            raise AssertionError(f"{way}: {error}") from error
        there = key_of(after)
        if event != "arbiter restarts":  # which would be a way out of everything
            self.back.setdefault(there, set()).add(here)
        if there in self.nodes:
            return None
        self.nodes[there], self.came[there] = after, (here, event)
        return there

    def way(self, key: Key) -> list[str]:
        """Return the events that lead to a node."""
        events: list[str] = []
        while key in self.came:
            key, event = self.came[key]
            events.insert(0, event)
        return events

    def from_where(self, is_goal: Callable[[Product], bool]) -> set[Key]:
        """Return the nodes from which some way leads to a goal."""
        reached = {key for key, product in self.nodes.items() if is_goal(product)}
        waiting = deque(reached)
        while waiting:
            for key in self.back.get(waiting.popleft(), set()) - reached:
                reached.add(key)
                waiting.append(key)
        return reached
