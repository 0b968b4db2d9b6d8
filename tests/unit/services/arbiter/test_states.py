"""The arbiter's table of states: every pair of state and event; the texts of its status."""

from itertools import product
from typing import get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st

from forcemesh.faults import FAULTS, clipped
from forcemesh.messages import MAY_MOVE, ArbiterState, Trip
from services.arbiter.states import (
    ALONE,
    CLEARS,
    LINE_BYTES,
    MORE,
    MOST_LINES,
    MOST_TRIPS,
    after,
    lines,
    recent,
    what_next,
)

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


@pytest.mark.parametrize(("state", "event"), list(product(AT_REST, EVENTS)))
def test_only_arming_leads_to_motion(state: ArbiterState, event: str) -> None:
    """From every state at rest, every event but arming leads to a state at rest."""
    if event not in A_PERSONS:
        assert after(state, event) not in MAY_MOVE


@each_state
def test_a_state_at_rest_has_a_remedy(state: ArbiterState) -> None:
    """A state that may move has nothing to clear."""
    assert bool(CLEARS[state]) == (state not in MAY_MOVE)


# --- texts ---------------------------------------------------------------------------------------

texts = st.text(max_size=500)


@given(texts, st.integers(0, 600))
def test_a_text_is_cut_to_bytes_and_between_characters(text: str, most: int) -> None:
    """The result is the longest beginning that fits; a shorter text is unchanged."""
    short = clipped(text, most)

    assert text.startswith(short)
    assert len(short.encode()) <= most
    if short != text:
        assert len(text[: len(short) + 1].encode()) > most


@given(st.lists(texts, max_size=20))
def test_of_many_causes_the_first_and_the_newest_are_kept(causes: list[str]) -> None:
    """The first is the cause, the last is the latest reaction."""
    kept = recent(tuple(Trip(code=str(i), rule=i, text=text) for i, text in enumerate(causes)))

    assert len(kept) == min(len(causes), MOST_TRIPS)
    expected = [0, *range(len(causes))[1 - MOST_TRIPS :]] if len(causes) > MOST_TRIPS else (
        range(len(causes))
    )  # fmt: skip
    assert [trip.code for trip in kept] == [str(i) for i in expected]


@given(st.lists(texts, max_size=30))
def test_of_many_lines_the_first_are_reported(many: list[str]) -> None:
    """The rest is reported after these have been remedied. Long lines are cut."""
    reported = lines(many)
    assert len(reported) == min(len(many), MOST_LINES)
    for line, text in zip(reported, many, strict=False):
        assert len(line.encode()) <= LINE_BYTES
        assert line == text or (len(text.encode()) > LINE_BYTES and line.endswith(MORE))
        assert text.startswith(line.removesuffix(MORE))


def test_a_line_is_cut_between_words() -> None:
    """Half a number would be another number."""
    (line,) = lines(["12345 " * 40])
    assert set(line.removesuffix(MORE).split()) == {"12345"}


def test_the_next_step_is_the_remedy_where_arming_would_be_refused() -> None:
    """It is never `arm` while that is refused; a fault has its own remedy."""
    why = [Trip(code="force", rule=408, text="90 N"), Trip(code="payload", rule=517, text="none")]
    assert what_next("IDLE", []) == CLEARS["IDLE"]
    refused: tuple[ArbiterState, ...] = ("IDLE", "HOLDING")
    others: tuple[ArbiterState, ...] = ("FAULT", "ARMED")
    for state in refused:
        assert what_next(state, why) == f"{FAULTS['force'].remedy}; then arm"
    for state in others:
        assert what_next(state, why) == CLEARS[state]
    assert what_next("ARMED", why, "jog") == ALONE["jog"]
    assert what_next("HOLDING", [], "jog") == CLEARS["HOLDING"]
