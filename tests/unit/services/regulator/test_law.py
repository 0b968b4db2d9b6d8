"""The PI law: no step of the command, signs, limits, approach, the point of contact."""

import math
from dataclasses import astuple, replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from common.motion.convert import vec3
from common.motion.frames import Oat, R_from_oat, rotation_between, rotation_from_vector
from forcemesh.messages import ZERO3
from services.regulator.gains import PiGains
from services.regulator.law import (
    LawInput,
    LawMotion,
    LawSettings,
    next_motion,
    soft_deadband,
    start_at,
)
from tests.fakes.bench import CELL
from tests.fakes.law_input import mode_input
from tuning.gain_rule import tune

DT_S = 0.004
MODES = ("position", "orientation", "both")
DOWN = R_from_oat(Oat(0.3, math.pi, 0.0))
START = pin.SE3(DOWN, np.array([0.0, 0.5, 0.2]))
SETTINGS = LawSettings.of(CELL)
NO_BAND = replace(SETTINGS, deadband_N=0.0, deadband_Nm=0.0, speed_max_m_s=1e3, speed_max_rad_s=1e3)
GAINS = PiGains.of(tune(CELL).gains)
WITH_P = PiGains(*[(gain,) * 3 for gain in (2e-5, 1e-3, 1e-2, 0.5)])

vectors = hnp.arrays(float, 3, elements=st.floats(-100.0, 100.0))
torques = hnp.arrays(float, 3, elements=st.floats(-10.0, 10.0))
turns = hnp.arrays(float, 3, elements=st.floats(-1.8, 1.8))
modes = st.sampled_from(MODES)
gains = st.builds(
    PiGains, *[st.tuples(*[st.floats(0.0, top)] * 3) for top in (1e-3, 0.1, 1.0, 50.0)]
)
each_mode = pytest.mark.parametrize("mode", MODES)


def sample(force_N: Any = (0, 0, 0), torque_Nm: Any = (0, 0, 0), **changes: Any) -> LawInput:
    """Return one sample, in mode position and without set point by default."""
    fields: dict[str, Any] = {"setpoint_N": 0.0, "mode": "position", "dt_s": DT_S}
    fields |= {"gains": GAINS, "motion": start_at(START), "T_measured": START}
    force, torque = np.array(force_N, dtype=float), np.array(torque_Nm, dtype=float)
    return mode_input(vec3(force), vec3(torque), **(fields | changes))


def step(before: LawMotion, item: LawInput, law_gains: PiGains, settings: LawSettings) -> LawMotion:
    """Return the motion after one sample."""
    return next_motion(replace(item, motion=before, gains=law_gains), settings)


def run(samples: list[LawInput], law_gains: PiGains, settings: LawSettings) -> list[LawMotion]:
    """Step through samples from the start; return all states with the first one."""
    states = [start_at(START)]
    for item in samples:
        states.append(step(states[-1], item, law_gains, settings))
    return states


def shift_m(before: LawMotion, after: LawMotion) -> np.ndarray:
    """Return the translation of the commanded TCP."""
    return np.asarray(after.T_base_tcp.translation - before.T_base_tcp.translation)


def turn_rad(before: LawMotion, after: LawMotion) -> np.ndarray:
    """Return the rotation of the commanded orientation in base axes."""
    return rotation_between(before.T_base_tcp.rotation, after.T_base_tcp.rotation)


# --- start ----------------------------------------------------------------------------------------


@given(vectors, torques, modes, st.floats(0.0, 40.0))
def test_the_start_is_the_measured_pose(force_N, torque_Nm, mode, setpoint_N) -> None:
    """The start does not move, and the first step has no proportional kick."""
    start = start_at(START)
    assert start.T_base_tcp == START
    only_p = replace(WITH_P, force_i_m_per_Ns=ZERO3, torque_i_rad_per_Nms=ZERO3)
    item = sample(force_N, torque_Nm, mode=mode, setpoint_N=setpoint_N)
    first = step(start, item, only_p, replace(NO_BAND, approach_m_s=0.0))
    assert shift_m(start, first) == pytest.approx(np.zeros(3), abs=1e-15)
    assert turn_rad(start, first) == pytest.approx(np.zeros(3), abs=1e-12)


