"""Contact events: the table of states, drawn jobs of forces and poses, and their figures."""

import math
from itertools import pairwise
from typing import get_args

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.motion.convert import vec3
from forcemesh.messages import TOUCHING, ContactState
from services.regulator.contact_events import (
    IMPACT_S,
    LOST_S,
    SLIDE_STEADY_S,
    SLIDES_M_S,
    SPEED_WINDOW_S,
    TABLE,
    ContactInput,
    ContactSettings,
    Happening,
)
from tests.fakes.bench import CELL, cell_with
from tests.fakes.contact_samples import PERIOD_NS, ContactRun, Phase

LIMITS = ContactSettings.of(CELL)
FREE_STATES = ("free", "approach", "lost", "unknown")
LATE_S = SLIDE_STEADY_S + SPEED_WINDOW_S  # a change of speed shows in the mean over the window
SEARCH, PRESS = Phase(0.5, law="approach"), Phase(0.6, 10.0, law="contact")

phases = st.builds(
    Phase,
    seconds=st.floats(0.004, 0.6),
    up_N=st.one_of(st.just(0.0), st.floats(-30.0, 30.0)),
    speed_m_s=st.tuples(*[st.sampled_from([0.0, 0.0, 0.001, 0.02])] * 2, st.just(0.0)),
    law=st.sampled_from([None, None, "approach", "contact"]),
)


# --- table ----------------------------------------------------------------------------------------


def test_the_table_has_every_state_and_every_happening() -> None:
    """Each state of the message, and each happening, which leads from some state to another."""
    assert set(TABLE) == set(get_args(ContactState))
    used = {happening for row in TABLE.values() for happening in row}
    assert used == set(get_args(Happening))
    for state, row in TABLE.items():
        assert state not in row.values()
        assert set(row.values()) <= set(TABLE)


def test_every_state_is_reached_from_every_other() -> None:
    """There is no state without a way out, and none without a way in."""
    for first in TABLE:
        reached = {first}
        for _ in TABLE:
            reached |= {after for state in reached for after in TABLE[state].values()}
        assert reached == set(TABLE)


def test_what_touches_loses_and_without_inputs_nothing_is_known() -> None:
    """A touching state ends in lost at a release, any other in unknown at a failure."""
    for state, row in TABLE.items():
        assert ("release" in row) == (state in TOUCHING)
        assert row.get("release", "lost") == "lost"
        assert ("touch" in row) == (state not in TOUCHING)
        assert ("fail" in row) == (state != "unknown")


# --- drawn jobs -----------------------------------------------------------------------------------


@settings(max_examples=60)
@given(st.lists(phases, min_size=1, max_size=8), st.integers(0, 2**32 - 1))
def test_changes_follow_the_table_and_times_add_up(job: list[Phase], seed: int) -> None:
    """No state is skipped, each lasts until the next one, its peak is the largest of its span."""
    run = ContactRun(noise_N=0.1, noise_m=5e-6, seed=seed)
    run.play(job)
    for number, event in enumerate(run.events, 1):
        assert event.number == number
        assert event.state in TABLE[event.before].values()
    ends = [*(event.since_ns for event in run.events[1:]), run.at_ns + 1]
    for before, after in pairwise(run.events):
        assert after.before == before.state
        assert after.before_s == pytest.approx((after.since_ns - before.since_ns) / 1e9)
        assert after.before_peak_N == run.newest[before.number].peak_N
        assert after.slid_m >= before.slid_m or after.state == "impact"
    for event, end_ns in zip(run.events, ends, strict=True):
        span = [size for at_ns, size in run.sizes if event.since_ns <= at_ns < end_ns]
        peak_N = max(span) if event.state in TOUCHING else 0.0
        assert run.newest[event.number].peak_N == pytest.approx(peak_N)


