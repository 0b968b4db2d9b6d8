"""A hand that pushes along the axes of the base shows every wrong wiring, weak and off as it is."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.motion.frames import rotation_from_vector
from identification.installation.axes import EYE
from identification.installation.axis_fit import SIGNED
from identification.installation.push import (
    LEAST_DURATION_S,
    STEPS,
    PushDetector,
    PushResult,
    judge_pushes,
)
from tests.fakes.installations import belief, oat_matrix

CHANNELS = ("all six", "forces", "torques")
SIDEWAYS_M = 0.01  # the hand is so far beside the tip


def hand(asked, wiring, channels, R_base_sensor, seed=0, off_deg=20.0, size_N=10.0) -> PushResult:
    """Return what a sensor reads while a person does what was asked, roughly."""
    rng = np.random.default_rng([seed, STEPS.index(asked)])
    axis = rng.normal(size=3)
    off = rotation_from_vector(np.radians(off_deg) * axis / np.linalg.norm(axis))
    direction = R_base_sensor.T @ off @ np.array(asked.direction)
    lever = np.array([0.0, 0.0, 0.14]) + rng.uniform(-SIDEWAYS_M, SIDEWAYS_M, 3)
    force = size_N * direction if asked.action == "push" else 0.5 * rng.normal(size=3)
    torque = np.cross(lever, force) if asked.action == "push" else 0.6 * direction
    force_shows = EYE if channels == "torques" else wiring
    torque_shows = EYE if channels == "forces" else wiring
    return PushResult(asked, force_shows @ force, torque_shows @ torque, R_base_sensor)


def judged(wiring, channels, R_base_sensor, of=None, **how):
    """Return findings and what was not seen after the whole test."""
    done = [hand(asked, wiring, channels, R_base_sensor, **how) for asked in STEPS]
    return judge_pushes(done, of or belief())


TOOL_DOWN = np.diag([1.0, -1.0, -1.0]) @ oat_matrix((30.0, 0.0, 0.0))


@pytest.mark.parametrize("channels", CHANNELS)
def test_all_47_wrong_wirings_are_told_by_pushes(channels) -> None:
    """Tool down, sensor at 30 degrees, a hand that is 20 degrees off: right is right, 47 wrong."""
    for number, wiring in enumerate(SIGNED):
        findings, unseen = judged(wiring, channels, TOOL_DOWN, seed=number)
        assert bool(findings) == (number > 0), (channels, wiring.astype(int).tolist(), findings)
        assert number > 0 or not unseen


@settings(max_examples=120, deadline=None)
@given(
    turn=st.tuples(*[st.floats(-3.0, 3.0)] * 3),
    wiring=st.integers(0, 47),
    off_deg=st.floats(0.0, 24.0),
    size_N=st.floats(4.0, 30.0),
    seed=st.integers(0, 10**6),
)
def test_whatever_the_attitude_and_the_hand(turn, wiring, off_deg, size_N, seed) -> None:
    """Forces are judged at any attitude of the tool, however hard the push."""
    R = rotation_from_vector(np.array(turn))
    how = {"off_deg": off_deg, "size_N": size_N, "seed": seed}
    findings, _ = judged(SIGNED[wiring], "forces", R, **how)
    codes = {finding.code for finding in findings}
    assert bool(codes & {"force_axes", "reaction", "mounting"}) == (wiring > 0)


@settings(max_examples=60, deadline=None)
@given(wiring=st.integers(1, 47), seed=st.integers(0, 10**6))
def test_a_turned_sensor_gets_the_angles_to_write(wiring, seed) -> None:
    """A rotation that forces and torques share is a mounting; any other wiring is none."""
    (finding,), _ = judged(SIGNED[wiring], "all six", TOOL_DOWN, seed=seed)
    is_rotation = np.linalg.det(SIGNED[wiring]) > 0.0
    assert (finding.code == "mounting") == is_rotation
    assert ("oat_deg" in finding.remedy) == is_rotation
    assert ("driver" in finding.remedy) != is_rotation


def test_reactions_are_told_from_a_hanging_arm() -> None:
    """What the weight cannot tell, a push does: no word of the ceiling."""
    (finding,), _ = judged(-EYE, "all six", TOOL_DOWN)
    assert finding.code == "reaction"
    assert "remap Fx = -Fx" in finding.remedy
    assert "Mz = -Mz" in finding.remedy


def test_pushes_that_fit_nothing_are_to_be_repeated() -> None:
    """Twice the same direction: cannot tell, and no wiring is made up."""
    done = [hand(asked, EYE, "all six", TOOL_DOWN) for asked in STEPS]
    done[1] = replace(done[1], change_N=done[0].change_N)
    (finding,), _ = judge_pushes(done, belief())
    assert (finding.code, finding.kind) == ("pushes", "unsure")


def test_without_a_tip_and_a_twist_the_torques_stay_unseen() -> None:
    """Said, and no mistake invented; the forces are judged."""
    pushes = [hand(asked, EYE, "all six", TOOL_DOWN) for asked in STEPS[:3]]
    findings, unseen = judge_pushes(pushes, replace(belief(), p_flange_tcp_m=None))
    assert not findings
    assert any("Mx, My, Mz" in line for line in unseen)
    _, with_tip = judge_pushes(pushes, belief())
    assert any("all of Mz" in line for line in with_tip)


# --- one push -------------------------------------------------------------------------------------


def followed(profile, by="push", step_s=0.01):
    """Feed a profile of sizes; return what came of it and when."""
    follower, axis = PushDetector(by), np.array([0.0, 1.0, 0.0, 0.0, 0.0, 1.0])
    for k, size in enumerate(profile):
        found = follower.update(k * step_s, size * axis)
        if found is not None:
            return found
    return None


def test_a_push_is_over_when_it_is_let_go() -> None:
    """Its upper part counts, not rise and fall."""
    profile = [*np.linspace(0.0, 10.0, 30), *[10.0] * 40, *np.linspace(10.0, 0.0, 30)]
    found = followed(profile)
    assert found is not None
    assert 9.0 < found[1] <= 10.0


@pytest.mark.parametrize(
    "profile",
    [[2.5] * 200, [0.0, *[20.0] * int(LEAST_DURATION_S / 0.01 / 2), *[0.0] * 50], [10.0] * 300],
    ids=["too weak", "a knock", "never let go"],
)
def test_what_is_no_push_is_not_taken_for_one(profile) -> None:
    """Nothing comes of it."""
    assert followed(profile) is None


def test_after_a_knock_a_push_still_counts() -> None:
    """The follower begins anew."""
    push = [*[9.0] * 40, *[0.0] * 20]
    found = followed([*[30.0] * 5, *[0.0] * 20, *push])
    assert found is not None
    assert found[1] == pytest.approx(9.0)


def test_a_twist_is_measured_by_its_moment() -> None:
    """0.3 N m for a while."""
    found = followed([*[0.3] * 40, *[0.0] * 20], by="twist")
    assert found is not None
    assert found[5] == pytest.approx(0.3)