def test_the_start_does_not_alias_the_measured_pose() -> None:
    """A pose is mutable: the law owns its copy."""
    measured = START.copy()
    state = start_at(measured)
    measured.translation = np.zeros(3)
    assert state.T_base_tcp == START


@each_mode
def test_no_error_means_no_motion(mode) -> None:
    """With the force at the set point and no moment the command stays exactly constant."""
    pressed = sample((0, 0, 10), mode=mode, setpoint_N=10.0)
    free = sample(mode=mode)
    for still in (pressed, free):
        states = run([still] * 20, WITH_P, SETTINGS)
        assert states[-1].T_base_tcp.translation == pytest.approx(START.translation, abs=1e-15)
        assert turn_rad(states[0], states[-1]) == pytest.approx(np.zeros(3), abs=1e-12)


# --- direction ------------------------------------------------------------------------------------


@given(vectors)
def test_position_yields_along_the_force(force_N) -> None:
    """Positive force is the environment pushing the robot: the robot moves along it."""
    assume(np.linalg.norm(force_N) > 1.0)
    before, after = run([sample(force_N)], GAINS, SETTINGS)
    moved = shift_m(before, after)

    assert moved @ force_N > 0.0
    assert np.cross(moved, force_N) == pytest.approx(np.zeros(3), abs=1e-12)
    assert after.T_base_tcp.rotation == pytest.approx(START.rotation, abs=1e-15)


@given(vectors, torques)
def test_orientation_yields_along_the_moment_and_turns_about_the_tcp(force_N, torque_Nm) -> None:
    """The rotation is about base axes; the TCP does not move for any force."""
    assume(np.linalg.norm(torque_Nm) > 0.1)
    item = sample(force_N, torque_Nm, mode="orientation", setpoint_N=10.0)
    before, after = run([item], GAINS, SETTINGS)
    turned = turn_rad(before, after)

    assert turned @ torque_Nm > 0.0
    assert np.cross(turned, torque_Nm) == pytest.approx(np.zeros(3), abs=1e-9)
    assert (after.T_base_tcp.translation == START.translation).all()


def test_pressing_moves_along_the_tools_axis_towards_the_set_point() -> None:
    """Set point 10 N, tool down: below it moves down, above it up."""
    for force_N, sign in ((5.0, -1.0), (15.0, 1.0)):
        before, after = run([sample((0, 0, force_N), setpoint_N=10.0)], GAINS, SETTINGS)
        assert math.copysign(1.0, shift_m(before, after)[2]) == sign


@given(turns, st.floats(1.0, 40.0), st.floats(-5.0, 5.0))
def test_the_set_point_presses_along_the_tool_in_any_orientation(turn, setpoint_N, more_N) -> None:
    """Equal error gives equal motion in tool axes: the law does not depend on gravity."""
    R = rotation_from_vector(turn)
    force_N = -(setpoint_N + more_N) * R[:, 2]
    assume(setpoint_N + more_N > 0.5 * setpoint_N)
    before = start_at(pin.SE3(R, START.translation))
    after = step(before, sample(force_N, setpoint_N=setpoint_N), GAINS, NO_BAND)
    gain = GAINS.force_i_m_per_Ns[2]
    assert shift_m(before, after) == pytest.approx(-gain * more_N * DT_S * R[:, 2], abs=1e-12)


# --- integral and proportional part ---------------------------------------------------------------


@given(st.lists(vectors, min_size=2, max_size=10), st.floats(0.001, 0.012))
def test_the_law_is_the_specifications_pi(forces, dt_s) -> None:
    """X - x0 = Kp (e - e0) + Ki sum e dt for any forces: no error builds up."""
    states = run([sample(force, dt_s=dt_s) for force in forces], WITH_P, NO_BAND)
    kp, ki = np.array(WITH_P.force_p_m_per_N), np.array(WITH_P.force_i_m_per_Ns)
    expected = kp * (forces[-1] - forces[0]) + ki * np.sum(forces, axis=0) * dt_s

    assert shift_m(states[0], states[-1]) == pytest.approx(expected, abs=1e-12)


