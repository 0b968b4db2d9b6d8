"""Length limits of reports: texts are cut between characters, and the first cause is kept."""

from hypothesis import given
from hypothesis import strategies as st

from forcemesh.faults import FAULTS, MOST_TEXT_BYTES, clipped
from forcemesh.messages import ArbiterState, Trip
from services.arbiter.states import (
    ALONE,
    CLEARS,
    LINE_BYTES,
    MORE,
    MOST_LINES,
    MOST_TRIPS,
    lines,
    recent,
    what_next,
)

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


def test_the_limits_leave_room_for_all_causes() -> None:
    """All four causes and a line for each input fit."""
    assert MOST_TRIPS >= 3
    assert MOST_LINES >= 9
    assert len("wrench invalid: sensor/wrench stale: 12345 ms old, limit 1000 ms") <= LINE_BYTES
    assert MOST_TEXT_BYTES >= 4 * LINE_BYTES * 0.8
