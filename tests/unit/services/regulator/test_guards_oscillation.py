"""Half waves of the loop, and the number of them that is an oscillation. Pure."""

from dataclasses import asdict, astuple, replace
from math import inf, nextafter
from typing import Any

import pytest

from services.regulator.guards import GuardSettings, HalfWaves
from tests.fakes.bench import CELL

DT_S = 0.004
MIN_HEIGHT_N = 3.0
SETTINGS = replace(
    GuardSettings.of(CELL),
    half_wave_shortest_s=0.016,
    half_wave_longest_s=0.25,
)


def test_a_half_wave_of_the_loop_is_higher_than_noise_and_about_two_delays_long() -> None:
    """Ten deadbands of each error; from half a delay to eight delays."""
    settings = GuardSettings.of(CELL)
    band_N, band_Nm = CELL.force.deadband_N, CELL.force.deadband_Nm
    assert settings.half_wave == pytest.approx([10.0 * band_N] * 3 + [10.0 * band_Nm] * 3)
    tau_s = CELL.loop_delay_s
    durations_s = settings.half_wave_shortest_s, settings.half_wave_longest_s
    assert durations_s == pytest.approx((0.5 * tau_s, 8.0 * tau_s))


def next_below(number: float) -> float:
    """Return the next smaller number."""
    return nextafter(number, -inf)


@pytest.mark.parametrize(
    ("changes", "counts"),
    [
        ({}, True),
        ({"age_s": 0.016}, True),
        ({"age_s": next_below(0.016)}, False),
        ({"age_s": 0.25}, True),
        ({"age_s": nextafter(0.25, inf)}, False),
        ({"height": 3.0}, True),
        ({"height": next_below(3.0)}, False),
        ({"height": 9.0, "before_last": 10.0}, True),
        ({"height": next_below(9.0), "before_last": 10.0}, False),
        ({"last": 1000.0}, True),  # the other side: a set-point error makes the sides unequal
    ],
)
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_half_wave_counts_by_its_time_its_height_and_the_one_before_on_its_side(
    changes: dict[str, float], counts: bool, side: float
) -> None:
    """Every limit itself still counts; a half wave outside ends the row, the next begins one."""
    before = {"side": side, "height": 4.0, "age_s": 0.1, "last": 3.5, "before_last": 3.25}
    fields: dict[str, Any] = before | {"count": 7} | changes
    swing = HalfWaves(**fields)
    swing.update(-2.5 * side, DT_S, MIN_HEIGHT_N, SETTINGS)
    assert asdict(swing) == {
        "side": -side,
        "height": 2.5,
        "age_s": 0.0,
        "last": fields["height"],
        "before_last": fields["last"],
        "count": 8 if counts else 0,
    }


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_first_half_wave_has_no_predecessor(side: float) -> None:
    """An error that leaves its deadband for the first time ends nothing."""
    assert astuple(HalfWaves()) == (0.0,) * 6
    swing = HalfWaves(count=5)
    swing.update(side * 4.0, DT_S, MIN_HEIGHT_N, SETTINGS)
    assert astuple(swing) == (side, 4.0, 0.0, 0.0, 0.0, 5)


@pytest.mark.parametrize("error", [6.0, 0.5, 0.0])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_half_wave_continues_through_its_deadband(error: float, side: float) -> None:
    """It keeps its greatest height and its duration grows; only the other side ends it."""
    swing = HalfWaves(side=side, height=4.0, age_s=0.1)
    swing.update(side * error, DT_S, MIN_HEIGHT_N, SETTINGS)
    assert astuple(swing) == (side, max(error, 4.0), 0.1 + DT_S, 0.0, 0.0, 0)
