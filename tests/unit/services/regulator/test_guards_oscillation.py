"""Half waves of the loop, and the number of them that is an oscillation."""

from dataclasses import replace
from math import nextafter

import pytest

from forcemesh.requests import ForceStartRequest
from services.regulator.guards import GuardSettings, HalfWaves
from tests.fakes.bench import CELL
from tests.fakes.regulator_bench import PERIOD_S, RegulatorBench

DT_S = 2.0**-8  # sums of it are exact
LEAST_N = 3.0
SETTINGS = replace(
    GuardSettings.of(CELL), half_wave_shortest_s=4.0 * DT_S, half_wave_longest_s=64.0 * DT_S
)
Waves = list[tuple[float, int]]  # height, duration in periods


def counted(waves: Waves, side: float = 1.0) -> int:
    """Return the count after half waves, which go through their deadband, on alternating sides."""
    swing, sign = HalfWaves(), side
    for height, periods in waves:
        for error in (0.5 * height, height, *[0.0] * (periods - 1)):
            swing.update(sign * error, DT_S, LEAST_N, SETTINGS)
        sign = -sign
    return swing.update(sign * LEAST_N, DT_S, LEAST_N, SETTINGS)


@pytest.mark.parametrize(
    ("wave", "counts"),
    [
        ((4.0, 20), True),
        ((4.0, 4), True),
        ((4.0, 3), False),
        ((4.0, 64), True),
        ((4.0, 65), False),
        ((3.0, 20), True),
        ((nextafter(3.0, 0.0), 20), False),
    ],
)
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_half_wave_counts_by_its_time_and_its_height(wave, counts, side) -> None:
    """Every limit itself still counts; a half wave outside ends the row, the next begins one."""
    assert counted([(3.0, 20), (3.0, 20), wave], side) == (3 if counts else 0)
    assert counted([(3.0, 20), wave, (4.0, 20), (4.0, 20)], side) == (4 if counts else 2)


@pytest.mark.parametrize(("last_N", "counts"), [(9.0, True), (nextafter(9.0, 0.0), False)])
def test_a_half_wave_that_is_smaller_than_the_last_one_on_its_side_decays(last_N, counts) -> None:
    """A set-point error makes the sides unequal: the other one does not matter."""
    assert counted([(10.0, 20), (1000.0, 20), (last_N, 20)]) == (3 if counts else 0)


def test_a_half_wave_of_the_loop_is_higher_than_noise_and_about_two_delays_long() -> None:
    """Ten deadbands of each error; from half a delay to eight delays."""
    settings = GuardSettings.of(CELL)
    band_N, band_Nm = CELL.force.deadband_N, CELL.force.deadband_Nm
    assert settings.half_wave == pytest.approx([10.0 * band_N] * 3 + [10.0 * band_Nm] * 3)
    tau_s = CELL.loop_delay_s
    durations_s = settings.half_wave_shortest_s, settings.half_wave_longest_s
    assert durations_s == pytest.approx((0.5 * tau_s, 8.0 * tau_s))


@pytest.mark.parametrize(
    ("mode", "axes", "is_felt"),
    [
        ("position", (True,) * 6, True),
        ("position", (False, True, True, True, True, True), False),
        ("orientation", (True,) * 6, True),
        ("orientation", (True, True, True, False, True, True), False),
    ],
)
def test_an_error_oscillates_along_and_about_free_axes_alone(mode, axes, is_felt) -> None:
    """The loop does not control the others. Ten half waves halve the gains, not nine."""
    bench = RegulatorBench()
    bench.pass_s(0.1)
    assert bench.start(ForceStartRequest(mode=mode, axes=axes)).accepted
    shares = []
    for number in range(14):
        side = 1.0 if number % 2 else -1.0
        if mode == "position":
            bench.push((10.0 * side, 0.0, 0.0))
        else:
            bench.push((0.0, 0.0, 0.0), (1.0 * side, 0.0, 0.0))
        bench.pass_s(2.0 * round(CELL.loop_delay_s / PERIOD_S) * PERIOD_S)
        shares.append(bench.published().gain_share)
    assert (shares[9] == 1.0, shares[-1] < 1.0) == (True, is_felt)
