"""What the regulator watches in itself: wind-up, ways, swinging, gentle approach, no bump.

H32 inertia is no contact, H34 wind-up, H35 contact lost, H36 oscillation, H37 first touch,
H43 no bump at any change of mode. H31, wrong signs: tests/unit/launch/test_virtual_cell_signs.py.
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
from common.config.load import cell_from_tree
from common.motion.convert import pose_of, record_of
from common.motion.frames import rotation_between
from forcemesh import topics
from forcemesh.messages import RegulatorTarget, RobotCommand
from forcemesh.requests import ArmRequest, Empty, ForceStartRequest
from launch.virtual_cell import VirtualCell
from services.regulator.guards import (
    GuardSample,
    GuardSettings,
    GuardState,
    kept_over_restart,
    verifies_press_axis,
    watch,
)
from services.regulator.oscillation import HALF_WAVES, HalfWaves, OscillationSettings, follow
from services.regulator.settings import PROBE_N, law_settings
from tests.fakes.arbiter_world import T_START
from tests.fakes.bench import CELL
from tests.fakes.regulator_bench import KI, PERIOD_S, T_FLANGE_TCP, RegulatorBench

GUARDS, SWING = GuardSettings.of(CELL), OscillationSettings.of(CELL)
TAU_S = CELL.loop_delay_s
LAW = law_settings(CELL)
BRAKE_M = 0.0005
DT_S = 0.004
QUICK = settings(max_examples=20, deadline=None)


def cell_with(**changes: Any) -> CellConfig:
    """Return the demo's cell with other values, `section__name`."""
    tree: dict[str, Any] = CELL.model_dump(mode="json")
    for dotted, value in changes.items():
        section, name = dotted.split("__")
        tree[section][name] = value
    return cell_from_tree(tree, "a cell")


class Press:
    """A virtual cell that presses, and what it says."""

    def __init__(self, cell: CellConfig, setpoint_N: float) -> None:
        """Tare, arm, start in mode position."""
        self.cell = VirtualCell(cell)
        self.arm, client = self.cell.arm, self.cell.client
        self._target = client.reader(topics.REGULATOR_TARGET)
        self._status = client.reader(topics.ARBITER_STATUS)
        self.gave_up = ""
        self.cell.advance(1.3)
        assert client.ask(topics.TARE, Empty()).accepted
        assert client.ask(topics.ARM, ArmRequest()).accepted
        wanted = ForceStartRequest(mode="position", setpoint_N=setpoint_N)
        assert client.ask(topics.FORCE_START, wanted).accepted

    @property
    def target(self) -> RegulatorTarget:
        """What the regulator said last."""
        target = self._target.read(self.cell.clock.now_ns()).message
        assert target is not None
        return target

    @property
    def codes(self) -> set[str]:
        """Why the arm was stopped."""
        status = self._status.read(self.cell.clock.now_ns()).message
        return set() if status is None else {trip.code for trip in status.trips}

    def force_N(self) -> float:
        """How hard the plate truly pushes."""
        return float(np.linalg.norm(self.arm.true_wrench().force_N))

    def height_m(self) -> float:
        """Where the tool truly is."""
        return float(self.arm.T_base_tcp.translation[2])

    def until_stopped(self, at_most_s: float) -> None:
        """Let time pass until the regulator has given up, and the arm has braked."""
        self.cell.advance(at_most_s, lambda: not self.target.valid)
        assert not self.target.valid
        self.gave_up = self.target.code
        self.cell.advance(0.3)


# --- the way: H35 ---------------------------------------------------------------------------------


