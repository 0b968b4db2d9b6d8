"""Every state that arbiter and gate can get into together, and what is true on every way there.

Not a model: the real `Arbiter` and the real `CommandGate` are walked through, event by event, until
nothing new is found (tests/fakes/arbiter_walk.py). What holds here holds in every order of events.
"""

from collections.abc import Callable
from typing import Any

import pytest

from common.motion.permission import CommandGate, GateDecision
from forcemesh.clock import NS_PER_S
from forcemesh.faults import FAULTS
from forcemesh.messages import MAY_MOVE
from services.arbiter import commanders, states
from services.arbiter.commanders import Commanders
from services.arbiter.ownership import Ownership
from services.arbiter.ranks import outranks
from services.arbiter.states import TABLE
from tests.fakes.arbiter_product import (
    DEADLINE_S,
    MOTIONS,
    SILENT,
    TROUBLES,
    Product,
    SeenArbiter,
    fork,
)
from tests.fakes.arbiter_walk import ALWAYS, Edge, Walk, happenings, key_of

# What ends motion in the very period in which it is seen.
FATAL = {
    *SILENT, "robot invalid", "sensor invalid", "wrench invalid", "motors off", "error",
    "late loop", "misaligned", "two writers", "another wrench",
}  # fmt: skip
# What backing off without a force to follow does not wait for.
UNFELT = {f"{name} {how}" for name in ("sensor", "wrench") for how in ("silent", "invalid")}
MOVES = ("operator moves", "program moves", "operator turns")
LATCHED = ("HOLDING", "FAULT")
FEW = tuple(trouble for trouble in TROUBLES if trouble != "robot silent")  # for a quick look


# --- what is true of every step -------------------------------------------------------------------


def there_is_one_owner(edge: Edge) -> None:
    """Who has the arm keeps its turn; the next one has another; command and status agree."""
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
    """What is obeyed is what was heard last, not too old, of a lease that never ended."""
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
    """Return what ends the motion that is under way."""
    freeing = product.core._freeing
    return FATAL - UNFELT if freeing is not None and freeing.blind else FATAL


def moving_implies_a_fresh_owner(edge: Edge) -> None:
    """A motion has a commander, and nothing that the arbiter hears is wrong."""
    if edge.after.may_move:
        assert edge.after.trouble not in fatal_to(edge.after)
    if edge.after.command.kind in MOTIONS:
        assert edge.after.core.state in {"ACTIVE", "STOPPING"}
        assert edge.after.command.commander != "none"
    if edge.event in fatal_to(edge.before) and edge.before.may_move:
        assert edge.after.core.state == "FAULT"


def hold_ends_motion_in_the_same_step(edge: Edge) -> None:
    """Whoever asked for what in the same period."""
    if "hold" in edge.event.split(" + "):
        assert not edge.after.may_move
        assert edge.after.command.kind == "hold"
        assert edge.after.verdict.command is None