def test_twice_the_rate_is_the_same_motion() -> None:
    """The integral is over seconds, not over samples."""
    slow = run([sample((0, 0, 8))] * 10, GAINS, SETTINGS)
    fast = run([sample((0, 0, 8), dt_s=DT_S / 2)] * 20, GAINS, SETTINGS)

    assert slow[-1].T_base_tcp.translation == pytest.approx(fast[-1].T_base_tcp.translation)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_each_axis_has_its_own_gain_in_base_axes(axis) -> None:
    """A gain of zero is a mask: no motion along that base axis and no rotation about it."""
    mask = np.ones(3)
    mask[axis] = 0.0
    masked = PiGains(*(vec3(np.array(gain) * mask) for gain in astuple(WITH_P)))
    states = run([sample((9, 8, 7), (3, 2, 1), mode="orientation")], masked, NO_BAND)
    assert turn_rad(*states)[axis] == pytest.approx(0.0, abs=1e-9)
    states = run([sample((9, 8, 7), (3, 2, 1))] * 3, masked, NO_BAND)
    moved = shift_m(states[0], states[-1])
    assert moved[axis] == 0.0
    assert np.count_nonzero(moved) == 2


# --- limits ---------------------------------------------------------------------------------------


@given(
    st.lists(st.tuples(vectors, torques, st.floats(0.0, 40.0), st.floats(1e-4, 0.02)), max_size=8),
    modes,
    gains,
)
def test_no_input_and_no_gain_makes_it_faster_than_its_limits(stream, mode, factor) -> None:
    """Speed and turning speed of both parts together are limited in every single step."""
    state = start_at(START)
    for force_N, torque_Nm, setpoint_N, dt_s in stream:
        item = sample(force_N, torque_Nm, setpoint_N=setpoint_N, mode=mode, dt_s=dt_s)
        after = step(state, item, factor, SETTINGS)
        assert np.linalg.norm(shift_m(state, after)) <= SETTINGS.speed_max_m_s * dt_s + 1e-12
        assert np.linalg.norm(turn_rad(state, after)) <= SETTINGS.speed_max_rad_s * dt_s + 1e-9
        state = after


@given(hnp.arrays(float, 3, elements=st.floats(-5.0, 5.0)), st.floats(0.0, 2.0))
def test_the_deadband_shortens_and_keeps_the_direction(error, width) -> None:
    """Zero inside; outside the length less the width: no step at its edge, no preferred axis."""
    short = np.array(soft_deadband(error, width))
    length = float(np.linalg.norm(error))

    assert np.linalg.norm(short) == pytest.approx(max(0.0, length - width), abs=1e-9)
    assert np.cross(short, error) == pytest.approx(np.zeros(3), abs=1e-9)
    assert short @ error >= 0.0


@given(vectors, hnp.arrays(float, 3, elements=st.floats(-1e-6, 1e-6)))
def test_the_deadband_is_continuous(error, little) -> None:
    """A small change of the error is at most the same change of the output."""
    change = np.subtract(soft_deadband(error + little, 0.3), soft_deadband(error, 0.3))

    assert np.linalg.norm(change) <= np.linalg.norm(little) * (1.0 + 1e-6) + 1e-12


# --- approach -------------------------------------------------------------------------------------


@given(st.floats(0.1, 40.0), modes)
def test_it_approaches_only_with_a_set_point_and_only_in_free_space(setpoint_N, mode) -> None:
    """Along the tool at the approach speed; never in mode orientation, never in contact."""
    fast = replace(SETTINGS, approach_accel_m_s2=1e6)
    before, after = run([sample(mode=mode, setpoint_N=setpoint_N)], GAINS, fast)
    approach = SETTINGS.approach_m_s * DT_S * START.rotation[:, 2]
    moved = np.zeros(3) if mode == "orientation" else approach
    assert after.contact == ("free" if mode == "orientation" else "approach")
    assert shift_m(before, after) == pytest.approx(moved, abs=1e-15)

    before, after = run([sample(mode=mode)], GAINS, SETTINGS)
    assert (after.contact, np.count_nonzero(shift_m(before, after))) == ("free", 0)

    touch = (0, 0, 1.01 * SETTINGS.touch_N)
    before, after = run([sample(touch, mode=mode, setpoint_N=setpoint_N)], GAINS, SETTINGS)
    assert after.contact == "contact"


