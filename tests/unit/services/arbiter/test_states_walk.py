"""Every state that arbiter and gate can reach together, and the rules of every step.

The real `Arbiter` and the real `CommandGate` are explored event by event until no new state is
found (tests/fakes/arbiter_walk.py). The rules hold for every order of events.
"""

from collections.abc import Callable
from typing import Any

import pytest

from common.motion.permission import CommandGate, GateDecision, outranks
from forcemesh.clock import NS_PER_S
from forcemesh.faults import FAULTS
from forcemesh.messages import MAY_MOVE
from services.arbiter import commanders, states
from services.arbiter.commanders import Commanders, Ownership
from services.arbiter.states import TABLE
from tests.fakes.arbiter_product import (
    DEADLINE_S,
    MOTIONS,
    SILENT,
    TROUBLES,
    Product,
    TracedArbiter,
    fork,
)
from tests.fakes.arbiter_walk import ALWAYS, Edge, Walk, happenings, key_of

# Faults that end motion in the period in which they are received.
FATAL = {
    *SILENT, "robot invalid", "sensor invalid", "wrench invalid", "motors off", "error",
    "late loop", "misaligned", "two writers", "another wrench",
}  # fmt: skip
# Faults that do not stop backing off without force.
UNFELT = {f"{name} {fault}" for name in ("sensor", "wrench") for fault in ("silent", "invalid")}
MOVES = ("operator moves", "program moves", "operator turns")
LATCHED = ("HOLDING", "FAULT")
FEW = tuple(
    disturbance for disturbance in TROUBLES if disturbance != "robot silent"
)  # for a short exploration


# --- rules of every step --------------------------------------------------------------------------


def there_is_one_owner(edge: Edge) -> None:
    """Assert that owners have different turns, and that command and status agree."""
    before, after = edge.before.status, edge.after.status
    command, permission = edge.after.command, edge.after.command.permission
    assert (permission is not None) == edge.after.may_move == (command.kind != "hold")
    if permission is not None:
        assert (permission.lease, permission.ownership) == (after.lease, after.ownership)
        assert command.commander == after.commander
    if edge.before.epoch == edge.after.epoch:
        assert (after.lease, after.ownership) >= (before.lease, before.ownership)
        if before.commander not in {"none", after.commander}:
            assert (after.lease, after.ownership) > (before.lease, before.ownership)
    assert (after.commander != "none") == (after.state in {"ACTIVE", "STOPPING"})
    assert (after.next_commander != "none") == (after.state == "SETTLING")


def the_robot_obeys_the_newest_owner_in_time(edge: Edge) -> None:
    """Assert that the robot obeys the newest command of a lease that has not ended, in time."""
    product, obeyed = edge.after, edge.after.verdict.command
    if obeyed is None:
        return
    assert product.wire is not None
    header, newest = product.wire
    assert obeyed is newest
    assert obeyed.permission is not None
    assert product.now_ns - header.stamp_ns <= DEADLINE_S * NS_PER_S
    assert (header.epoch, obeyed.permission.lease) not in edge.before.dead
    if header.seq == product.seq:
        assert product.may_move


def fatal_to(product: Product) -> set[str]:
    """Return the faults that end the present motion."""
    freeing = product.core._freeing
    return FATAL - UNFELT if freeing is not None and freeing.blind else FATAL


def moving_implies_a_fresh_owner(edge: Edge) -> None:
    """Assert that motion has a commander and only good inputs."""
    if edge.after.may_move:
        assert edge.after.disturbance not in fatal_to(edge.after)
    if edge.after.command.kind in MOTIONS:
        assert edge.after.core.state in {"ACTIVE", "STOPPING"}
        assert edge.after.command.commander != "none"
    if edge.event in fatal_to(edge.before) and edge.before.may_move:
        assert edge.after.core.state == "FAULT"


def hold_ends_motion_in_the_same_step(edge: Edge) -> None:
    """Assert that a hold ends motion for any other request of the period."""
    if "hold" in edge.event.split(" + "):
        assert not edge.after.may_move
        assert edge.after.command.kind == "hold"
        assert edge.after.verdict.command is None


def only_arming_leads_to_motion(edge: Edge) -> None:
    """Assert that from rest only `arm` leads to motion; from FAULT only after `clear`.

    Backing off needs no clear, but it arms for its own goal only.
    """
    if not edge.before.may_move and edge.after.may_move:
        assert edge.after.replies[0].accepted
        assert (edge.event == "back off") == (edge.after.status.armed_for == "back_off")
        if edge.event == "back off":
            return
        assert edge.event.startswith(("arm", "clear + arm"))
        assert edge.before.core.state != "BOOT"
        if edge.before.core.state == "FAULT":
            assert edge.event.startswith("clear + arm")
    if edge.before.core.state in LATCHED and edge.event not in ALWAYS:
        assert edge.after.core.state in LATCHED


