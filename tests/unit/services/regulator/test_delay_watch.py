"""Watch of the loop delay: its estimate from motion and link, and the share of the gains. Pure."""

from dataclasses import astuple
from math import inf, nextafter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.motion.convert import vec3
from forcemesh.messages import ZERO3, Gains
from services.regulator.delay_model import DelayModelSettings, LoopDelayModel
from services.regulator.delay_watch import (
    FOLLOW_SHARE,
    LEAST_MODEL_SHARE,
    LINK_S,
    LONGEST_EXCESS_TAUS,
    SURE_S,
    DelayWatch,
    DelayWatchSettings,
    ExcessFit,
    scaled_gains,
    share_to_send,
)
from services.regulator.gains import PiGains
from tests.fakes.bench import CELL, cell_with
from tuning.gain_rule import tune

SETTINGS = DelayWatchSettings.of(CELL)
DT_S = 0.004
START_M = (0.4, 0.1, 0.3)


class Plant:
    """An arm of a true delay and a compliance, and the watch that sees its reports."""

    def __init__(
        self, excess_s: float, *, seed: int = 1, noise_m: float = 0.0, yields: float = 0.0
    ) -> None:
        """Start at rest, at the position of the first command."""
        self.watch, self.time_s = DelayWatch(), 0.0
        self.excess_s, self.noise_m, self.yields = excess_s, noise_m, yields
        self._rng, self._arm = np.random.default_rng(seed), LoopDelayModel(ZERO3)
        self._hz = self._rng.uniform(0.5, 4.0, (3, 3))
        self._phase = self._rng.uniform(0.0, 6.0, (3, 3))

    def run(self, duration_s: float, *, height_m: float = 1e-3, each: int = 1) -> None:
        """Move along drawn sines; a report comes with each sample, or with each second one."""
        for number in range(round(duration_s / DT_S)):
            self.time_s += DT_S
            angles = 2.0 * np.pi * self._hz * self.time_s + self._phase
            travel_m = height_m * (np.sin(angles) - np.sin(self._phase)).sum(axis=1)
            self._follow(travel_m)
            noise_m = self._rng.normal(0.0, self.noise_m, 3) if self.noise_m else np.zeros(3)
            measured_m = np.array(START_M) + (1.0 - self.yields) * np.array(self._arm.arm)
            self.step(
                START_M + travel_m, measured_m + noise_m if number % each == each - 1 else None
            )

    def rest(self, duration_s: float) -> None:
        """Stay at the last command."""
        for _ in range(round(duration_s / DT_S)):
            travel_m = np.array(self._arm.command)
            self._follow(travel_m)
            self.step(START_M + travel_m, np.array(START_M) + self._arm.arm)

    def _follow(self, travel_m: np.ndarray) -> None:
        arm, delay_s = SETTINGS.arm, SETTINGS.arm.delay_s + self.excess_s
        self._arm.follow(vec3(travel_m), DT_S, DelayModelSettings(delay_s, arm.lag_s, 0.0))

    def step(self, command_m: np.ndarray, measured_m: np.ndarray | None) -> None:
        """Pass one sample to the watch, with a start at the origin."""
        if self.watch.model is None:
            self.watch.follow(START_M, START_M, dt_s=DT_S, is_late=False, settings=SETTINGS)
        measured = None if measured_m is None else vec3(measured_m)
        self.watch.follow(vec3(command_m), measured, dt_s=DT_S, is_late=False, settings=SETTINGS)


# --- estimate from motion -------------------------------------------------------------------------


@given(
    excess_s=st.floats(-0.005, 0.06),
    seed=st.integers(0, 1000),
    noise_m=st.sampled_from([0.0, 1e-5, 3e-5]),
    yields=st.floats(0.0, 0.3),
    each=st.integers(1, 3),
)
def test_the_excess_of_a_moving_arm_is_found_within_3_ms(
    excess_s: float, seed: int, noise_m: float, yields: float, each: int
) -> None:
    """For any motion, noise of the reports, compliance of the arm, and rate of the reports."""
    plant = Plant(excess_s, seed=seed, noise_m=noise_m, yields=yields)
    plant.run(1.5, each=each)
    assert plant.watch.excess_s == pytest.approx(excess_s, abs=0.003)
    assert plant.watch.is_measured


@pytest.mark.parametrize("law_excess_s", [0.0, 0.03])
def test_a_delay_that_changes_is_followed_up_and_down(law_excess_s: float) -> None:
    """Within a second of motion, also back to the model."""
    plant = Plant(0.03 - law_excess_s)
    plant.run(1.0)
    plant.excess_s = law_excess_s
    plant.run(1.5)
    assert plant.watch.excess_s == pytest.approx(law_excess_s, abs=0.002)