def test_without_contact_the_search_ends_after_its_way() -> None:
    """H35: search_m and no more than braking beyond it; named, and the arm holds."""
    press = Press(cell_with(sim__gap_m=0.02, force__search_m=0.004), 20.0)
    before_m = press.height_m()
    press.until_stopped(2.0)
    assert press.gave_up == "travel"
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
    seen_m, speed_m_s = press.height_m(), LAW.approach_m_s
    press.cell.advance(0.1)
    assert seen_m - press.height_m() <= 1.05 * speed_m_s * 0.1
    press.until_stopped(2.0)
    assert press.gave_up == "travel"
    fallen_m = before_m - press.height_m()
    assert CELL.force.lost_m <= fallen_m <= CELL.force.lost_m + 20.0 * KI * TAU_S + BRAKE_M


def seen(contact: Any, z_m: float = 0.0, force_N: float = 0.0) -> GuardSample:
    """Return one sample of a tool that points down."""
    T = pin.SE3(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, z_m]))
    force = np.array([0.0, 0.0, force_N])
    return GuardSample(force, np.zeros(3), T, contact, np.zeros(6), turns=False, dt_s=DT_S)


@given(st.lists(st.tuples(st.booleans(), st.floats(0.0, 0.002)), min_size=1, max_size=80))
def test_each_search_has_its_own_way(steps) -> None:
    """It begins where contact was lost, and the first one has search_m."""
    now, z_m, began_m, touched = GuardState(), 0.0, 0.0, False
    for in_contact, down_m in steps:
        z_m -= down_m
        now, trip = watch(now, seen("contact" if in_contact else "approach", z_m), GUARDS)
        touched = touched or in_contact
        if in_contact:
            began_m = z_m
        elif now.p_search_m is not None:
            began_m = float(now.p_search_m[2])
        limit_m = GUARDS.lost_m if touched else GUARDS.search_m
        is_too_far = not in_contact and began_m - z_m > limit_m
        assert (trip is not None and trip.code == "travel") == is_too_far


# --- oscillation: H36 -----------------------------------------------------------------------------


def half_waves(waves: list[tuple[float, float]]) -> HalfWaves:
    """Return what is known after sine half waves of (height, duration), signs alternating."""
    swing, sign = HalfWaves(), 1.0
    for height, duration_s in [*waves, (1.0, 10 * DT_S)]:
        for phase in np.arange(0.5, round(duration_s / DT_S)) * DT_S / duration_s:
            error = np.zeros(6)
            error[2] = sign * height * np.sin(np.pi * phase)
            swing = follow(swing, error, DT_S, SWING)
        sign = -sign
    return swing


@given(st.floats(0.92, 1.5), st.floats(4.0, 20.0), st.floats(1.0, 6.0))
@QUICK
def test_five_periods_that_do_not_die_out_are_an_oscillation(growth, height_N, half_tau) -> None:
    """H36: growing or lasting; two more half waves, because the first on a side has none before."""
    waves = [(height_N * growth ** (n / 2), half_tau * TAU_S) for n in range(HALF_WAVES)]
    while min(height for height, _ in waves) < SWING.least[2] / 0.95:
        waves = [(1.2 * height, long_s) for height, long_s in waves]
    assert half_waves(waves).swings
    assert not half_waves(waves[:-2]).swings


@given(
    st.lists(st.tuples(st.floats(0.0, 60.0), st.floats(0.02, 0.3)), max_size=12),
    st.floats(0.0, 0.8),
)
@QUICK
def test_what_dies_out_is_none(waves, keeps) -> None:
    """However high it began: half waves each much smaller than the last one on their side."""
    dying = [(60.0 * keeps ** (n / 2), long_s) for n, (_, long_s) in enumerate(waves)]
    assert not half_waves(dying).swings


@given(st.lists(st.floats(-0.99, 0.99), max_size=100))
@QUICK
def test_noise_is_none(errors) -> None:
    """Nothing below ten deadbands is counted."""
    swing = HalfWaves()
    for share in errors:
        swing = follow(swing, share * SWING.least, DT_S, SWING)
    assert not swing.count.any()