def each_arming_has_its_own_lease(edge: Edge) -> None:
    """Assert that a lease is used once."""
    before, after = edge.before.status.lease, edge.after.status.lease
    assert after == edge.after.armed
    assert after - before in {0, 1} or edge.event == "arbiter restarts"


def states_change_by_the_table(edge: Edge) -> None:
    """Assert that each change is a row, and the rows are connected."""
    for old, new in edge.after.core.changes:
        assert new in TABLE[old].values(), (old, new)
    if edge.event != "arbiter restarts":
        steps = [edge.before.core.state, *(new for _, new in edge.after.core.changes)]
        assert [old for old, _ in edge.after.core.changes] == steps[:-1]
        assert steps[-1] == edge.after.core.state


def refusals_and_holds_have_a_reason(edge: Edge) -> None:
    """Assert a code of the dictionary with its reaction."""
    for reply in edge.after.replies:
        assert reply.text
        if reply.accepted:
            assert reply.code in {"ok", "already"}
        else:
            assert reply.rule == FAULTS[reply.code].rule
    status, verdict = edge.after.status, edge.after.verdict
    kinds = [FAULTS[trip.code].kind for trip in status.trips]
    assert [FAULTS[trip.code].rule for trip in status.trips] == [t.rule for t in status.trips]
    if status.state in LATCHED:
        assert kinds
    if status.state == "FAULT":
        assert "FAULT" in kinds
    if verdict.command is None:
        assert verdict.hold_reason
        assert verdict.hold_code in FAULTS
    assert edge.after.command.reason or edge.after.may_move


def a_move_needs_a_higher_rank(edge: Edge) -> None:
    """Assert a higher rank, and an arm that is armed and not being stopped."""
    if edge.event in MOVES and edge.after.replies[0].accepted:
        before = edge.before.status
        assert before.state in {"ARMED", "SETTLING", "ACTIVE"}
        requester: Any = edge.event.split()[0]
        assert outranks(requester, before.commander)
        assert outranks(requester, before.next_commander)


def an_ended_lease_is_detected(edge: Edge) -> None:
    """Assert that an arbiter whose robot refuses its lease does not continue."""
    lease = (edge.before.epoch, edge.before.status.lease)
    if edge.event == "long" and edge.before.may_move and lease in edge.before.dead:
        assert edge.after.core.state in {"STOPPING", *LATCHED}


RULES: tuple[Callable[[Edge], None], ...] = (
    there_is_one_owner,
    the_robot_obeys_the_newest_owner_in_time,
    moving_implies_a_fresh_owner,
    hold_ends_motion_in_the_same_step,
    only_arming_leads_to_motion,
    each_arming_has_its_own_lease,
    states_change_by_the_table,
    refusals_and_holds_have_a_reason,
    a_move_needs_a_higher_rank,
    an_ended_lease_is_detected,
)


def check(edge: Edge) -> None:
    """Check one step against every rule."""
    for rule in RULES:
        rule(edge)


# --- the whole graph ------------------------------------------------------------------------------


def every_row_is_walked(rows: set[tuple[str, str]]) -> None:
    """Assert that no row of the table is unused."""
    assert rows == {(old, new) for old, row in TABLE.items() for new in row.values()}
    for row in TABLE.values():  # backing off arms as well: its purpose distinguishes it
        states = [new for event, new in row.items() if event != "back_off"]
        assert len(set(states)) == len(states)


def there_is_no_dead_end(walk: Walk) -> None:
    """Assert that a path without a restart leads from every node to an armed, obeying arm."""
    home = walk.from_where(lambda p: p.core.state == "ARMED" and p.verdict.command is not None)
    assert [walk.path(key) for key in walk.nodes if key not in home] == []


def one_recovery_works_everywhere(walk: Walk) -> None:
    """Assert that hold, repair, rest, wait, clear and arm recover from every node."""
    for key, found in walk.nodes.items():
        product: Product = fork(found)
        product.disturbance, product.moving, product.target = "", False, "stopped"
        for event in ("hold", "long", "long", "clear", "arm all"):
            ALWAYS[event](product)
        assert product.core.state == "ARMED", walk.path(key)
        assert product.verdict.command is not None