@settings(max_examples=40)
@given(st.floats(-30.0, 30.0), st.floats(0.0, 0.01), st.booleans(), st.integers(0, 2**32 - 1))
def test_the_noise_of_sensor_and_pose_causes_no_chatter(
    up_N: float, speed_m_s: float, is_in_contact: bool, seed: int
) -> None:
    """Any force and any speed that are constant cause at most one change of each kind."""
    run = ContactRun(noise_N=0.15, noise_m=1e-5, seed=seed)
    run.play([Phase(0.3, 20.0 if is_in_contact else 0.0)])
    before = len(run.events)
    states = run.play([Phase(2.0, up_N, (speed_m_s, 0.0, 0.0))])[before:]
    assert len(states) == len(set(states)) <= 3


# --- figures --------------------------------------------------------------------------------------


def test_a_job_with_force_feedback_has_each_state_once() -> None:
    """Approach, press, slide, rest, leave."""
    run = ContactRun()
    toward, along = (0.0, 0.0, -0.01), (0.02, 0.0, 0.0)
    states = run.play([
        Phase(0.1), Phase(0.5, 0.0, toward, "approach"), PRESS,
        Phase(1.0, 10.0, along, "contact"), PRESS, Phase(0.5),
    ])  # fmt: skip
    assert states == ["free", "approach", "impact", "contact", "sliding", "contact", "lost", "free"]
    impact, contact, sliding, _, lost, free = run.events[2:]
    assert impact.impact_m_s == pytest.approx(0.01, rel=0.05)
    assert impact.normal == pytest.approx((0.0, 0.0, 1.0))
    assert impact.position_m == pytest.approx(run.T.translation - [0.02, 0.0, 0.0], abs=1e-9)
    assert contact.before_s == pytest.approx(IMPACT_S)
    began_ns = impact.since_ns + round(0.6e9)
    assert 0.0 < (sliding.since_ns - began_ns) / 1e9 < LATE_S
    assert lost.slid_m == pytest.approx(0.02, abs=0.02 * LATE_S)
    assert free.before_s == pytest.approx(LOST_S)


def test_an_impact_ends_when_its_first_peak_is_passed() -> None:
    """Its peak force is that of the peak, whatever follows."""
    run = ContactRun()
    rise = [Phase(0.004, up_N, law="contact") for up_N in (4.0, 9.0, 14.0, 18.0, 17.0)]
    run.play([SEARCH, *rise])
    assert run.tracker.event.state == "impact"
    run.play([Phase(0.004, 16.0, law="contact"), Phase(0.3, 25.0, law="contact")])
    contact = run.events[-1]
    assert (contact.state, contact.before_peak_N) == ("contact", pytest.approx(18.0))
    assert contact.before_s == pytest.approx(5 * PERIOD_NS / 1e9)


def test_without_force_feedback_an_accelerated_tool_is_no_contact() -> None:
    """The limit is beyond the residual force and the inertia of the tool in a permitted motion."""
    below_N = CELL.force.idle_max_N + CELL.contact.inertia_kg * CELL.limits.accel_m_s2
    assert LIMITS.touch_N >= below_N
    run = ContactRun()
    assert run.play([Phase(0.5, 0.99 * LIMITS.touch_N)]) == ["free"]
    assert run.play([Phase(0.5, 1.01 * LIMITS.touch_N)]) == ["free", "impact", "contact"]
    assert run.play([Phase(0.5, 1.01 * LIMITS.release_N)]) == ["free", "impact", "contact"]
    assert run.play([Phase(0.5, 0.99 * LIMITS.release_N)])[3:] == ["lost", "free"]
    assert run.events[1].normal == (0.0, 0.0, 1.0)


def test_a_bounce_is_an_impact_of_its_own() -> None:
    """It needs no free motion in between, nor an approach."""
    touch, air = Phase(0.02, 8.0, law="contact"), Phase(0.05, law="approach")
    states = ContactRun().play([SEARCH, touch, air, touch, air, PRESS])
    bounces = ["impact", "lost"] * 2
    assert states == ["approach", *bounces, "impact", "contact"]


def test_a_search_after_a_lost_contact_is_an_approach() -> None:
    """Once it has been lost for a while."""
    assert ContactRun().play([SEARCH, PRESS, SEARCH])[3:] == ["lost", "approach"]


