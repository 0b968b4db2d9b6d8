"""The adaptive law: no step of the command, limits, forgetting, and steps that it never makes."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from common.config.load import load_cell
from common.motion.convert import vec3
from common.motion.frames import Oat, R_from_oat, rotation_between, rotation_from_vector
from services.regulator.adaptive import (
    AdaptiveSettings,
    begin,
    controller_gain,
    limit_gain_for_braking,
    step,
)
from services.regulator.axis_task import IDENTITY, mode_task
from services.regulator.gains import PiGains
from services.regulator.law import LawMotion, start_at
from tests.fakes.bench import CELL, DEMO
from tests.fakes.law_input import mode_input
from tuning.gain_rule import LOOP_GAIN, tune

DT_S = 0.004
SETTINGS = AdaptiveSettings.of(CELL)
PLAIN = SETTINGS.plain
GAINS = PiGains.of(tune(CELL).gains)
START = pin.SE3(R_from_oat(Oat(0.3, math.pi, 0.0)), np.array([0.0, 0.5, 0.2]))
UP = -START.rotation[:, 2]
modes = st.sampled_from(["position", "orientation", "both"])
vectors = hnp.arrays(float, 3, elements=st.floats(-60.0, 60.0))
torques = hnp.arrays(float, 3, elements=st.floats(-3.0, 3.0))
histories = st.lists(
    st.tuples(vectors, torques, st.floats(0.0, 40.0), modes), min_size=1, max_size=40
)


def run(samples, *, gains=GAINS, chosen=SETTINGS, arm=None):
    """Step through samples; the arm is at the commanded pose unless `arm` is given."""
    law, adaptive = start_at(START), begin(START, START, None, chosen)
    states: list[tuple[LawMotion, object]] = [(law, adaptive)]
    for pushed_sample in samples:
        T = law.T_base_tcp if arm is None else arm
        sample = replace(pushed_sample, motion=law, T_measured=T, gains=gains)
        adaptive, law = step(adaptive, sample, chosen)
        states.append((law, adaptive))
    return states


def pushed(force_N, setpoint_N=0.0, mode="position", torque_Nm=(0.0, 0.0, 0.0)):
    """Return one sample."""
    return mode_input(
        vec3(np.array(force_N)),
        vec3(np.array(torque_Nm)),
        setpoint_N,
        mode,
        DT_S,
        GAINS,
        start_at(START),
        START,
    )


@settings(max_examples=60)
@given(histories)
def test_no_step_is_beyond_the_speed_limits_for_any_force(history) -> None:
    """For any forces, set points and modes a command moves at most one period's travel."""
    samples = [pushed(f, s, mode, t) for f, t, s, mode in history]
    states = [law for law, _ in run(samples)]
    for before, after in pairwise(states):
        travel_m = after.T_base_tcp.translation - before.T_base_tcp.translation
        turn_rad = rotation_between(before.T_base_tcp.rotation, after.T_base_tcp.rotation)
        assert np.linalg.norm(travel_m) <= PLAIN.speed_max_m_s * DT_S * (1 + 1e-9)
        assert np.linalg.norm(turn_rad) <= PLAIN.speed_max_rad_s * DT_S * (1 + 1e-6)


@settings(max_examples=60)
@given(histories)
def test_it_accelerates_and_brakes_no_faster_than_the_arm_may(history) -> None:
    """Otherwise the arbiter limits the command, and the prediction is wrong."""
    limit_m_s = CELL.limits.accel_m_s2 * DT_S
    samples = [pushed(f) for f, *_ in history]  # an approach has a limit of its own
    travels_m = [law.T_base_tcp.translation for law, _ in run(samples)]
    speeds_m_s = np.diff([START.translation, *travels_m], axis=0) / DT_S
    changes_m_s = np.linalg.norm(np.diff(speeds_m_s, axis=0), axis=1)
    assert changes_m_s.max() <= limit_m_s * (1 + 1e-9)


def test_a_turn_after_a_long_path_estimates_no_surface_motion() -> None:
    """100 mm across, then 2 degrees about the tip at the set force: the surface has not moved."""
    T, adaptive = START.copy(), begin(START, START, (2e4,) * 3, SETTINGS)
    for number in range(600):
        if number < 500:
            T.translation = T.translation + 2e-4 * T.rotation[:, 0]
        else:
            T.rotation = T.rotation @ rotation_from_vector(np.array([0.0, 4e-4, 0.0]))
        law = LawMotion(T.copy(), contact="contact")
        sample = replace(pushed(-10.0 * T.rotation[:, 2], 10.0), motion=law, T_measured=T)
        adaptive, _ = step(adaptive, sample, SETTINGS)
    assert adaptive.tracking.near
    assert abs(adaptive.tracking.drift.speed_m_s) < 1e-4