def a_node_is_reproduced_by_its_path(walk: Walk) -> None:
    """Assert that the path from the start leads to the same node without copies."""
    for key in list(walk.nodes)[:: max(1, len(walk.nodes) // 60)]:
        product = Product()
        for event in walk.path(key):
            dict(happenings(product))[event](product)
        assert key_of(product) == key


def test_no_sequence_of_events_of_arbiter_and_gate_breaks_a_rule(capsys: Any) -> None:
    """The exploration ends; every step keeps every rule, and so does the whole graph."""
    rows: set[tuple[str, str]] = set()

    def check_and_record(edge: Edge) -> None:
        check(edge)
        rows.update(edge.after.core.changes)

    walk = Walk(check_and_record).run()
    with capsys.disabled():
        print(f" [{len(walk.nodes)} states, {walk.edges} edges] ", end="")  # noqa: T201
    assert len(walk.nodes) > 1000
    every_row_is_walked(rows)
    there_is_no_dead_end(walk)
    one_recovery_works_everywhere(walk)
    a_node_is_reproduced_by_its_path(walk)


# --- mutations are detected -----------------------------------------------------------------------


def arm_in_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a fault be armed."""
    monkeypatch.setitem(states.TABLE["FAULT"], "arm", "ARMED")


def arm_by_clear(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let clear arm."""
    monkeypatch.setitem(states.TABLE["HOLDING"], "clear", "ARMED")


def ignore_hold_in_settling(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ignore a hold in SETTLING."""
    monkeypatch.setitem(states.TABLE["SETTLING"], "hold", "SETTLING")


def forget_ended_leases(monkeypatch: pytest.MonkeyPatch) -> None:
    """Continue an ended lease."""
    monkeypatch.setattr(
        CommandGate, "_refuse", lambda gate, why: GateDecision(None, why, gate._accepted)
    )


def ignore_deadlines(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a permission never expire."""
    original_judge = CommandGate.judge

    def judge_without_age(gate: CommandGate, reading: Any, now_ns: int) -> GateDecision:
        return original_judge(gate, reading._replace(age_s=0.0), now_ns)

    monkeypatch.setattr(CommandGate, "judge", judge_without_age)


def accept_earlier_owners(monkeypatch: pytest.MonkeyPatch) -> None:
    """Accept commands of an earlier owner."""
    original_judge = CommandGate.judge

    def judge_without_memory(gate: CommandGate, reading: Any, now_ns: int) -> GateDecision:
        gate._newest = (0, 0, 0)
        return original_judge(gate, reading, now_ns)

    monkeypatch.setattr(CommandGate, "judge", judge_without_memory)


def ignore_ranks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Accept every rank."""
    monkeypatch.setattr(commanders, "outranks", lambda requester, holder: True)


def keep_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give the next owner the turn of the one before."""
    monkeypatch.setattr(Ownership, "next", lambda turn: Ownership(turn.number))


def keep_owner_over_a_stop(monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep the owner over a stop."""
    monkeypatch.setattr(Commanders, "drop", lambda self: None)


def set_state_without_the_table(monkeypatch: pytest.MonkeyPatch) -> None:
    """Begin a move at once without the table."""
    original_move = TracedArbiter.move

    def move_at_once(arbiter: TracedArbiter, *args: Any) -> Any:
        reply = original_move(arbiter, *args)
        if reply.accepted and arbiter.state in MAY_MOVE:
            arbiter.state = "STOPPING"
        return reply

    monkeypatch.setattr(TracedArbiter, "move", move_at_once)


def repeat_leases(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give each arming the same number."""
    original_arm = TracedArbiter.arm

    def arm_with_old_lease(arbiter: TracedArbiter, *args: Any) -> Any:
        reply = original_arm(arbiter, *args)
        arbiter._lease = min(arbiter._lease, 1)
        return reply

    monkeypatch.setattr(TracedArbiter, "arm", arm_with_old_lease)


@pytest.mark.parametrize(
    "mutate",
    [
        arm_in_fault,
        arm_by_clear,
        ignore_hold_in_settling,
        forget_ended_leases,
        ignore_deadlines,
        accept_earlier_owners,
        ignore_ranks,
        keep_turns,
        keep_owner_over_a_stop,
        set_state_without_the_table,
        repeat_leases,
    ],
)
def test_a_mutation_is_detected(mutate: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each mutation of the real code breaks a rule in the exploration."""
    mutate(monkeypatch)
    with pytest.raises(AssertionError, match=r"arm|hold|moves|clear"):
        Walk(check, FEW).run()


def test_a_dead_end_is_detected(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without its only row nothing leads out of a fault."""
    monkeypatch.setitem(states.TABLE, "FAULT", {})
    few = (*FEW, *MOVES, "arm jog", "arm all + operator moves", "moves", "old command")
    walk = Walk(lambda edge: None, few).run()
    home = walk.from_where(lambda p: p.core.state == "ARMED")
    assert {walk.nodes[key].core.state for key in walk.nodes if key not in home} == {"FAULT"}
