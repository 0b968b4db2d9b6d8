"""Every state that arbiter and gate can reach together, and the rules of every step."""

from collections import deque
from typing import Any

from common.motion.permission import outranks
from common.motion.unexplained import UnexplainedMotion
from forcemesh.clock import NS_PER_S
from forcemesh.faults import FAULTS
from forcemesh.messages import MAY_MOVE
from tests.unit.services.arbiter.walked import (
    ALWAYS,
    DEADLINE_S,
    MOTIONS,
    SILENT,
    Key,
    Product,
    fork,
    happenings,
    key_of,
)

LATCHED = ("HOLDING", "FAULT")
MOVES = ("operator moves", "program moves")
# Faults that end motion in the period in which they are received; those of the force do not stop a
# back-off without force.
FATAL = {*SILENT, "wrench invalid", "motors off", "late loop", "another wrench"}
UNFELT = {"sensor silent", "wrench silent", "wrench invalid"}


def fatal_to(product: Product) -> set[str]:
    """Return the faults that end the present motion."""
    freeing = product.core._backing_off
    return FATAL - UNFELT if freeing is not None and freeing.blind else FATAL


# --- rules of every step --------------------------------------------------------------------------


def there_is_one_owner(event: str, before: Product, after: Product) -> None:
    """Assert that each owner has its number, and that command and status agree."""
    old, new, permission = before.status, after.status, after.command.permission
    assert (permission is not None) == after.may_move == (after.command.kind != "hold")
    if permission is not None:
        assert (permission.lease, permission.ownership) == (new.lease, new.ownership)
        assert after.command.commander == new.commander
    assert (new.commander != "none") == (new.state in {"ACTIVE", "STOPPING"})
    assert (new.next_commander != "none") == (new.state == "SETTLING")
    if event != "arbiter restarts":
        assert (new.lease, new.ownership) >= (old.lease, old.ownership)
        if old.commander not in {"none", new.commander}:
            assert (new.lease, new.ownership) > (old.lease, old.ownership)


def the_robot_obeys_the_newest_owner_in_time(_: str, before: Product, after: Product) -> None:
    """Assert that an obeyed command is the newest, in time, of a lease that has not ended."""
    obeyed = after.verdict.command
    if obeyed is not None and after.wire is not None:
        header, newest = after.wire
        assert obeyed is newest
        assert obeyed.permission is not None
        assert after.now_ns - header.stamp_ns <= DEADLINE_S * NS_PER_S
        assert (header.epoch, obeyed.permission.lease) not in before.dead


def motion_has_an_owner_and_good_inputs(event: str, before: Product, after: Product) -> None:
    """Assert that a fault ends motion at once, and that a commander moves the arm."""
    if after.may_move:
        assert after.disturbance not in fatal_to(after)
    if after.command.kind in MOTIONS:
        assert after.command.commander != "none"
    if event in fatal_to(before) and before.may_move:
        assert after.core.state == "FAULT"


def hold_ends_motion_in_the_same_step(event: str, _: Product, after: Product) -> None:
    """Assert that a hold ends motion for any other request of the period."""
    if "hold" in event.split(" + "):
        assert after.command.kind == "hold"
        assert after.verdict.command is None


def a_person_arms_before_each_motion(event: str, before: Product, after: Product) -> None:
    """Assert a new lease for each arming; from FAULT `clear` precedes, except to back off."""
    assert after.status.lease == after.armed
    assert after.armed - before.armed in {0, 1} or event == "arbiter restarts"
    if not before.may_move and after.may_move:
        assert after.armed == before.armed + 1
        assert (event == "back off") == (after.status.armed_for == "back_off")
        if before.core.state == "FAULT":
            assert event == "back off" or event.startswith("clear + arm")
    if before.core.state in LATCHED and event not in ALWAYS:
        assert after.core.state in LATCHED


def refusals_and_holds_have_a_reason(_: str, before: Product, after: Product) -> None:
    """Assert a code of the table, with its reaction."""
    for reply in after.replies:
        assert reply.text
        assert reply.code in {"ok", "already"} if reply.accepted else reply.code in FAULTS
    status, verdict = after.status, after.verdict
    kinds = [FAULTS[trip.code].kind for trip in status.trips]
    assert kinds or status.state not in LATCHED
    assert "FAULT" in kinds or status.state != "FAULT"
    assert after.command.reason or after.may_move
    if verdict.command is None:
        assert verdict.hold_reason
        assert verdict.hold_code in FAULTS


