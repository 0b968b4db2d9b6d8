"""Force control of each axis in any frame, on a contact that couples all of them."""

from itertools import combinations

import pytest

from tests.fakes.axis_tasks import AxesRig, Values, drawn

BATCHES, PER_BATCH = 50, 20


def pairs_of(row: Values) -> set[tuple[int, str, int, str]]:
    """Return the pairs of values that occur in a row."""
    return {(i, row[i], j, row[j]) for i, j in combinations(range(len(row)), 2)}


def rows_with_every_pair() -> list[Values]:
    """Return rows in which each pair of values that a loop host can run occurs."""
    rows = [*drawn(1500, seed=BATCHES)]
    missing, chosen = set[tuple[int, str, int, str]]().union(*map(pairs_of, rows)), []
    while missing:
        chosen.append(max(rows, key=lambda row: len(missing & pairs_of(row))))
        missing -= pairs_of(chosen[-1])
    return chosen


ROWS = rows_with_every_pair()


def assert_promises(row: Values, seed: int) -> None:
    """Set points are reached, held axes hold, and a change of frame makes no step of force."""
    rig = AxesRig(row, seed)
    found = {"steady": rig.steady(), "cross": rig.cross(), "bump": rig.bump()}
    assert max(found.values()) <= 1.0, (row, found)


@pytest.mark.parametrize("number", range(len(ROWS)))
def test_each_pair_of_frame_axes_law_and_host(number: int) -> None:
    """What a loop host cannot run is refused: test_service_tasks.py."""
    assert_promises(ROWS[number], number)


@pytest.mark.long
@pytest.mark.axes
@pytest.mark.parametrize("batch", range(BATCHES))
def test_drawn_combinations(batch: int) -> None:
    """The nightly run draws a thousand."""
    for number, row in enumerate(drawn(PER_BATCH, seed=batch)):
        assert_promises(row, number)