def test_a_plate_four_times_stiffer_than_the_cell_file_says_is_noticed() -> None:
    """H36: the loop swings; it is stopped within some periods of four tau, and named."""
    cell = cell_with(
        sim__gap_m=0.001,
        contact__stiffness_N_m=2e4 * 0.45 / 1.75,  # k Ki tau = 1.75, just beyond pi / 2
        limits__force_N=400.0,
        force__lost_m=0.05,
        force__approach_m_s=0.001,
    )
    press = Press(cell, 30.0)
    press.until_stopped(6.0)
    assert press.gave_up == "oscillation"
    assert "oscillation" in press.codes


# --- approach: H32, H37 ---------------------------------------------------------------------------


def test_a_heavy_tool_that_speeds_up_is_no_contact() -> None:
    """H32: 3 kg before the sensor, as fast as it may approach: free until it truly touches."""
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
def test_the_first_touch_stays_gentle(stiffness_N_m: float) -> None:
    """H37: with a set point of 3 N no more than touch and probe on a plate of any stiffness."""
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
def test_the_integral_is_never_beyond_what_was_let_through(forces, speed_m_s) -> None:
    """H34: a limiter slower than the wish, whatever the force does: at most one period ahead."""
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


def test_after_five_seconds_behind_a_limit_it_turns_round_at_once() -> None:
    """H34: nothing has piled up that would have to be worked off first."""
    bench = RegulatorBench()
    bench.push((0.0, 0.0, 30.0))
    bench.pass_s(0.1)
    assert bench.start().accepted
    bench.command = RobotCommand(kind="setpoint", pose=record_of(T_START), limited=True)
    bench.pass_s(5.0)
    bench.push((0.0, 0.0, -30.0))
    bench.step(3)
    assert bench.T_base_tcp().translation[2] < (T_START * T_FLANGE_TCP).translation[2]


# --- no bump: H43 ---------------------------------------------------------------------------------

wishes = st.builds(
    ForceStartRequest,
    mode=st.sampled_from(["position", "orientation", "both"]),
    setpoint_N=st.floats(0.0, 40.0),
)
actions = st.lists(st.one_of(wishes, st.just("stop")), min_size=2, max_size=8)


@given(actions, st.floats(-8.0, 8.0), st.floats(-0.5, 0.5))
@QUICK
def test_no_change_of_mode_set_point_or_stop_makes_a_jump(plan, force_N, torque_Nm) -> None:
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
            said = bench.said()
            poses.append(None if said.pose is None else pose_of(said.pose) * T_FLANGE_TCP)
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


def test_giving_up_carries_the_code_of_what_failed() -> None:
    """The wrench's own code goes through to the target, latched, and a new start clears it."""
    bench = RegulatorBench()
    bench.push((0.0, 0.0, 5.0))
    bench.pass_s(0.1)
    assert bench.start().accepted
    good = bench.wrench
    bench.wrench = good.model_copy(update={"valid": False, "code": "sensor_frozen", "reason": "x"})
    bench.step()
    assert (bench.said().valid, bench.said().code) == (False, "sensor_frozen")
    bench.wrench = good
    bench.step(5)
    assert (bench.said().mode, bench.said().code) == ("position", "sensor_frozen")
    assert bench.start().accepted
    bench.step()
    assert (bench.said().valid, bench.said().code) == (True, "")


def test_work_that_what_is_pressed_on_stored_before_may_come_back() -> None:
    """A press that begins in contact, and one that gives way, are not judged by their work."""
    for first in ("contact", "free"):
        now, _ = watch(GuardState(), seen(first, 0.0, 30.0), GUARDS)
        now, _ = watch(now, seen("contact", 0.0, 30.0), GUARDS)
        _, trip = watch(now, seen("contact", 0.01, 30.0), GUARDS)
        assert trip is None
    now, _ = watch(GuardState(), seen("approach"), GUARDS)
    now, _ = watch(now, seen("contact", 0.0, 30.0), GUARDS)
    _, trip = watch(now, seen("contact", 0.001, 30.0), GUARDS)
    assert trip is not None
    assert (trip.code, trip.limit) == ("sensor_sign", CELL.force.environment_work_J)


