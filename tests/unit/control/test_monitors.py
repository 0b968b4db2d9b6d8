"""The monitors of force feedback in a virtual cell: search, lost contact, oscillation, first touch.

H32 inertia is no contact, H35 contact lost, H36 oscillation, H37 first touch. H34 wind-up:
test_session.py; H43 no step of the command: test_service.py; H31 wrong signs:
tests/unit/launch/test_virtual_cell_signs.py.
"""

from dataclasses import replace
from math import nextafter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.config.plant import PROBE_N
from control.gain_rule import tune
from control.law import LawSettings
from control.monitors import HALF_WAVES, HalfWaves, MonitorSettings, MonitorState
from forcemesh import topics
from forcemesh.requests import ForceStartRequest, GainsRequest
from tests.fakes.bench import CELL, cell_with
from tests.fakes.monitor_steps import monitor_sample, watched
from tests.fakes.regulator_bench import KI, PERIOD_S, RegulatorBench
from tests.unit.services.regulator.conftest import Press

OF_CELL = MonitorSettings.of(CELL)
TAU_S = CELL.plant.tau_s
BRAKE_M = 0.0005
DT_S = 0.004


def test_without_contact_the_search_ends_after_its_travel() -> None:
    """H35: search_m plus the braking distance at most; the cause is reported, and the arm holds."""
    press = Press(cell_with(sim__gap_m=0.02, force__search_m=0.004), 20.0)
    before_m = press.height_m()
    assert press.stop_code(2.0) == "travel"
    assert 0.004 <= before_m - press.height_m() <= 0.004 + BRAKE_M


def test_a_wall_that_vanishes_while_pressing_is_followed_slowly_and_not_far() -> None:
    """H35: after the first moments no faster than the approach, and lost_m at most."""
    press = Press(cell_with(sim__gap_m=0.001), 20.0)
    press.cell.advance(1.0)
    assert press.true_N() == pytest.approx(20.0, abs=1.0)
    press.cell.arm.plate.point_m[2] -= 0.1
    before_m = press.height_m()
    press.cell.advance(0.1)
    start_m, speed_m_s = press.height_m(), LawSettings.of(CELL).approach_m_s
    press.cell.advance(0.1)
    assert start_m - press.height_m() <= 1.05 * speed_m_s * 0.1
    assert press.stop_code(2.0) == "travel"
    fallen_m = before_m - press.height_m()
    assert CELL.force.lost_m <= fallen_m <= CELL.force.lost_m + 20.0 * KI * TAU_S + BRAKE_M


def half_waves(waves: list[tuple[float, float]]) -> int:
    """Return the count after sine half waves of (height, duration)."""
    swing, sign = HalfWaves(), 1.0
    for height, duration_s in [*waves, (1.0, 10 * DT_S)]:
        for phase in np.arange(0.5, round(duration_s / DT_S)) * DT_S / duration_s:
            error_N = sign * height * np.sin(np.pi * phase)
            swing.update(error_N, DT_S, OF_CELL.half_wave[2], OF_CELL)
        sign = -sign
    return swing.count


@given(st.floats(0.0, 1.5), st.floats(4.0, 20.0), st.floats(1.0, 6.0))
@settings(max_examples=40)
def test_five_periods_without_decay_are_an_oscillation(growth, height_N, half_tau) -> None:
    """H36: growing or constant, above ten deadbands; one that decays is none."""
    waves = [(height_N * growth ** (n / 2), half_tau * TAU_S) for n in range(HALF_WAVES)]
    lowest_N = min(height for height, _ in waves)
    if growth > 0.92 and lowest_N > OF_CELL.half_wave[2] / 0.95:
        assert half_waves(waves) >= HALF_WAVES
        assert half_waves(waves[:-2]) < HALF_WAVES
    elif growth < 0.8 or height_N < OF_CELL.half_wave[2]:
        assert half_waves(waves) < HALF_WAVES