def a_move_needs_a_higher_rank(event: str, before: Product, after: Product) -> None:
    """Assert a higher rank, and an arm that is armed and not being stopped."""
    if event in MOVES and after.replies[0].accepted:
        requester: Any = event.split(maxsplit=1)[0]
        assert before.status.state in {"ARMED", "SETTLING", "ACTIVE"}
        assert outranks(requester, before.status.commander)
        assert outranks(requester, before.status.next_commander)


def an_ended_lease_is_detected(event: str, before: Product, after: Product) -> None:
    """Assert that an arbiter whose robot refuses its lease does not continue."""
    lease = (before.epoch, before.status.lease)
    if event == "long" and before.may_move and lease in before.dead:
        assert after.core.state in {"STOPPING", *LATCHED}


RULES = (
    there_is_one_owner,
    the_robot_obeys_the_newest_owner_in_time,
    motion_has_an_owner_and_good_inputs,
    hold_ends_motion_in_the_same_step,
    a_person_arms_before_each_motion,
    refusals_and_holds_have_a_reason,
    a_move_needs_a_higher_rank,
    an_ended_lease_is_detected,
)


# --- the whole graph ------------------------------------------------------------------------------


class Walk:
    """The graph of all nodes and steps."""

    def __init__(self) -> None:
        """Walk until no node is new; a step that breaks a rule is reported with its path."""
        first = Product()
        self.nodes: dict[Key, Product] = {key_of(first): first}
        self.came: dict[Key, tuple[Key, str]] = {}
        self.back: dict[Key, set[Key]] = {}
        self.edges = 0
        waiting = deque(self.nodes)
        while waiting:
            here = waiting.popleft()
            for event, happen in happenings(self.nodes[here]):
                after = fork(self.nodes[here])
                happen(after)
                self.edges += 1
                self.judge(here, event, after)
                there = key_of(after)
                if event != "arbiter restarts":  # which leads out of everything
                    self.back.setdefault(there, set()).add(here)
                if there not in self.nodes:
                    self.nodes[there], self.came[there] = after, (here, event)
                    waiting.append(there)

    def judge(self, here: Key, event: str, after: Product) -> None:
        """Check one step against every rule."""
        try:
            for rule in RULES:
                rule(event, self.nodes[here], after)
        except AssertionError as error:
            raise AssertionError(f"{[*self.path(here), event]}: {error}") from error

    def path(self, key: Key) -> list[str]:
        """Return the events that lead to a node."""
        if key not in self.came:
            return []
        before, event = self.came[key]
        return [*self.path(before), event]

    def leads_home(self) -> set[Key]:
        """Return the nodes from which a path leads to an armed arm that obeys."""
        reached = {
            key
            for key, product in self.nodes.items()
            if product.core.state == "ARMED" and product.verdict.command is not None
        }
        waiting = deque(reached)
        while waiting:
            for key in self.back.get(waiting.popleft(), set()) - reached:
                reached.add(key)
                waiting.append(key)
        return reached


def test_no_sequence_of_events_of_arbiter_and_gate_breaks_a_rule(capsys: Any, monkeypatch: Any):
    """Every step keeps every rule; no node is a dead end; one procedure recovers from each."""
    monkeypatch.setattr(UnexplainedMotion, "judge", lambda *_: None)  # this arm jumps
    walk = Walk()
    with capsys.disabled():
        print(f" [{len(walk.nodes)} states, {walk.edges} edges] ", end="")  # noqa: T201
    assert {product.core.state for product in walk.nodes.values()} >= {*MAY_MOVE, *LATCHED}
    home = walk.leads_home()
    assert [walk.path(key) for key in walk.nodes if key not in home] == []
    for key, found in walk.nodes.items():
        product = fork(found)
        product.disturbance, product.moving, product.target = "", False, "stopped"
        for event in ("hold", "long", "long", "clear", "arm all"):
            ALWAYS[event](product)
        assert product.core.state == "ARMED", walk.path(key)
        assert product.verdict.command is not None
