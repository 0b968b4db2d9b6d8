"""The regulator's guards: wind-up, travel, oscillation, gentle approach, no step of the command.

H32 inertia is no contact, H34 wind-up, H35 contact lost, H36 oscillation, H37 first touch,
H43 no step at any change of mode. H31, wrong signs: tests/unit/launch/test_virtual_cell_signs.py.
"""

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.config.cell import CellConfig
from common.motion.convert import pose_of, record_of
from common.motion.frames import plus, rotation_between
from forcemesh import topics
from forcemesh.messages import ZERO3, RegulatorTarget, RobotCommand
from forcemesh.requests import ArmRequest, Empty, ForceStartRequest, GainsRequest
from launch.virtual_cell import VirtualCell
from services.regulator.guards import (
    HALF_WAVES,
    GuardSample,
    GuardSettings,
    GuardState,
    HalfWaves,
    kept_over_restart,
)
from services.regulator.law import PROBE_N, LawSettings
from tests.fakes.arbiter_world import T_START
from tests.fakes.bench import CELL, cell_with
from tests.fakes.guard_steps import watched
from tests.fakes.regulator_bench import KI, PERIOD_S, T_FLANGE_TCP, RegulatorBench
from tuning.gain_rule import tune

GUARDS = GuardSettings.of(CELL)
TAU_S = CELL.loop_delay_s
LAW = LawSettings.of(CELL)
BRAKE_M = 0.0005
DT_S = 0.004
QUICK = settings(max_examples=20, deadline=None)


class Press:
    """A virtual cell that presses, and its reports."""

    def __init__(self, cell: CellConfig, setpoint_N: float) -> None:
        """Tare, arm, start in mode position."""
        self.cell = VirtualCell(cell)
        self.arm, client = self.cell.arm, self.cell.client
        self._target = client.reader(topics.REGULATOR_TARGET)
        self._status = client.reader(topics.ARBITER_STATUS)
        self.stop_code = ""
        self.cell.advance(1.3)
        assert client.ask(topics.TARE, Empty()).accepted
        assert client.ask(topics.ARM, ArmRequest()).accepted
        request = ForceStartRequest(mode="position", setpoint_N=setpoint_N)
        assert client.ask(topics.FORCE_START, request).accepted

    @property
    def target(self) -> RegulatorTarget:
        """Newest target of the regulator."""
        target = self._target.read(self.cell.clock.now_ns()).message
        assert target is not None
        return target

    @property
    def codes(self) -> set[str]:
        """Codes of the arbiter's trips."""
        status = self._status.read(self.cell.clock.now_ns()).message
        return set() if status is None else {trip.code for trip in status.trips}

    def force_N(self) -> float:
        """Return the true contact force of the plate."""
        return float(np.linalg.norm(self.arm.true_wrench().force_N))

    def height_m(self) -> float:
        """Return the true height of the tool."""
        return float(self.arm.T_base_tcp.translation[2])

    def until_stopped(self, at_most_s: float) -> None:
        """Let time pass until the regulator has stopped and the arm has braked."""
        self.cell.advance(at_most_s, lambda: not self.target.valid)
        assert not self.target.valid
        self.stop_code = self.target.code
        self.cell.advance(0.3)


# --- travel: H35 ----------------------------------------------------------------------------------


def test_without_contact_the_search_ends_after_its_travel() -> None:
    """H35: search_m plus the braking distance at most; the cause is reported, and the arm holds."""
    press = Press(cell_with(sim__gap_m=0.02, force__search_m=0.004), 20.0)
    before_m = press.height_m()
    press.until_stopped(2.0)
    assert press.stop_code == "travel"
    assert press.codes == {"travel"}
    assert 0.004 <= before_m - press.height_m() <= 0.004 + BRAKE_M


def test_a_wall_that_vanishes_while_pressing_is_followed_slowly_and_not_far() -> None:
    """H35: after the first moments no faster than the approach, and lost_m at most."""
    press = Press(cell_with(sim__gap_m=0.001), 20.0)
    press.cell.advance(1.0)
    assert press.force_N() == pytest.approx(20.0, abs=1.0)
    press.arm.plate.point_m[2] -= 0.1
    before_m = press.height_m()
    press.cell.advance(0.1)
    start_m, speed_m_s = press.height_m(), LAW.approach_m_s
    press.cell.advance(0.1)
    assert start_m - press.height_m() <= 1.05 * speed_m_s * 0.1
    press.until_stopped(2.0)
    assert press.stop_code == "travel"
    fallen_m = before_m - press.height_m()
    assert CELL.force.lost_m <= fallen_m <= CELL.force.lost_m + 20.0 * KI * TAU_S + BRAKE_M