errors = st.floats(0.0, 100.0)


@given(errors, errors, st.floats(1e-6, 5e-3), st.floats(1e3, 2e5), st.floats(0.5, 10.0))
def test_at_any_error_the_arm_still_comes_to_rest(one_N, other_N, Ki, k, brake_m_s2) -> None:
    """Half the change of v^2 is at most the travel times a; the speed is never above Ki e."""

    def speed_m_s(error_N):
        gain = limit_gain_for_braking([Ki] * 3, [error_N] * 3, [k] * 3, brake_m_s2)
        assert max(gain) <= Ki
        return gain[0] * error_N

    low_N, high_N = sorted((one_N, other_N))
    slow, fast = speed_m_s(low_N), speed_m_s(high_N)
    assert fast >= slow * (1 - 1e-9)
    assert 0.5 * (fast**2 - slow**2) <= brake_m_s2 * (high_N - low_N) / k * (1 + 1e-6) + 1e-12


@settings(max_examples=10)
@given(st.floats(3.0, 40.0))
def test_at_its_set_point_it_does_not_move(setpoint_N) -> None:
    """The contact force equals the set point: no motion for any time."""
    end, _ = run([pushed(setpoint_N * UP, setpoint_N)] * 100)[-1]
    assert end.T_base_tcp.translation == pytest.approx(START.translation, abs=1e-12)


@given(vectors)
def test_it_yields_along_the_force(force_N) -> None:
    """The first step follows the force for any prediction."""
    (before, _), (after, _) = run([pushed(force_N)])
    moved_m = after.T_base_tcp.translation - before.T_base_tcp.translation
    assert moved_m @ force_N >= 0.0


def test_it_uses_the_gain_of_the_stiffest_contact_before_an_estimate() -> None:
    """An arm that does not move gives no estimate: the gain stays that of the stiffest contact."""
    _, adaptive = run([pushed(30.0 * UP)] * 50, arm=START)[-1]
    assert adaptive.k_N_m == pytest.approx([SETTINGS.stiffness.stiffest_N_m] * 3)


def test_every_axis_is_estimated_by_itself() -> None:
    """One axis of the tool is soft, one stiff, and one does not move."""
    k = np.array([5e3, 1.5e4, 1e4])
    law, adaptive = start_at(START), begin(START, START, None, SETTINGS)
    for number in range(60):
        force_N = np.array([30.0, 30.0, 5.0]) * np.exp(-number / 20.0 * np.array([1, 1, 0]))
        travel_m = START.rotation @ ((np.array([30.0, 30.0, 5.0]) - force_N) / k)
        T_measured = pin.SE3(START.rotation, START.translation + travel_m)
        sample = replace(pushed(START.rotation @ force_N), motion=law, T_measured=T_measured)
        adaptive, _ = step(adaptive, sample, SETTINGS)
    found = [axis.k_N_m for axis in adaptive.stiffness]
    assert found[:2] == pytest.approx(k[:2], rel=0.4)
    assert found[2] == SETTINGS.stiffness.stiffest_N_m
    assert [axis.is_identified for axis in adaptive.stiffness] == [True, True, False]


def test_an_axis_that_is_held_keeps_its_upper_bound_whatever_path_moves_along_it() -> None:
    """Its force is that of motion along the others: the contact along it would look soft."""
    law, adaptive = start_at(START), begin(START, START, None, SETTINGS)
    task = mode_task("position", 10.0, axes=(False, False, True) * 2)
    for number in range(100):
        force_N = np.array([0.02 * number, 0.0, 10.0 + 0.05 * number])
        shift_m = START.rotation @ np.array([-4e-5 * number, 0.0, -5e-6 * number])
        T_measured = pin.SE3(START.rotation, START.translation + shift_m)
        sample = replace(pushed(START.rotation @ force_N), task=task, T_measured=T_measured)
        adaptive, _ = step(adaptive, replace(sample, motion=law), SETTINGS)
    stiffest = SETTINGS.stiffness.stiffest_N_m
    assert [axis.k_N_m for axis in adaptive.stiffness][:2] == [stiffest, stiffest]
    assert adaptive.stiffness[2].k_N_m == pytest.approx(1e4, rel=0.3)


