"""The arbiter's table of states: every pair of state and event, and what must never lead where."""

from itertools import product
from typing import get_args

import pytest

from forcemesh.messages import MAY_MOVE, ArbiterState
from services.arbiter.states import CLEARS, MEANS, TABLE, after
from tools.arbitration_page import PAGE, page

STATES: tuple[ArbiterState, ...] = get_args(ArbiterState)
EVENTS = ("ready", "arm", "back_off", "take", "begin", "end", "soften", "hold", "fault", "clear")
A_PERSONS = ("arm", "back_off")
AT_REST = tuple(state for state in STATES if state not in MAY_MOVE)

# Written out a second time on purpose: whoever changes the table must mean it.
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
    ("FAULT", "clear"): "IDLE",
}

each_state = pytest.mark.parametrize("state", STATES)


@each_state
@pytest.mark.parametrize("event", EVENTS)
def test_every_pair_of_state_and_event_leads_where_it_should(
    state: ArbiterState, event: str
) -> None:
    """Swept; what is not listed changes nothing."""
    assert after(state, event) == EXPECTED.get((state, event), state)


def test_the_table_knows_every_state_and_no_other_word() -> None:
    """Each state has a row and a sentence on what clears it; each event is one of the ten."""
    assert set(TABLE) == set(CLEARS) == set(MEANS) == set(STATES)
    for row in TABLE.values():
        assert set(row) <= set(EVENTS)
        assert set(row.values()) <= set(STATES)


@pytest.mark.parametrize(("state", "event"), list(product(AT_REST, EVENTS)))
def test_only_arming_leads_to_motion(state: ArbiterState, event: str) -> None:
    """From every state at rest, every event but a person's arming stays at rest."""
    if event not in A_PERSONS:
        assert after(state, event) not in MAY_MOVE


def test_a_fault_and_the_start_cannot_be_armed_away() -> None:
    """From FAULT a person clears first, from BOOT the inputs must be heard first.

    Backing off alone is possible without: its goal is the arbiter's own, and it ends in a latch.
    """
    assert after("FAULT", "arm") == "FAULT"
    assert after("BOOT", "arm") == "BOOT"
    assert [event for event in EVENTS if after("FAULT", event) != "FAULT"] == ["back_off", "clear"]


@pytest.mark.parametrize("state", MAY_MOVE)
def test_hold_and_fault_end_every_motion(state: ArbiterState) -> None:
    """Two events stop the arm from wherever it may move, each into its own latch."""
    assert after(state, "hold") == "HOLDING"
    assert after(state, "fault") == "FAULT"


@each_state
def test_hold_never_leads_to_motion_or_out_of_a_latch(state: ArbiterState) -> None:
    """Held twice is held; a fault is not softened into a hold."""
    assert after(state, "hold") not in MAY_MOVE
    assert after(after(state, "hold"), "hold") == after(state, "hold")


@each_state
def test_every_state_can_be_left_for_idle_or_motion(state: ArbiterState) -> None:
    """No dead end: a person gets the arm to move again from anywhere, step by step."""
    reached = {state}
    for _ in STATES:
        reached |= {after(here, event) for here in reached for event in EVENTS}

    assert {"IDLE", "ARMED", "ACTIVE"} <= reached


@each_state
def test_whoever_may_not_move_is_told_what_to_do(state: ArbiterState) -> None:
    """A state at rest has its sentence; where the arm may move there is nothing to clear."""
    assert bool(CLEARS[state]) == (state not in MAY_MOVE)


def test_a_stop_that_has_begun_goes_on_to_the_latch() -> None:
    """From STOPPING nothing leads back to motion: neither an owner's end nor a new wish."""
    assert {after("STOPPING", event) for event in EVENTS} == {"STOPPING", "HOLDING", "FAULT"}


def test_the_page_for_people_is_made_from_the_tables() -> None:
    """docs/arbitration.md shows every state, arrow, rank and reaction as they are."""
    assert PAGE.read_text(encoding="utf-8") == page(), "make readme"