def test_a_turn_about_the_contact_does_not_slide() -> None:
    """The TCP moves on an arc around a contact beside it; without the torque it would slide."""
    for lever_m, expected in ((0.05, ["contact"]), (0.0, ["contact", "sliding"])):
        run = ContactRun()
        run.play([SEARCH, PRESS])
        T, force, beside = run.T, np.array([0.0, 0.0, 10.0]), np.array([0.05, 0.0, 0.0])
        contact = T.translation + beside
        for number in range(200):
            R = pin.exp3(np.array([0.0, 0.0, 0.002 * number]))
            run.at_ns += PERIOD_NS
            torque = vec3(np.cross(R @ [lever_m, 0.0, 0.0], force))
            place = pin.SE3(R @ T.rotation, contact - R @ beside)
            run.tracker.observe(ContactInput(
                run.at_ns, run.at_ns, (0.0, 0.0, 10.0), torque, place, "contact",
                (0.0, 0.0, -1.0),
            ))  # fmt: skip
            assert run.tracker.event.state in expected
        assert run.tracker.event.state == expected[-1]


def test_a_pose_that_comes_seldom_is_enough() -> None:
    """At 30 Hz the window holds three reports; a wrench without a new pose keeps the speed."""
    slow = cell_with(rates__robot_hz=25.0, rates__status_hz=10.0)
    assert ContactSettings.of(slow).window_ns == pytest.approx(3e9 / 25.0)
    run = ContactRun()
    run.play([SEARCH, PRESS])
    states = set()
    for number in range(250):
        run.at_ns += PERIOD_NS
        shift = [0.01 * 0.04 * (number // 10), 0.0, 0.0]
        T = pin.SE3(run.T.rotation, run.T.translation + shift)
        posed_ns = run.at_ns - PERIOD_NS * (number % 10)
        run.tracker.observe(ContactInput(
            run.at_ns, posed_ns, (0.0, 0.0, 10.0), (0.0,) * 3, T, "contact", (0.0, 0.0, -1.0)
        ))  # fmt: skip
        states.add(run.tracker.event.state)
    assert states == {"contact", "sliding"}
    assert run.tracker.event.slid_m == pytest.approx(0.01, abs=0.01 * (LATE_S + 0.04))


def test_without_inputs_the_state_is_unknown_from_the_last_sample_on() -> None:
    """The state ends there with its peak; a contact found again is no impact."""
    run = ContactRun()
    run.play([SEARCH, PRESS])
    last_ns = run.at_ns
    run.tracker.fail("stale", "wrench stale")
    unknown = run.tracker.event
    assert (unknown.state, unknown.valid, unknown.code) == ("unknown", False, "stale")
    assert (unknown.since_ns, unknown.before_peak_N) == (last_ns, pytest.approx(10.0))
    assert unknown.position_m == pytest.approx(run.T.translation)
    run.at_ns += 10**9
    run.play([Phase(0.1, 10.0, law="contact")])
    found = run.events[-1]
    assert (found.state, found.before, found.valid) == ("contact", "unknown", True)
    assert found.before_s == pytest.approx(1.0 + PERIOD_NS / 1e9)


def test_a_wrench_of_another_clock_begins_anew() -> None:
    """A duration across two clocks would be wrong, even negative."""
    run = ContactRun()
    run.play([SEARCH, PRESS])
    run.at_ns -= 800_000_000
    run.play([Phase(0.1, 10.0, law="contact")])
    found = run.events[-1]
    assert (found.state, found.before, found.before_s) == ("contact", "unknown", 0.0)
    assert run.tracker.event.duration_s == pytest.approx(0.1 - PERIOD_NS / 1e9)
    assert math.isfinite(run.tracker.event.slid_m)


def test_slow_motion_in_contact_is_no_sliding() -> None:
    """Below the limit the tool rests, for instance while a law creeps to its set point."""
    creep = Phase(1.0, 10.0, (0.8 * SLIDES_M_S, 0.0, 0.0), "contact")
    assert ContactRun().play([SEARCH, PRESS, creep])[-1] == "contact"