def sample_at(contact: Any, z_m: float = 0.0, force_N: float = 0.0) -> GuardSample:
    """Return one sample of a tool that points down."""
    T = pin.SE3(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, z_m]))
    return GuardSample(
        (0.0, 0.0, force_N), ZERO3, T, ZERO3, ZERO3, contact=contact, error=(0.0,) * 6,
        limited=(False,) * 3, setpoint_N=0.0, press_axis=(0.0, 0.0, -1.0), along_tool=True,
        side_trips=True, presses=True, rotates=False, follows=False, dt_s=DT_S,
    )  # fmt: skip


@given(st.lists(st.tuples(st.booleans(), st.floats(0.0, 0.002)), min_size=1, max_size=80))
def test_each_search_has_its_own_travel_limit(steps) -> None:
    """A search begins where contact was lost; the first one has search_m."""
    now, z_m, began_m, touched = GuardState(), 0.0, 0.0, False
    for in_contact, down_m in steps:
        z_m -= down_m
        now, trip = watched(now, sample_at("contact" if in_contact else "approach", z_m), GUARDS)
        touched = touched or in_contact
        if in_contact:
            began_m = z_m
        elif now.p_search_m is not None:
            began_m = now.p_search_m[2]
        limit_m = GUARDS.lost_m if touched else GUARDS.search_m
        is_too_far = not in_contact and began_m - z_m > limit_m
        assert (trip is not None and trip.code == "travel") == is_too_far


# --- oscillation: H36 -----------------------------------------------------------------------------


def half_waves(waves: list[tuple[float, float]]) -> HalfWaves:
    """Return the half waves of a force after sine half waves of (height, duration)."""
    swing, sign = HalfWaves(), 1.0
    for height, duration_s in [*waves, (1.0, 10 * DT_S)]:
        for phase in np.arange(0.5, round(duration_s / DT_S)) * DT_S / duration_s:
            error_N = sign * height * np.sin(np.pi * phase)
            swing.update(error_N, DT_S, GUARDS.half_wave[2], GUARDS)
        sign = -sign
    return swing


@given(st.floats(0.92, 1.5), st.floats(4.0, 20.0), st.floats(1.0, 6.0))
@QUICK
def test_five_periods_without_decay_are_an_oscillation(growth, height_N, half_tau) -> None:
    """H36: growing or constant; two half waves more, as the first on a side has none before."""
    waves = [(height_N * growth ** (n / 2), half_tau * TAU_S) for n in range(HALF_WAVES)]
    while min(height for height, _ in waves) < GUARDS.half_wave[2] / 0.95:
        waves = [(1.2 * height, long_s) for height, long_s in waves]
    assert half_waves(waves).count >= HALF_WAVES
    assert half_waves(waves[:-2]).count < HALF_WAVES


@given(
    st.lists(st.tuples(st.floats(0.0, 60.0), st.floats(0.02, 0.3)), max_size=12),
    st.floats(0.0, 0.8),
)
@QUICK
def test_a_decaying_oscillation_is_none(waves, keeps) -> None:
    """For any first height, if each half wave is much smaller than the last one on its side."""
    dying = [(60.0 * keeps ** (n / 2), long_s) for n, (_, long_s) in enumerate(waves)]
    assert half_waves(dying).count < HALF_WAVES


@given(st.lists(st.floats(-0.99, 0.99), max_size=100))
@QUICK
def test_noise_is_no_oscillation(errors) -> None:
    """Half waves below ten deadbands are not counted."""
    swing = HalfWaves()
    for share in errors:
        swing.update(share * GUARDS.half_wave[2], DT_S, GUARDS.half_wave[2], GUARDS)
    assert swing.count == 0


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
    assert press.cell.client.ask(topics.GAINS, request).accepted
    press.until_stopped(8.0)
    assert press.stop_code == "oscillation"
    assert "oscillation" in press.codes


# --- approach: H32, H37 ---------------------------------------------------------------------------


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
        if press.arm.lift_off_m <= 1e-5:
            break
        assert press.target.contact != "contact"
    assert press.arm.lift_off_m <= 1e-5
    press.cell.advance(0.5)
    assert press.target.contact == "contact"


@pytest.mark.parametrize("stiffness_N_m", [5e3, 2e4, 1e5])
def test_the_first_touch_is_gentle(stiffness_N_m: float) -> None:
    """H37: a set point of 3 N adds no more than touch and probe on a plate of any stiffness."""
    changes = {"contact__stiffness_N_m": stiffness_N_m, "sim__stiffness_N_m": stiffness_N_m}
    slower = cell_with(**changes).approach_limit_m_s
    approach_m_s = min(CELL.force.approach_m_s, slower)
    press = Press(cell_with(sim__gap_m=0.001, force__approach_m_s=approach_m_s, **changes), 3.0)
    peak_N = 0.0
    for _ in range(1200):
        press.cell.advance(0.001)
        peak_N = max(peak_N, press.force_N())
    assert press.force_N() == pytest.approx(3.0, abs=0.6)
    assert peak_N <= CELL.force.touch_N + PROBE_N