@given(noise_m=st.floats(0.0, 3e-5), seed=st.integers(0, 1000))
def test_an_arm_at_rest_changes_no_estimate(noise_m: float, seed: int) -> None:
    """Noise alone never counts as motion."""
    plant = Plant(0.05, seed=seed, noise_m=noise_m)
    plant.run(1.0, height_m=0.0)
    assert plant.watch.excess_s == 0.0
    assert not plant.watch.is_measured


def test_at_rest_the_last_estimate_stays() -> None:
    """It falls only when motion shows that the delay is back."""
    plant = Plant(0.03)
    plant.run(1.5)
    plant.rest(0.5)  # also the last motion has been reported
    before_s = plant.watch.excess_s
    plant.rest(2.0)
    assert plant.watch.excess_s == pytest.approx(before_s, abs=1e-6)
    assert before_s == pytest.approx(0.03, abs=0.002)


def test_the_dead_time_of_the_model_never_runs_backwards() -> None:
    """The estimate changes by at most half of the time that passes."""
    plant, before_s = Plant(0.08), 0.0
    for _ in range(400):
        plant.run(DT_S)
        change_s = abs(plant.watch.excess_s - before_s)
        assert change_s <= FOLLOW_SHARE * 2.0 * DT_S + 1e-12
        before_s = plant.watch.excess_s
    assert plant.watch.excess_s > 0.07


def test_the_estimate_is_bounded() -> None:
    """An arm that does not follow, or leads its commands, gives no absurd delay."""
    watch = DelayWatch()
    times_s = np.arange(1, 2000) * DT_S
    for time_s in times_s:  # ahead of its commands by 0.1 s
        command, ahead = (1e-3 * np.sin(5.0 * (time_s + lead_s)) for lead_s in (0.0, 0.1))
        watch.follow(
            (command, 0.0, 0.0), (ahead, 0.0, 0.0), dt_s=DT_S, is_late=False, settings=SETTINGS
        )
    assert watch.excess_s == -LEAST_MODEL_SHARE * SETTINGS.arm.delay_s
    assert watch.excess_now_s == 0.0
    assert watch.excess_s <= LONGEST_EXCESS_TAUS * SETTINGS.tau_s


def test_samples_after_a_late_input_are_left_out_until_the_model_is_right_again() -> None:
    """A gap moves the model's time against that of the arm."""
    plant = Plant(0.0)
    plant.run(0.5)
    plant.watch.follow(START_M, START_M, dt_s=DT_S, is_late=True, settings=SETTINGS)
    before_s = plant.watch.excess_s
    plant.excess_s = 0.05
    plant.run(SETTINGS.memory_s - 2.0 * DT_S)
    assert plant.watch.excess_s == before_s
    plant.run(1.0)
    assert plant.watch.excess_s > 0.02


def test_a_fit_needs_samples_and_motion_in_two_directions_of_its_plane() -> None:
    """Travel and speed that are collinear, and a few samples, determine nothing."""
    fit = ExcessFit()
    for number in range(6):
        x = float(number)
        assert fit.add((x, x * x, 0.0), (x * x, x, 0.0), (x, x, x), 0.9) is None
    fit = ExcessFit()
    for number in range(40):
        x = float(number % 7)
        assert fit.add((x, 0.0, 0.0), ZERO3, (x, 0.0, 0.0), 0.99) is None
    fitted = fit.add((1.0, 2.0, 0.0), (3.0, 1.0, 0.0), ZERO3, 0.99)
    assert fitted is None or fitted[1] >= 0.0


def test_the_constants_follow_from_the_cell() -> None:
    """The model up to the arm is the cell file's; slower reports need a longer memory."""
    robot = CELL.robot
    assert SETTINGS.tau_s == CELL.loop_delay_s
    assert SETTINGS.arm.delay_s == robot.delay_s + CELL.force.chain_s
    assert (SETTINGS.arm.lag_s, SETTINGS.arm.filter_s) == (robot.lag_s, 0.0)
    assert SETTINGS.tolerance_s == pytest.approx(max(0.4 * SETTINGS.tau_s, 0.005))
    slow = DelayWatchSettings.of(cell_with(rates__robot_hz=30.0))
    assert slow.memory_s == pytest.approx(20.0 / 30.0)
    assert 0.0 < SURE_S < SETTINGS.tolerance_s


# --- the link -------------------------------------------------------------------------------------


