"""The arbiter's table of states: every pair of state and event, and forbidden transitions."""

from itertools import product
from typing import get_args

import pytest

from forcemesh.messages import MAY_MOVE, ArbiterState
from services.arbiter.states import CLEARS, MEANS, TABLE, after

STATES: tuple[ArbiterState, ...] = get_args(ArbiterState)
EVENTS = ("ready", "arm", "back_off", "take", "begin", "end", "soften", "hold", "fault", "clear")
A_PERSONS = ("arm", "back_off")
AT_REST = tuple(state for state in STATES if state not in MAY_MOVE)

# Repeated on purpose: a change of the table has to be made twice.
EXPECTED = {
    ("BOOT", "ready"): "IDLE",
    ("BOOT", "back_off"): "ARMED",
    ("IDLE", "back_off"): "ARMED",
    ("HOLDING", "back_off"): "ARMED",
    ("FAULT", "back_off"): "ARMED",
    ("IDLE", "arm"): "ARMED",
    ("IDLE", "hold"): "HOLDING",
    ("ARMED", "take"): "SETTLING",
    ("ARMED", "begin"): "ACTIVE",
    ("ARMED", "hold"): "HOLDING",
    ("ARMED", "fault"): "FAULT",
    ("SETTLING", "begin"): "ACTIVE",
    ("SETTLING", "end"): "ARMED",
    ("SETTLING", "hold"): "HOLDING",
    ("SETTLING", "fault"): "FAULT",
    ("ACTIVE", "end"): "ARMED",
    ("ACTIVE", "take"): "SETTLING",
    ("ACTIVE", "soften"): "STOPPING",
    ("ACTIVE", "hold"): "HOLDING",
    ("ACTIVE", "fault"): "FAULT",
    ("STOPPING", "hold"): "HOLDING",
    ("STOPPING", "fault"): "FAULT",
    ("HOLDING", "clear"): "IDLE",
    ("HOLDING", "arm"): "ARMED",
    ("HOLDING", "fault"): "FAULT",
    ("FAULT", "clear"): "IDLE",
}

each_state = pytest.mark.parametrize("state", STATES)


@each_state
@pytest.mark.parametrize("event", EVENTS)
def test_every_pair_of_state_and_event_has_its_next_state(state: ArbiterState, event: str) -> None:
    """Swept: an unlisted pair changes nothing."""
    assert after(state, event) == EXPECTED.get((state, event), state)


def test_the_table_has_every_state_and_event_and_no_other() -> None:
    """Each state has a row and a sentence on its remedy; each event is one of the ten."""
    assert set(TABLE) == set(CLEARS) == set(MEANS) == set(STATES)
    for row in TABLE.values():
        assert set(row) <= set(EVENTS)
        assert set(row.values()) <= set(STATES)


@pytest.mark.parametrize(("state", "event"), list(product(AT_REST, EVENTS)))
def test_only_arming_leads_to_motion(state: ArbiterState, event: str) -> None:
    """From every state at rest, every event but arming leads to a state at rest."""
    if event not in A_PERSONS:
        assert after(state, event) not in MAY_MOVE


def test_fault_and_boot_cannot_be_armed() -> None:
    """FAULT requires a clear first, BOOT requires the inputs first.

    Backing off is possible without: its goal is the arbiter's own, and it ends in a latch.
    """
    assert after("FAULT", "arm") == "FAULT"
    assert after("BOOT", "arm") == "BOOT"
    assert [event for event in EVENTS if after("FAULT", event) != "FAULT"] == ["back_off", "clear"]


@pytest.mark.parametrize("state", MAY_MOVE)
def test_hold_and_fault_end_every_motion(state: ArbiterState) -> None:
    """Hold and fault stop the arm in every state that may move, each with its own latch."""
    assert after(state, "hold") == "HOLDING"
    assert after(state, "fault") == "FAULT"


@each_state
def test_hold_never_leads_to_motion_or_out_of_a_latch(state: ArbiterState) -> None:
    """A second hold is a hold; a fault does not become a hold."""
    assert after(state, "hold") not in MAY_MOVE
    assert after(after(state, "hold"), "hold") == after(state, "hold")


@each_state
def test_every_state_can_be_left_for_idle_or_motion(state: ArbiterState) -> None:
    """There is no dead end: an operator gets the arm to move again from any state."""
    reached = {state}
    for _ in STATES:
        reached |= {after(one, event) for one in reached for event in EVENTS}

    assert {"IDLE", "ARMED", "ACTIVE"} <= reached


@each_state
def test_a_state_at_rest_has_a_remedy(state: ArbiterState) -> None:
    """A state that may move has nothing to clear."""
    assert bool(CLEARS[state]) == (state not in MAY_MOVE)


def test_a_stop_in_progress_ends_in_the_latch() -> None:
    """No event leads from STOPPING to motion: neither an owner's end nor a new request."""
    assert {after("STOPPING", event) for event in EVENTS} == {"STOPPING", "HOLDING", "FAULT"}