def test_contact_has_hysteresis() -> None:
    """It begins above the touch force and ends below half of it, without chatter in between."""
    touch = SETTINGS.touch_N
    forces = [0.9 * touch, 1.1 * touch, 0.9 * touch, 0.6 * touch, 0.4 * touch, 0.6 * touch]
    states = run([sample((0, 0, f), setpoint_N=40.0) for f in forces], GAINS, SETTINGS)

    contacts = ["approach", "contact", "contact", "contact", "approach", "approach"]
    assert [state.contact for state in states[1:]] == contacts


def test_a_soft_press_still_detects_contact() -> None:
    """With a set point below the touch force, contact begins at half the set point."""
    states = run([sample((0, 0, 0.6), setpoint_N=1.0)], GAINS, SETTINGS)

    assert states[-1].contact == "contact"


def test_a_pull_is_no_contact() -> None:
    """Only a push against the tool's axis counts."""
    for force in ((0, 0, -30.0), (30.0, 0, 0)):
        assert run([sample(force, setpoint_N=10.0)], GAINS, SETTINGS)[-1].contact == "approach"


@each_mode
@pytest.mark.parametrize("angle_rad", [0.0, 1.6, 1.9, 2.05, math.pi])
def test_the_orientation_stays_a_rotation(mode, angle_rad) -> None:
    """For any number of steps, wherever the tool points: rounding errors do not grow."""
    T = pin.SE3(rotation_from_vector(angle_rad * np.array([0.6, 0.0, 0.8])), np.zeros(3))
    law, item = start_at(T), sample((0.0, 0.0, 1.0), (0.1, -0.2, 0.1), mode=mode)
    for _ in range(200):
        law = step(law, item, WITH_P, SETTINGS)
    R = law.T_base_tcp.rotation
    product = R @ R.T

    assert product == pytest.approx(np.eye(3), abs=1e-12)
    assert mode != "position" or pytest.approx(T.rotation, abs=1e-12) == R


# --- the point of contact -------------------------------------------------------------------------


@given(hnp.arrays(float, 3, elements=st.floats(-0.04, 0.04)), vectors, torques)
def test_turning_keeps_the_point_of_contact(r, force_N, free_Nm) -> None:
    """In mode both, pressed off centre at the set force, the point of contact does not move."""
    assume(np.linalg.norm(force_N) > 5.0)
    lever = r - force_N * (r @ force_N) / (force_N @ force_N)  # to the force's line of action
    torque_Nm = np.cross(lever, force_N)
    assume(np.linalg.norm(torque_Nm) > 0.05)
    still = replace(GAINS, force_i_m_per_Ns=ZERO3)
    before, after = run([sample(force_N, torque_Nm, mode="both")], still, NO_BAND)
    w, s = turn_rad(before, after), shift_m(before, after)

    assert np.linalg.norm(w) > 0.0
    assert s + np.cross(w, lever) == pytest.approx(np.zeros(3), abs=1e-9)


@pytest.mark.parametrize(
    ("force_N", "lever_m"), [(0.95, 0.0), (1.05, 0.05), (40.0, 0.05), (1.05, 5.0)]
)
def test_a_lever_below_the_noise_is_not_fed_forward(force_N: float, lever_m: float) -> None:
    """There is no lever below the touch force and never more than 0.1 m: it turns about the TCP."""
    item = sample((0, 0, force_N * SETTINGS.touch_N), mode="both")
    item = replace(item, torque_Nm=(lever_m * item.force_N[2], 0.0, 0.0))
    before, after = run([item], replace(GAINS, force_i_m_per_Ns=ZERO3), NO_BAND)
    lever = np.cross(turn_rad(before, after), [0.0, min(lever_m, 0.1), 0.0])

    assert shift_m(before, after) == pytest.approx(-lever * (force_N > 1.0), abs=1e-9)