def test_gains_too_high_for_a_plate_four_times_stiffer_are_detected() -> None:
    """H36: two halvings of the gains are not enough; then it is stopped, with the cause."""
    cell = cell_with(
        sim__gap_m=0.001,
        contact__stiffness_N_m=2e4 * 0.45 / 1.75,  # k Ki tau = 1.75, just beyond pi / 2
        limits__force_N=400.0,
        force__lost_m=0.05,
        force__approach_m_s=0.001,
    )
    press = Press(cell, 30.0)
    gain = 5.0 * tune(cell).force_i_m_per_Ns
    request = GainsRequest(force_i_m_per_Ns=(gain, gain, gain), accept_unstable=True)
    assert press.ask(topics.GAINS, request).accepted
    assert press.stop_code(8.0) == "oscillation"


def test_a_heavy_accelerating_tool_is_no_contact() -> None:
    """H32: 3 kg below the sensor at the approach speed: the state is free until the true touch."""
    cell = cell_with(
        sim__gap_m=0.012,
        sim__tool_mass_kg=3.0,
        payload__mass_kg=3.0,
        contact__inertia_kg=3.2,
        contact__stiffness_N_m=5e3,
        sim__stiffness_N_m=5e3,
        force__approach_m_s=0.03,
    )
    press = Press(cell, 20.0)
    for _ in range(1000):
        press.cell.advance(0.001)
        if press.cell.arm.lift_off_m <= 1e-5:
            break
        assert press.published.contact != "contact"
    assert press.cell.arm.lift_off_m <= 1e-5
    press.cell.advance(0.5)
    assert press.published.contact == "contact"


@pytest.mark.parametrize("stiffness_N_m", [5e3, 2e4, 1e5])
def test_the_first_touch_is_gentle(stiffness_N_m: float) -> None:
    """H37: a set point of 3 N adds no more than touch and probe on a plate of any stiffness."""
    changes = {"contact__stiffness_N_m": stiffness_N_m, "sim__stiffness_N_m": stiffness_N_m}
    slower = cell_with(**changes).plant.approach_limit_m_s
    approach_m_s = min(CELL.force.approach_m_s, slower)
    press = Press(cell_with(sim__gap_m=0.001, force__approach_m_s=approach_m_s, **changes), 3.0)
    forces_N = press.forces_N(1.2)
    assert forces_N[-1] == pytest.approx(3.0, abs=0.6)
    assert forces_N.max() <= CELL.force.touch_N + PROBE_N


def test_delayed_force_readings_do_not_count_as_work() -> None:
    """A spring is pressed and released with readings 12 ms late, as by the filter: no trip."""
    now, late = MonitorState(), [0.0] * 3
    now, _ = watched(now, monitor_sample("approach"), SETTINGS)
    for step in range(2000):
        depth_m = 0.001 * (1.0 - np.cos(2.0 * np.pi * step * DT_S / 0.3))
        late.append(2e4 * depth_m)
        sample = monitor_sample("contact", (0.0, 0.0, late[-4]), (0.0, 0.0, -depth_m))
        now, trip = watched(now, sample, SETTINGS)
        assert trip is None


# --- half waves ---------------------------------------------------------------------------------

EXACT_S = 2.0**-8  # sums of it are exact
LEAST_N = 3.0
SETTINGS = replace(
    MonitorSettings.of(CELL), half_wave_shortest_s=4.0 * EXACT_S, half_wave_longest_s=64.0 * EXACT_S
)
Waves = list[tuple[float, int]]  # height, duration in periods


def counted(waves: Waves, side: float = 1.0) -> int:
    """Return the count after half waves, which go through their deadband, on alternating sides."""
    swing, sign = HalfWaves(), side
    for height, periods in waves:
        for error in (0.5 * height, height, *[0.0] * (periods - 1)):
            swing.update(sign * error, EXACT_S, LEAST_N, SETTINGS)
        sign = -sign
    return swing.update(sign * LEAST_N, EXACT_S, LEAST_N, SETTINGS)


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
    settings = MonitorSettings.of(CELL)
    band_N, band_Nm = CELL.force.deadband_N, CELL.force.deadband_Nm
    assert settings.half_wave == pytest.approx([10.0 * band_N] * 3 + [10.0 * band_Nm] * 3)
    tau_s = CELL.plant.tau_s
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
        bench.pass_s(2.0 * round(CELL.plant.tau_s / PERIOD_S) * PERIOD_S)
        shares.append(bench.published().gain_share)
    assert (shares[9] == 1.0, shares[-1] < 1.0) == (True, is_felt)
