"""Force control of each axis in any frame, on a contact that couples all of them.

The nightly run draws a thousand combinations; here each pair of values of two factors occurs.
"""

import pytest

from tests.fakes.axis_tasks import FACTORS, Values, covering_array, drawn, pairs_of, run

ROWS = covering_array(FACTORS)
BATCHES, PER_BATCH = 50, 20


def test_the_rows_contain_every_pair() -> None:
    """Of any two factors each combination of values occurs in a row."""
    every = {pair for row in ROWS for pair in pairs_of(row)}
    sizes = [len(factor) for factor in FACTORS]
    assert len(every) == (sum(sizes) ** 2 - sum(size * size for size in sizes)) // 2


def expected_code(row: Values) -> str:
    """Return the code with which a combination is refused, `ok` if it runs."""
    place, _, frame, *kinds = row
    if frame == "path" and kinds[0] != "held":
        return "malformed"
    if place != "controller":
        return "ok"
    complies = any(kind == "free" or "," in kind for kind in kinds)
    halves = [[kind == "held" for kind in half] for half in (kinds[:3], kinds[3:])]
    holds_some = any(any(half) and not all(half) for half in halves)
    turned = frame in ("tool", "sensor") and holds_some
    return "host" if frame in ("pose", "path") or complies or turned else "ok"


@pytest.mark.parametrize("number", range(len(ROWS)))
def test_each_pair_of_frame_axes_law_and_host(number: int) -> None:
    """Set points are reached, held axes hold, and a change of frame makes no step of force."""
    outcome = run(ROWS[number], number)
    assert outcome.reply.code == expected_code(ROWS[number]), outcome.reply.text
    assert max(outcome.steady, outcome.cross, outcome.bump) <= 1.0, outcome


@pytest.mark.long
@pytest.mark.axes
@pytest.mark.parametrize("batch", range(BATCHES))
def test_drawn_combinations(batch: int) -> None:
    """The same for combinations drawn among those that the loop host can run."""
    rows = drawn(PER_BATCH, seed=batch)
    outcomes = [(row, run(row, number)) for number, row in enumerate(rows)]
    failed = [
        (row, outcome)
        for row, outcome in outcomes
        if not outcome.reply.accepted or max(outcome.steady, outcome.cross, outcome.bump) > 1.0
    ]
    assert not failed
