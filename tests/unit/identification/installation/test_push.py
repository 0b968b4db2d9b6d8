"""Push test: inexact pushes along the base axes identify every wrong wiring."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.motion.frames import rotation_from_vector
from identification.installation.axis_fit import EYE, SIGNED
from identification.installation.push import (
    LEAST_DURATION_S,
    STEPS,
    PushDetector,
    PushResult,
    judge_pushes,
)
from tests.fakes.installations import belief, oat_matrix

CHANNELS = ("all six", "forces", "torques")
SIDEWAYS_M = 0.01  # lateral distance of the hand from the tip


def hand(step, wiring, channels, R_base_sensor, seed=0, off_deg=20.0, size_N=10.0) -> PushResult:
    """Return the readings while a person performs a step inexactly."""
    rng = np.random.default_rng([seed, STEPS.index(step)])
    axis = rng.normal(size=3)
    off = rotation_from_vector(np.radians(off_deg) * axis / np.linalg.norm(axis))
    direction = R_base_sensor.T @ off @ np.array(step.direction)
    lever = np.array([0.0, 0.0, 0.14]) + rng.uniform(-SIDEWAYS_M, SIDEWAYS_M, 3)
    force = size_N * direction if step.action == "push" else 0.5 * rng.normal(size=3)
    torque = np.cross(lever, force) if step.action == "push" else 0.6 * direction
    force_shows = EYE if channels == "torques" else wiring
    torque_shows = EYE if channels == "forces" else wiring
    return PushResult(step, force_shows @ force, torque_shows @ torque, R_base_sensor)


def judged(wiring, channels, R_base_sensor, expected=None, **hand_options):
    """Return the findings and the undetermined channels of a whole test."""
    done = [hand(step, wiring, channels, R_base_sensor, **hand_options) for step in STEPS]
    return judge_pushes(done, expected or belief())


TOOL_DOWN = np.diag([1.0, -1.0, -1.0]) @ oat_matrix((30.0, 0.0, 0.0))


@pytest.mark.parametrize("channels", CHANNELS)
def test_all_47_wrong_wirings_are_identified_by_pushes(channels) -> None:
    """Tool down, sensor at 30 degrees, hand 20 degrees off: only the correct wiring passes."""
    for number, wiring in enumerate(SIGNED):
        findings, undetermined = judged(wiring, channels, TOOL_DOWN, seed=number)
        assert bool(findings) == (number > 0), (channels, wiring.astype(int).tolist(), findings)
        assert number > 0 or not undetermined


@settings(max_examples=60, deadline=None)
@given(
    turn=st.tuples(*[st.floats(-3.0, 3.0)] * 3),
    wiring=st.integers(0, 47),
    off_deg=st.floats(0.0, 24.0),
    size_N=st.floats(4.0, 30.0),
    seed=st.integers(0, 10**6),
)
def test_forces_are_judged_in_any_attitude_and_for_any_push(
    turn, wiring, off_deg, size_N, seed
) -> None:
    """The verdict depends neither on the tool's attitude nor on the size of the push."""
    R = rotation_from_vector(np.array(turn))
    hand_options = {"off_deg": off_deg, "size_N": size_N, "seed": seed}
    findings, _ = judged(SIGNED[wiring], "forces", R, **hand_options)
    codes = {finding.code for finding in findings}
    assert bool(codes & {"force_axes", "reaction", "mounting"}) == (wiring > 0)


@settings(max_examples=30, deadline=None)
@given(wiring=st.integers(1, 47), seed=st.integers(0, 10**6))
def test_a_rotated_sensor_gets_the_angles_to_write(wiring, seed) -> None:
    """A rotation common to forces and torques is a mounting; another wiring is not."""
    (finding,), _ = judged(SIGNED[wiring], "all six", TOOL_DOWN, seed=seed)
    is_rotation = np.linalg.det(SIGNED[wiring]) > 0.0
    assert (finding.code == "mounting") == is_rotation
    assert ("oat_deg" in finding.remedy) == is_rotation
    assert ("driver" in finding.remedy) != is_rotation


def test_without_a_tip_and_a_twist_the_torques_stay_undetermined() -> None:
    """This is reported without a finding; the forces are judged."""
    pushes = [hand(step, EYE, "all six", TOOL_DOWN) for step in STEPS[:3]]
    findings, undetermined = judge_pushes(pushes, replace(belief(), p_flange_tcp_m=None))
    assert not findings
    assert any("Mx, My, Mz" in line for line in undetermined)
    _, with_tip = judge_pushes(pushes, belief())
    assert any("all of Mz" in line for line in with_tip)


# --- one push -------------------------------------------------------------------------------------


def detected(profile, by="push", step_s=0.01):
    """Return the detected push of a profile of sizes, or None."""
    detector, axis = PushDetector(by), np.array([0.0, 1.0, 0.0, 0.0, 0.0, 1.0])
    for k, size in enumerate(profile):
        found = detector.update(k * step_s, size * axis)
        if found is not None:
            return found
    return None


def test_a_push_ends_when_it_is_released() -> None:
    """The result is the mean of its upper part, without rise and fall."""
    profile = [*np.linspace(0.0, 10.0, 30), *[10.0] * 40, *np.linspace(10.0, 0.0, 30)]
    found = detected(profile)
    assert found is not None
    assert 9.0 < found[1] <= 10.0


@pytest.mark.parametrize(
    "profile",
    [[2.5] * 200, [0.0, *[20.0] * int(LEAST_DURATION_S / 0.01 / 2), *[0.0] * 50], [10.0] * 300],
    ids=["too weak", "a knock", "never released"],
)
def test_a_profile_that_is_no_push_is_ignored(profile) -> None:
    """No push is detected."""
    assert detected(profile) is None