def test_a_force_that_was_there_before_the_approach_is_no_touch() -> None:
    """What the tare left does not count: only what grows."""
    pulled = seen("approach", 0.0, -5.0)
    now, trip = watch(GuardState(), pulled, GUARDS)
    assert trip is None
    _, trip = watch(now, replace(pulled, force_N=np.array([0.5, 0.0, -5.5])), GUARDS)
    assert trip is None
    _, trip = watch(now, replace(pulled, force_N=np.array([3.0, 0.0, -5.0])), GUARDS)
    assert trip is not None
    assert trip.code == "sensor_sign"


@pytest.mark.parametrize(("share", "is_wrong"), [(0.69, True), (0.71, False)])
def test_the_first_touch_is_within_45_degrees_of_the_tool(share: float, is_wrong: bool) -> None:
    """At least 0.7 of the force that grows is along the tool; that alone proves its axis."""
    touch = 2.0 * GUARDS.touch_N * np.array([np.sqrt(1.0 - share**2), 0.0, share])
    now, trip = watch(GuardState(), seen("approach"), GUARDS)
    assert trip is None
    felt = replace(seen("approach"), force_N=touch)
    _, trip = watch(now, felt, GUARDS)
    assert ("" if trip is None else trip.code) == ("sensor_sign" if is_wrong else "")
    pressing = replace(felt, contact="contact", setpoint_N=5.0)
    assert verifies_press_axis(now, pressing, GUARDS) == (not is_wrong)


def test_work_told_late_is_no_gift() -> None:
    """A spring that is pressed and released, told 12 ms late as the filter does: all is well."""
    now, trip, late = GuardState(), None, [0.0] * 3
    now, trip = watch(now, seen("approach"), GUARDS)
    for step in range(2000):
        depth_m = 0.001 * (1.0 - np.cos(2.0 * np.pi * step * DT_S / 0.3))
        late.append(2e4 * depth_m)
        now, trip = watch(now, seen("contact", -depth_m, late[-4]), GUARDS)
        assert trip is None


def turning(force_N: float, **changes: Any) -> GuardSample:
    """Return one sample of a tool that may turn and that is to press with 8 N."""
    unproven = np.array([True, True, False])
    fields: dict[str, Any] = {"turns": True, "limited": unproven, "setpoint_N": 8.0}
    return replace(seen("contact", 0.0, force_N), **fields | changes)


@given(st.floats(0.0, 200.0))
def test_a_tool_that_turns_by_unproven_torques_presses_little_more_than_it_is_to(force_N) -> None:
    """Half the set point and touch_N more, once it was at the set point; proved axes may press."""
    most_N = 12.0 + CELL.force.touch_N
    now, _ = watch(GuardState(), turning(6.0), GUARDS)
    _, trip = watch(now, turning(force_N), GUARDS)
    assert (trip is not None) is (force_N > most_N)
    if trip is not None:
        assert (trip.code, trip.limit) == ("sensor_sign", pytest.approx(most_N))
    proved = turning(force_N, limited=np.zeros(3, dtype=bool))
    for fine in (proved, turning(force_N, turns=False), turning(force_N, presses=False)):
        assert watch(now, fine, GUARDS)[1] is None


def test_a_set_point_that_is_lowered_makes_no_rise_of_the_force() -> None:
    """The force that was wanted before may fall first; once it has, it must not grow again."""
    now, _ = watch(GuardState(), turning(6.0), GUARDS)
    now, trip = watch(kept_over_restart(now), turning(30.0), GUARDS)
    assert trip is None
    now, trip = watch(now, turning(8.0), GUARDS)
    assert trip is None
    _, trip = watch(now, turning(30.0), GUARDS)
    assert trip is not None