def test_the_rise_of_the_links_round_trip_counts_when_it_is_the_larger_one() -> None:
    """Its level at the start is part of the model; only what is added since then is excess."""
    watch = DelayWatch()
    for trip_s in (None, 0.004, None):
        watch.follow_link(trip_s, DT_S)
    assert (watch.trip_s, watch.excess_now_s) == (0.004, 0.0)
    for _ in range(round(4.0 * LINK_S / DT_S)):
        watch.follow_link(0.034, DT_S)
    assert watch.excess_now_s == pytest.approx(0.03, abs=0.001)
    watch.excess_s = 0.05
    assert watch.excess_now_s == 0.05
    watch.excess_s = 0.0
    for _ in range(round(8.0 * LINK_S / DT_S)):
        watch.follow_link(0.002, DT_S)
    assert watch.excess_now_s == pytest.approx(0.0, abs=1e-5)


# --- gain share -----------------------------------------------------------------------------------


def test_within_the_tolerance_the_gains_are_whole() -> None:
    """The tolerance itself is within; beyond, the share is tau over the estimated delay."""
    tau_s, tolerance_s = SETTINGS.tau_s, SETTINGS.tolerance_s
    assert SETTINGS.share_for(-0.01) == SETTINGS.share_for(tolerance_s) == 1.0
    beyond_s = nextafter(tolerance_s, inf)
    assert SETTINGS.share_for(beyond_s) == tau_s / (tau_s + beyond_s)
    assert SETTINGS.share_for(tau_s) == pytest.approx(0.5)


def test_the_share_falls_at_once_and_rises_slowly_to_exactly_one() -> None:
    """Without steps; full gains multiply nothing."""
    watch = DelayWatch(excess_s=SETTINGS.tau_s)
    shares = []
    for _ in range(50):
        watch.ramp(DT_S, SETTINGS)
        shares.append(watch.share)
    assert shares[0] > 0.9
    assert shares[24] == pytest.approx(0.5, abs=0.02)  # 0.1 s
    assert shares[-1] == 0.5
    watch.excess_s, before = 0.0, watch.share
    for _ in range(round(0.5 / DT_S)):
        watch.ramp(DT_S, SETTINGS)
        assert 0.0 < watch.share - before < 0.005
        before = watch.share
    assert watch.share < 0.85
    for _ in range(round(8.0 / DT_S)):
        watch.ramp(DT_S, SETTINGS)
    assert watch.share == 1.0


def test_two_oscillations_halve_the_gains_and_the_third_is_not_borne() -> None:
    """The lowered gains stay, whatever the delay does; both causes multiply."""
    watch = DelayWatch()
    assert [watch.lower() for _ in range(3)] == [True, True, False]
    assert watch.lowered == 0.25
    watch.excess_s = SETTINGS.tau_s
    for _ in range(1000):
        watch.ramp(DT_S, SETTINGS)
    assert watch.share == 0.125


def test_the_health_message_has_the_delay_once_it_is_measured() -> None:
    """What was not measured is left out."""
    watch = DelayWatch(share=0.5)
    model = {"loop_delay_model_s": SETTINGS.tau_s, "gain_fraction": 0.5}
    assert watch.numbers(SETTINGS) == model
    watch.excess_s, watch.is_measured = -0.002, True
    assert watch.numbers(SETTINGS) == {**model, "loop_delay_s": SETTINGS.tau_s - 0.002}


# --- gains ----------------------------------------------------------------------------------------


@given(st.floats(0.01, 0.99))
def test_every_gain_is_lowered_by_the_same_share(share: float) -> None:
    """Those of the law on the PC, and those that are sent to a controller."""
    gains = tune(CELL).gains
    lowered = scaled_gains(gains, share)
    assert isinstance(lowered, Gains)
    expected = [[share * part for part in row] for row in gains.as_dict().values()]
    assert np.allclose(list(lowered.as_dict().values()), expected, rtol=1e-15)
    assert np.allclose(astuple(PiGains.of(gains).times(share)), expected, rtol=1e-15)
    assert scaled_gains(gains, 1.0) is gains


@pytest.mark.parametrize(
    ("sent", "share", "then"),
    [(1.0, 0.9, 1.0), (1.0, 0.84, 0.84), (0.5, 0.55, 0.5), (0.5, 0.6, 0.6), (0.95, 1.0, 1.0)],
)
def test_a_controller_receives_only_large_changes_and_full_gains(
    sent: float, share: float, then: float
) -> None:
    """It takes one set of gains at a time, and fast changes stop a slow one."""
    assert share_to_send(sent, share) == then