def only_a_person_leads_to_motion(edge: Edge) -> None:
    """From wherever nothing moves, `arm` alone; from FAULT not without `clear` before it.

    Backing off needs no clear, but it arms for its own goal alone.
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


def a_lease_is_a_person_that_armed(edge: Edge) -> None:
    """One number each time, never one that was there before."""
    before, after = edge.before.status.lease, edge.after.status.lease
    assert after == edge.after.armed
    assert after - before in {0, 1} or edge.event == "arbiter restarts"


def states_change_as_the_table_says(edge: Edge) -> None:
    """Each change is a row, and one follows from the other."""
    for old, new in edge.after.core.changes:
        assert new in TABLE[old].values(), (old, new)
    if edge.event != "arbiter restarts":
        steps = [edge.before.core.state, *(new for _, new in edge.after.core.changes)]
        assert [old for old, _ in edge.after.core.changes] == steps[:-1]
        assert steps[-1] == edge.after.core.state


def whatever_is_refused_or_held_says_why(edge: Edge) -> None:
    """With a code of the dictionary and its rule."""
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
    """And an arm that is armed and not being stopped."""
    if edge.event in MOVES and edge.after.replies[0].accepted:
        before = edge.before.status
        assert before.state in {"ARMED", "SETTLING", "ACTIVE"}
        asker: Any = edge.event.split()[0]
        assert outranks(asker, before.commander)
        assert outranks(asker, before.next_commander)


def a_dead_lease_is_noticed(edge: Edge) -> None:
    """An arbiter whose robot refuses its lease does not go on for ever as if it moved."""
    lease = (edge.before.epoch, edge.before.status.lease)
    if edge.event == "long" and edge.before.may_move and lease in edge.before.dead:
        assert edge.after.core.state in {"STOPPING", *LATCHED}


RULES: tuple[Callable[[Edge], None], ...] = (
    there_is_one_owner,
    the_robot_obeys_the_newest_owner_in_time,
    moving_implies_a_fresh_owner,
    hold_ends_motion_in_the_same_step,
    only_a_person_leads_to_motion,
    a_lease_is_a_person_that_armed,
    states_change_as_the_table_says,
    whatever_is_refused_or_held_says_why,
    a_move_needs_a_higher_rank,
    a_dead_lease_is_noticed,
)


def judge(edge: Edge) -> None:
    """Hold one step against every rule."""
    for rule in RULES:
        rule(edge)


# --- the whole graph ------------------------------------------------------------------------------


def every_row_is_walked(rows: set[tuple[str, str]]) -> None:
    """A row that nothing leads along would be a row that nobody has thought of."""
    assert rows == {(old, new) for old, row in TABLE.items() for new in row.values()}
    for row in TABLE.values():  # backing off arms as well: it is told apart by what it arms for
        states = [new for event, new in row.items() if event != "back_off"]
        assert len(set(states)) == len(states)


def there_is_no_dead_end(walk: Walk) -> None:
    """From everywhere some way leads to an arm that is armed and obeys; no process starts anew."""
    home = walk.from_where(lambda p: p.core.state == "ARMED" and p.verdict.command is not None)
    assert [walk.way(key) for key in walk.nodes if key not in home] == []


def one_recipe_helps_everywhere(walk: Walk) -> None:
    """Hold, mend, let it rest, wait, clear, arm: the same for whatever has happened."""
    for key, found in walk.nodes.items():
        product: Product = fork(found)
        product.trouble, product.moving, product.wish = "", False, "stopped"
        for event in ("hold", "long", "long", "clear", "arm all"):
            ALWAYS[event](product)
        assert product.core.state == "ARMED", walk.way(key)
        assert product.verdict.command is not None


def a_node_is_what_its_way_leads_to(walk: Walk) -> None:
    """Walked again from the start, without copies, the same node is reached."""
    for key in list(walk.nodes)[:: max(1, len(walk.nodes) // 60)]:
        product = Product()
        for event in walk.way(key):
            dict(happenings(product))[event](product)
        assert key_of(product) == key


def test_no_way_through_arbiter_and_gate_breaks_a_rule(capsys: Any) -> None:
    """The walk has an end, every step of it keeps every rule, and so does the whole graph."""
    rows: set[tuple[str, str]] = set()

    def judge_and_note(edge: Edge) -> None:
        judge(edge)
        rows.update(edge.after.core.changes)

    walk = Walk(judge_and_note).run()
    with capsys.disabled():
        print(f" [{len(walk.nodes)} states, {walk.edges} edges] ", end="")  # noqa: T201
    assert len(walk.nodes) > 1000
    every_row_is_walked(rows)
    there_is_no_dead_end(walk)
    one_recipe_helps_everywhere(walk)
    a_node_is_what_its_way_leads_to(walk)


# --- the walk bites -------------------------------------------------------------------------------


def armed_away(monkeypatch: pytest.MonkeyPatch) -> None:
    """A fault can be armed away."""
    monkeypatch.setitem(states.TABLE["FAULT"], "arm", "ARMED")


def clear_arms(monkeypatch: pytest.MonkeyPatch) -> None:
    """To clear is to arm."""
    monkeypatch.setitem(states.TABLE["HOLDING"], "clear", "ARMED")


def hold_is_deaf(monkeypatch: pytest.MonkeyPatch) -> None:
    """Who settles is not held."""
    monkeypatch.setitem(states.TABLE["SETTLING"], "hold", "SETTLING")


def gate_forgets(monkeypatch: pytest.MonkeyPatch) -> None:
    """A lease that was ended goes on."""
    monkeypatch.setattr(
        CommandGate, "_refuse", lambda gate, why: GateDecision(None, why, gate._accepted)
    )


def gate_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    """A permission never gets old."""
    judge_well = CommandGate.judge

    def judge_young(gate: CommandGate, reading: Any, now_ns: int) -> GateDecision:
        return judge_well(gate, reading._replace(age_s=0.0), now_ns)

    monkeypatch.setattr(CommandGate, "judge", judge_young)


def gate_goes_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """An owner of before is heard again."""
    judge_well = CommandGate.judge

    def judge_anew(gate: CommandGate, reading: Any, now_ns: int) -> GateDecision:
        gate._newest = (0, 0, 0)
        return judge_well(gate, reading, now_ns)

    monkeypatch.setattr(CommandGate, "judge", judge_anew)


def everybody_goes_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """No rank is looked at."""
    monkeypatch.setattr(commanders, "outranks", lambda asker, holder: True)


def turns_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    """The next owner has the turn of the one before."""
    monkeypatch.setattr(Ownership, "next", lambda turn: Ownership(turn.number))


def nothing_is_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    """Who had the arm keeps it over a stop."""
    monkeypatch.setattr(Commanders, "drop", lambda self: None)


def state_is_written_past_the_table(monkeypatch: pytest.MonkeyPatch) -> None:
    """A move begins at once, whatever the table says."""
    move_well = SeenArbiter.move

    def move_at_once(arbiter: SeenArbiter, *args: Any) -> Any:
        reply = move_well(arbiter, *args)
        if reply.accepted and arbiter.state in MAY_MOVE:
            arbiter.state = "STOPPING"
        return reply

    monkeypatch.setattr(SeenArbiter, "move", move_at_once)


def leases_come_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each person who arms gets the same number."""
    arm_well = SeenArbiter.arm

    def arm_alike(arbiter: SeenArbiter, *args: Any) -> Any:
        reply = arm_well(arbiter, *args)
        arbiter._lease = min(arbiter._lease, 1)
        return reply

    monkeypatch.setattr(SeenArbiter, "arm", arm_alike)


@pytest.mark.parametrize(
    "spoil",
    [
        armed_away,
        clear_arms,
        hold_is_deaf,
        gate_forgets,
        gate_waits,
        gate_goes_back,
        everybody_goes_first,
        turns_stay,
        nothing_is_dropped,
        state_is_written_past_the_table,
        leases_come_back,
    ],
)
def test_a_mistake_is_found(spoil: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each mutation of the real code breaks a rule somewhere on the walk."""
    spoil(monkeypatch)
    with pytest.raises(AssertionError, match=r"arm|hold|moves|clear"):
        Walk(judge, FEW).run()


def test_a_dead_end_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without its only row, nothing leads out of a fault any more."""
    monkeypatch.setitem(states.TABLE, "FAULT", {})
    few = (*FEW, *MOVES, "arm jog", "arm all + operator moves", "moves", "old command")
    walk = Walk(lambda edge: None, few).run()
    home = walk.from_where(lambda p: p.core.state == "ARMED")
    assert {walk.nodes[key].core.state for key in walk.nodes if key not in home} == {"FAULT"}