@given(st.floats(200.0, 2e5))
def test_the_controllers_gain_below_the_measured_stiffness_is_the_plain_laws(k_N_m: float) -> None:
    """A loop over TCP: an estimate that is too soft must not make the controller fast."""
    tcp = load_cell(DEMO.with_name("demo-tcp.yaml"))
    chosen = AdaptiveSettings.of(tcp)
    state, gains = begin(START, START, (k_N_m,) * 3, chosen), PiGains.of(tune(tcp).gains)
    largest = max(controller_gain(state, gains, IDENTITY, chosen))
    if k_N_m < chosen.softest_N_m:
        assert largest == pytest.approx(chosen.plain_gain_m_per_Ns)
    assert largest <= LOOP_GAIN / (chosen.softest_N_m * chosen.tau_s) * (1.0 + 1e-9)


@pytest.mark.parametrize("report_s", [0.004, 0.02, 0.08])
@pytest.mark.parametrize("k", [2e3, 1.5e4])
def test_a_slowly_reported_pose_does_not_lower_the_stiffness(report_s, k) -> None:
    """A report is older than the force until the next one and gives no new sample."""
    rates = CELL.rates.model_copy(update={"robot_hz": 1.0 / report_s})
    chosen = AdaptiveSettings.of(CELL.model_copy(update={"rates": rates}))
    every = round(report_s / DT_S)
    law, adaptive = start_at(START), begin(START, START, None, chosen)
    T_arm = T_report = START.copy()
    estimates = []
    for number in range(500):
        T_arm = pin.SE3(T_arm.rotation, T_arm.translation - 2e-6 * UP)  # 0.5 mm/s into it
        pressed_m = float((START.translation - T_arm.translation) @ UP)
        T_report = T_report if number % every else T_arm
        sample = pushed((k * pressed_m + 0.5) * UP, setpoint_N=1e3)
        is_new = number % every == 0
        sample = replace(sample, pose_is_new=is_new, motion=law, T_measured=T_report)
        adaptive, law = step(adaptive, sample, chosen)
        law = replace(law, T_base_tcp=T_arm)
        estimates.append(adaptive.stiffness[2].k_N_m)
    assert min(estimates) >= 0.98 * k


def test_the_identified_stiffness_is_dropped_when_contact_is_lost() -> None:
    """A short loss of contact keeps it, three tau without contact do not."""
    law, adaptive = start_at(START), begin(START, START, (2e3,) * 3, SETTINGS)
    kept = []
    for _ in range(round(4.0 * SETTINGS.tau_s / DT_S)):
        adaptive, law = step(adaptive, replace(pushed(0.0 * UP), motion=law), SETTINGS)
        kept.append(adaptive.stiffness[2].k_N_m)
    assert kept[0] == 2e3
    assert kept[-1] == SETTINGS.stiffness.stiffest_N_m


@given(st.floats(0.0, 3.0))
def test_requested_gains_slow_it_down_and_never_speed_it_up(share) -> None:
    """Half of the rule's gain is half of the speed; twice the gain is the same speed."""
    requested = replace(
        GAINS, force_i_m_per_Ns=tuple(share * gain for gain in GAINS.force_i_m_per_Ns)
    )
    full, slowed = (run([pushed(0.7 * UP)], gains=gains)[-1][0] for gains in (GAINS, requested))
    travels_m = [law.T_base_tcp.translation - START.translation for law in (full, slowed)]
    assert travels_m[1] == pytest.approx(min(share, 1.0) * travels_m[0], abs=1e-12)


@pytest.mark.parametrize("without", ["delay_compensation", "surface_tracking"])
def test_each_part_can_be_switched_off(without) -> None:
    """The law without one part differs and still yields."""
    force = CELL.force.model_copy(update={without: False})
    chosen = AdaptiveSettings.of(CELL.model_copy(update={"force": force}))
    samples = [pushed((9.0 + 0.1 * n) * UP, 10.0) for n in range(40)]
    with_it, alone = run(samples)[-1][0], run(samples, chosen=chosen)[-1][0]
    assert (alone.T_base_tcp.translation - START.translation) @ UP != 0.0
    if without == "delay_compensation":
        assert not np.allclose(with_it.T_base_tcp.translation, alone.T_base_tcp.translation)


@given(vectors, st.tuples(*[st.booleans()] * 6), st.sampled_from(["base", "tool"]))
def test_a_masked_axis_does_not_move(force_N, axes, frame) -> None:
    """Masked axes of the task frame do not move; the others do."""
    R = START.rotation if frame == "tool" else np.eye(3)
    task = mode_task("position", 0.0, axes=axes, in_base=frame == "base")
    sample = replace(pushed(force_N), task=task)
    end, _ = run([sample])[-1]
    moved = R.T @ (end.T_base_tcp.translation - START.translation)
    assert moved[~np.array(axes[:3])] == pytest.approx(0.0, abs=1e-15)