# --- wind-up: H34 ---------------------------------------------------------------------------------


@given(st.lists(st.floats(-40.0, 40.0), min_size=3, max_size=12), st.floats(1e-4, 1e-2))
@QUICK
def test_the_integral_is_never_beyond_the_applied_command(forces, speed_m_s) -> None:
    """H34: behind a limiter slower than the target it is at most one period ahead."""
    bench = RegulatorBench()
    bench.pass_s(0.1)
    assert bench.start().accepted
    let_through = T_START
    for force_N in forces:
        bench.push((0.0, 0.0, force_N))
        for _ in range(5):
            bench.step()
            proposed = bench.T_base_tcp() * T_FLANGE_TCP.inverse()
            ahead = proposed.translation - let_through.translation
            length = float(np.linalg.norm(ahead))
            assert length <= CELL.force.speed_max_m_s * PERIOD_S + speed_m_s * PERIOD_S + 1e-9
            share = min(1.0, speed_m_s * PERIOD_S / max(length, 1e-12))
            let_through = pin.SE3(T_START.rotation, let_through.translation + share * ahead)
            limited = share < 1.0
            pose = record_of(let_through)
            bench.command = RobotCommand(kind="setpoint", pose=pose, limited=limited)


def test_after_five_seconds_behind_a_limit_it_reverses_at_once() -> None:
    """H34: no integral has accumulated."""
    bench = RegulatorBench()
    bench.push((0.0, 0.0, 30.0))
    bench.pass_s(0.1)
    assert bench.start().accepted
    bench.command = RobotCommand(kind="setpoint", pose=record_of(T_START), limited=True)
    bench.pass_s(5.0)
    bench.push((0.0, 0.0, -30.0))
    bench.step(3)
    assert bench.T_base_tcp().translation[2] < (T_START * T_FLANGE_TCP).translation[2]


# --- no step of the command: H43 ------------------------------------------------------------------

requests = st.builds(
    ForceStartRequest,
    mode=st.sampled_from(["position", "orientation", "both"]),
    setpoint_N=st.floats(0.0, 40.0),
)
actions = st.lists(st.one_of(requests, st.just("stop")), min_size=2, max_size=8)


@given(actions, st.floats(-8.0, 8.0), st.floats(-0.5, 0.5))
@QUICK
def test_no_change_of_mode_set_point_or_stop_makes_a_step(plan, force_N, torque_Nm) -> None:
    """H43: a start is at the measured pose; then no step is longer than its speed allows."""
    bench = RegulatorBench()
    bench.push((0.3 * force_N, 0.0, force_N), (torque_Nm, 0.0, 0.0))
    bench.pass_s(0.1)
    poses: list[pin.SE3 | None] = [None]
    for action in plan:
        if action == "stop":
            bench.ask(topics.FORCE_STOP, Empty())
        else:
            assert bench.start(action).accepted
        for _ in range(4):
            bench.step()
            target = bench.published()
            poses.append(None if target.pose is None else pose_of(target.pose) * T_FLANGE_TCP)
    measured = T_START * T_FLANGE_TCP
    for before, after in pairwise(poses):
        if after is None:
            continue
        begin = measured if before is None else before
        steps = 3 if before is None else 2  # a request takes a period of its own
        moved_m = np.linalg.norm(after.translation - begin.translation)
        turned_rad = np.linalg.norm(rotation_between(begin.rotation, after.rotation))
        assert moved_m <= steps * LAW.speed_max_m_s * PERIOD_S + 1e-9
        assert turned_rad <= steps * LAW.speed_max_rad_s * PERIOD_S + 1e-9


# --- the codes ------------------------------------------------------------------------------------


def test_the_target_of_a_failure_has_its_code() -> None:
    """The wrench's code appears in the target, latched, and a new start clears it."""
    bench = RegulatorBench()
    bench.push((0.0, 0.0, 5.0))
    bench.pass_s(0.1)
    assert bench.start().accepted
    good = bench.wrench
    bench.wrench = good.replaced(valid=False, code="sensor_frozen", reason="x")
    bench.step()
    assert (bench.published().valid, bench.published().code) == (False, "sensor_frozen")
    bench.wrench = good
    bench.step(5)
    assert (bench.published().mode, bench.published().code) == ("position", "sensor_frozen")
    assert bench.start().accepted
    bench.step()
    assert (bench.published().valid, bench.published().code) == (True, "")


