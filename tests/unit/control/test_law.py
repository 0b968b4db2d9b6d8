"""The PI law: no step of the command, signs, limits, approach, the point of contact."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from common.config.cell import CellConfig
from common.config.load import load_cell
from common.motion.convert import vec3
from common.motion.frames import Oat, R_from_oat, rotation_between, rotation_from_vector
from control import adaptive
from control.adaptive import AdaptiveSettings
from control.gain_rule import tune
from control.gains import gains_of
from control.law import (
    LawInput,
    LawMotion,
    LawSettings,
    next_motion,
    soft_deadband,
    start_at,
)
from control.shape import MotionLimits
from forcemesh.messages import ZERO3, Gains
from tests.fakes.bench import CELL, DEMO
from tests.fakes.law_input import DT_S, GAINS, LIMITS, START, mode_input, shaped

MODES = ("position", "orientation", "both")
SETTINGS = LawSettings.of(CELL)
NO_BAND = replace(SETTINGS, deadband_N=0.0, deadband_Nm=0.0)
NO_LIMITS = MotionLimits(1e3, 1e3)
WITH_P = gains_of(*[(gain,) * 3 for gain in (2e-5, 1e-3, 1e-2, 0.5)])

vectors = hnp.arrays(float, 3, elements=st.floats(-100.0, 100.0))
torques = hnp.arrays(float, 3, elements=st.floats(-10.0, 10.0))
turns = hnp.arrays(float, 3, elements=st.floats(-1.8, 1.8))
modes = st.sampled_from(MODES)
gains = st.builds(
    gains_of, *[st.tuples(*[st.floats(0.0, top)] * 3) for top in (1e-3, 0.1, 1.0, 40.0)]
)
each_mode = pytest.mark.parametrize("mode", MODES)


def sample(force_N: Any = (0, 0, 0), torque_Nm: Any = (0, 0, 0), **changes: Any) -> LawInput:
    """Return one sample, in mode position and without set point by default."""
    force, torque = np.array(force_N, dtype=float), np.array(torque_Nm, dtype=float)
    return mode_input(vec3(force), vec3(torque), **changes)


def step(before: LawMotion, item: LawInput, law_gains: Gains, settings: LawSettings) -> LawMotion:
    """Return the motion after one sample."""
    now = replace(item, motion=before, gains=law_gains)
    return shaped(next_motion(now, settings), now, LIMITS if settings is SETTINGS else NO_LIMITS)


def run(samples: list[LawInput], law_gains: Gains, settings: LawSettings) -> list[LawMotion]:
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


# --- direction ------------------------------------------------------------------------------------


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


@given(st.lists(vectors, min_size=2, max_size=10), st.floats(0.001, 0.012), gains)
def test_the_law_is_the_specifications_pi(forces, dt_s, factors) -> None:
    """X - x0 = Kp (e - e0) + Ki sum e dt, each base axis with its gain: a start makes no kick."""
    states = run([sample(force, dt_s=dt_s) for force in forces], factors, NO_BAND)
    kp, ki = np.array(factors.force_p_m_per_N), np.array(factors.force_i_m_per_Ns)
    expected = kp * (forces[-1] - forces[0]) + ki * np.sum(forces, axis=0) * dt_s
    assert shift_m(states[0], states[-1]) == pytest.approx(expected, abs=1e-9)
    assert states[-1].T_base_tcp.rotation == pytest.approx(START.rotation, abs=1e-15)


@given(vectors, torques, gains)
def test_a_torque_turns_the_tool_about_base_axes_through_the_tcp(force, torque, factors) -> None:
    """By Kir M dt in the first sample, which has no proportional kick; no force moves it."""
    item = sample(force, torque, mode="orientation", setpoint_N=10.0)
    before, after = run([item], factors, NO_BAND)
    expected = np.array(factors.torque_i_rad_per_Nms) * torque * DT_S
    assert turn_rad(before, after) == pytest.approx(expected, abs=1e-9)
    assert (after.T_base_tcp.translation == START.translation).all()


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
        assert np.linalg.norm(shift_m(state, after)) <= LIMITS.speed_m_s * dt_s + 1e-12
        assert np.linalg.norm(turn_rad(state, after)) <= LIMITS.speed_rad_s * dt_s + 1e-9
        state = after


@given(
    hnp.arrays(float, 3, elements=st.floats(-5.0, 5.0)), st.floats(0.0, 2.0), st.floats(0.0, 3.0)
)
def test_the_deadband_shortens_and_keeps_the_direction(error, width, rest) -> None:
    """Zero inside and below a rest; outside the length less the width, without a preferred axis."""
    short = np.array(soft_deadband(error, width, rest))
    length = float(np.linalg.norm(error))
    assume(abs(length - rest) > 1e-9)
    expected = length - width if length > max(width, rest) else 0.0
    assert np.linalg.norm(short) == pytest.approx(expected, abs=1e-9)
    assert np.cross(short, error) == pytest.approx(np.zeros(3), abs=1e-9)
    assert short @ error >= 0.0


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


@pytest.mark.parametrize(
    ("setpoint_N", "forces_N", "contacts"),
    [
        (
            40.0,
            (1.8, 2.2, 1.8, 1.2, 0.8, 1.2),
            "approach contact contact contact approach approach",
        ),
        (1.0, (0.4, 0.6), "approach contact"),
        (10.0, (-30.0, 0.0), "approach approach"),
    ],
)
def test_contact_begins_with_a_push_and_has_hysteresis(setpoint_N, forces_N, contacts) -> None:
    """From touch_N, 2 N, to half of it; from half of a lower set point. A pull is none."""
    states = run([sample((9.0, 0, N), setpoint_N=setpoint_N) for N in forces_N], GAINS, SETTINGS)
    assert [state.contact for state in states[1:]] == contacts.split()


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
    still = GAINS.replaced(force_i_m_per_Ns=ZERO3)
    before, after = run([sample(force_N, torque_Nm, mode="both")], still, NO_BAND)
    w, s = turn_rad(before, after), shift_m(before, after)

    assert np.linalg.norm(w) > 0.0
    assert s + np.cross(w, lever) == pytest.approx(np.zeros(3), abs=1e-9)


@pytest.mark.parametrize(
    ("force_N", "lever_m"), [(0.95, 0.05), (1.05, 0.05), (40.0, 0.05), (1.05, 5.0)]
)
def test_a_lever_below_the_noise_is_not_fed_forward(force_N: float, lever_m: float) -> None:
    """There is no lever below the touch force and never more than 0.1 m: it turns about the TCP."""
    item = sample((0, 0, force_N * SETTINGS.touch_N), mode="both")
    item = replace(item, torque_Nm=(lever_m * item.force_N[2], 0.0, 0.0))
    before, after = run([item], GAINS.replaced(force_i_m_per_Ns=ZERO3), NO_BAND)
    lever = np.cross(turn_rad(before, after), [0.0, min(lever_m, 0.1), 0.0])

    assert shift_m(before, after) == pytest.approx(-lever * (force_N > 1.0), abs=1e-9)


# --- rounded set points -------------------------------------------------------------------------

PER_MM = 98
STIFFEST_N_M = 1.1e5
SETTLES_S, RESTS_S = 8.0, 2.0
ROUNDING = 1e-9  # of the sizes of vectors
AXES = R_from_oat(Oat(0.3, 3.0, 0.2))
offsets_m = st.tuples(*[st.floats(0.0, 1e-3 / PER_MM)] * 3)


def cell_with_contact(k_N_m: float) -> CellConfig:
    """Return the cell over TCP for one stiffest contact."""
    return load_cell(DEMO.with_name("demo-tcp.yaml"), {"contact.stiffness_N_m": k_N_m})


def packets(cell: CellConfig, law: str, k_N_m: float, centre_m: np.ndarray) -> np.ndarray:
    """Return the rounded positions of a release against a spring in every axis [m]. Shape (n, 3).

    The spring's rest, at which the force is zero, is anywhere between the packet's positions.
    """
    gains, dt_s = tune(cell).gains, 1.0 / cell.rates.control_hz
    start = pin.SE3(AXES, centre_m + np.array([2e-4, -1e-4, -20.0 / k_N_m]))
    motion, settings_of = start_at(start), AdaptiveSettings.of(cell)
    sent: list[np.ndarray] = []
    state = adaptive.begin(start, start, None, settings_of) if law == "adaptive" else None
    late = round(cell.plant.tau_s / dt_s)
    for _ in range(round((SETTLES_S + RESTS_S) / dt_s)):
        at_m = sent[-late] if len(sent) >= late else start.translation
        sample = mode_input(
            vec3(-k_N_m * (at_m - centre_m)), (0.0, 0.0, 0.0), 0.0, "position", dt_s, gains, motion,
            pin.SE3(AXES, at_m),
        )  # fmt: skip
        if state is None:
            motion = next_motion(sample, LawSettings.of(cell))
        else:
            state, motion = adaptive.step(state, sample, settings_of)
        shaped(motion, sample, MotionLimits.of(cell, predicts=state is not None))
        sent.append(np.round(motion.T_base_tcp.translation * 1e3 * PER_MM) / PER_MM * 1e-3)
    return np.array(sent)


@pytest.mark.parametrize("law", ["plain", "adaptive"])
@settings(max_examples=8, deadline=None)
@given(st.floats(5e3, STIFFEST_N_M), offsets_m)
def test_it_comes_to_rest_wherever_the_contact_is_between_two_packets(law, k_N_m, offset_m) -> None:
    """For any stiffness and place the last two seconds are one packet, within 1 N of the goal."""
    cell = cell_with_contact(k_N_m)
    centre_m = np.array([0.1, 0.5, 0.2]) + offset_m
    sent = packets(cell, law, k_N_m, centre_m)[-round(RESTS_S * cell.rates.control_hz) :]
    assert np.ptp(sent, axis=0).max() == 0.0
    allowed_N = k_N_m * cell.plant.rounding_m + cell.force.deadband_N
    assert k_N_m * np.linalg.norm(sent[-1] - centre_m) <= allowed_N


def test_only_a_packet_rounds() -> None:
    """Half the diagonal of a cube of packet units; nothing where no set points are packets."""
    cell = cell_with_contact(2e4)
    assert cell.plant.rounding_m == pytest.approx(np.sqrt(3.0) / 2.0 / PER_MM * 1e-3)
    assert CELL.plant.rounding_m == 0.0
    plain = load_cell(DEMO.with_name("demo-plain.yaml"))
    assert plain.plant.rounding_m == 0.0
    assert LawSettings.of(plain).rest_N == LawSettings.of(CELL).rest_N == 0.0
    assert LawSettings.of(cell).rest_N == pytest.approx(2e4 * cell.plant.rounding_m)