def test_energy_stored_before_the_start_may_return() -> None:
    """A press that begins in contact, and one that yields, are not checked by their work."""
    for first in ("contact", "free"):
        now, _ = watched(GuardState(), sample_at(first, 0.0, 30.0), GUARDS)
        now, _ = watched(now, sample_at("contact", 0.0, 30.0), GUARDS)
        _, trip = watched(now, sample_at("contact", 0.01, 30.0), GUARDS)
        assert trip is None
    now, _ = watched(GuardState(), sample_at("approach"), GUARDS)
    now, _ = watched(now, sample_at("contact", 0.0, 30.0), GUARDS)
    _, trip = watched(now, sample_at("contact", 0.001, 30.0), GUARDS)
    assert trip is not None
    assert (trip.code, trip.limit) == ("sensor_sign", CELL.force.environment_work_J)


def test_a_force_before_the_approach_is_no_touch() -> None:
    """Only the change since the tare counts."""
    preload = sample_at("approach", 0.0, -5.0)
    now, trip = watched(GuardState(), preload, GUARDS)
    assert trip is None
    _, trip = watched(now, replace(preload, force_N=(0.5, 0.0, -5.5)), GUARDS)
    assert trip is None
    _, trip = watched(now, replace(preload, force_N=(3.0, 0.0, -5.0)), GUARDS)
    assert trip is not None
    assert trip.code == "sensor_sign"


@pytest.mark.parametrize(("share", "is_wrong"), [(0.69, True), (0.71, False)])
def test_the_first_touch_is_within_45_degrees_of_the_tool(share: float, is_wrong: bool) -> None:
    """At least 0.7 of the increase is along the tool; this alone verifies its axis."""
    touch = plus(ZERO3, (np.sqrt(1.0 - share**2), 0.0, share), 2.0 * GUARDS.touch_N)
    now, trip = watched(GuardState(), sample_at("approach"), GUARDS)
    assert trip is None
    touched = replace(sample_at("approach"), force_N=touch)
    _, trip = watched(now, touched, GUARDS)
    assert ("" if trip is None else trip.code) == ("sensor_sign" if is_wrong else "")
    pressing = replace(touched, contact="contact", setpoint_N=5.0)
    assert watched(now, pressing, GUARDS)[0].verified == (not is_wrong)


def test_delayed_force_readings_do_not_count_as_work() -> None:
    """A spring is pressed and released with readings 12 ms late, as by the filter: no trip."""
    now, trip, late = GuardState(), None, [0.0] * 3
    now, trip = watched(now, sample_at("approach"), GUARDS)
    for step in range(2000):
        depth_m = 0.001 * (1.0 - np.cos(2.0 * np.pi * step * DT_S / 0.3))
        late.append(2e4 * depth_m)
        now, trip = watched(now, sample_at("contact", -depth_m, late[-4]), GUARDS)
        assert trip is None


def turning(force_N: float, **changes: Any) -> GuardSample:
    """Return one sample of a tool that may turn and has a set point of 8 N."""
    unverified = (True, True, False)
    fields: dict[str, Any] = {"rotates": True, "limited": unverified, "setpoint_N": 8.0}
    return replace(sample_at("contact", 0.0, force_N), **fields | changes)


@given(st.floats(0.0, 200.0))
def test_a_tool_turning_by_unverified_torques_presses_at_most_half_more(force_N) -> None:
    """Half the set point plus touch_N, once at the set point; verified axes may press more."""
    limit_N = 12.0 + CELL.force.touch_N
    now, _ = watched(GuardState(), turning(6.0), GUARDS)
    _, trip = watched(now, turning(force_N), GUARDS)
    assert (trip is not None) is (force_N > limit_N)
    if trip is not None:
        assert (trip.code, trip.limit) == ("sensor_sign", pytest.approx(limit_N))
    verified = turning(force_N, limited=(False,) * 3)
    for permitted in (verified, turning(force_N, rotates=False), turning(force_N, presses=False)):
        assert watched(now, permitted, GUARDS)[1] is None


def test_a_lowered_set_point_is_no_rise_of_the_force() -> None:
    """The old force may fall first; after that it must not rise again."""
    now, _ = watched(GuardState(), turning(6.0), GUARDS)
    now, trip = watched(kept_over_restart(now), turning(30.0), GUARDS)
    assert trip is None
    now, trip = watched(now, turning(8.0), GUARDS)
    assert trip is None
    _, trip = watched(now, turning(30.0), GUARDS)
    assert trip is not None
