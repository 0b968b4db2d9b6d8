"""Contact events: the table of states, drawn jobs of forces and poses, and their figures."""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import get_args

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.config.load import load_cell
from common.motion.convert import vec3
from control.law import Contact
from forcemesh import topics
from forcemesh.codec import decode
from forcemesh.messages import TOUCHING, ContactEvent, ContactState
from forcemesh.requests import Empty, ForceStartRequest
from services.regulator.contact_events import (
    IMPACT_S,
    LOST_S,
    SLIDE_STEADY_S,
    SLIDES_M_S,
    SPEED_WINDOW_S,
    TABLE,
    ContactInput,
    ContactSettings,
    ContactTracker,
    Happening,
)
from services.regulator.service import Regulator
from tests.fakes.arbiter_world import T_START
from tests.fakes.bench import CELL, DEMO
from tests.fakes.regulator_bench import T_FLANGE_TCP, RegulatorBench

PERIOD_NS = 4_000_000
DOWN = (0.0, 0.0, -1.0)


@dataclass(frozen=True)
class Phase:
    """A time of constant force and speed."""

    seconds: float
    up_N: float = 0.0  # force of the plane on the tool
    speed_m_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    law: Contact | None = None


class ContactRun:
    """A tracker and the samples that it has taken."""

    def __init__(self, noise_N: float = 0.0, noise_m: float = 0.0, seed: int = 0) -> None:
        """Start in the pose of the arm at rest."""
        self.tracker = ContactTracker(CELL)
        self.noise_N, self.noise_m = noise_N, noise_m
        self.random = np.random.default_rng(seed)
        self.T = T_START * T_FLANGE_TCP
        self.at_ns = 1_000_000_000
        self.sizes: list[tuple[int, float]] = []  # stamp and size of each force
        self.events: list[ContactEvent] = []  # the first message of each change
        self.newest: dict[int, ContactEvent] = {}  # by number

    def play(self, phases: Iterable[Phase]) -> list[str]:
        """Take the samples of phases; return the states so far."""
        for phase in phases:
            for _ in range(round(phase.seconds * 1e9 / PERIOD_NS)):
                self.step(phase)
        return [event.state for event in self.events]

    def step(self, phase: Phase) -> None:
        """Take one sample."""
        self.at_ns += PERIOD_NS
        shift = np.array(phase.speed_m_s) * PERIOD_NS / 1e9
        self.T = pin.SE3(self.T.rotation, self.T.translation + shift)
        place = self.T.translation + self.random.uniform(-1, 1, 3) * self.noise_m
        x, y, z = self.random.normal((0.0, 0.0, phase.up_N), self.noise_N)
        self.sizes.append((self.at_ns, float(np.hypot(np.hypot(x, y), z))))
        self.tracker.observe(
            ContactInput(
                at_ns=self.at_ns,
                posed_ns=self.at_ns,
                force_N=(float(x), float(y), float(z)),
                torque_Nm=(0.0, 0.0, 0.0),
                T_base_tcp=pin.SE3(self.T.rotation, place),
                law=phase.law,
                press_axis=DOWN if phase.law else (0.0, 0.0, 0.0),
            )
        )
        event = self.tracker.event
        if event.number and event.number not in self.newest:
            self.events.append(event)
        self.newest[event.number] = event


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
    """What touches ends in lost at a release, any other state by a touch, each in unknown."""
    assert set(TABLE) == set(get_args(ContactState))
    used = {happening for row in TABLE.values() for happening in row}
    assert used == set(get_args(Happening))
    assert {after for row in TABLE.values() for after in row.values()} == set(TABLE)
    for state, row in TABLE.items():
        assert state not in row.values()
        assert ("release" in row) == (state in TOUCHING) == (row.get("release") == "lost")
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
    assert SLIDE_STEADY_S < (sliding.since_ns - began_ns) / 1e9 < LATE_S
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


def test_the_window_of_the_speed_is_three_reports_on_a_slow_link() -> None:
    """With fewer a single rounded pose would slide."""
    slow = load_cell(DEMO, {"rates.robot_hz": 25.0, "rates.status_hz": 10.0})
    assert ContactSettings.of(slow).window_ns == pytest.approx(3e9 / 25.0)


TOUCH, AIR = Phase(0.02, 8.0, law="contact"), Phase(0.05, law="approach")
CREEP = Phase(1.0, 10.0, (0.8 * SLIDES_M_S, 0.0, 0.0), "contact")


@pytest.mark.parametrize(
    ("job", "states"),
    [
        (
            (SEARCH, TOUCH, AIR, TOUCH, AIR, PRESS),
            "approach impact lost impact lost impact contact",
        ),
        ((SEARCH, PRESS, SEARCH), "approach impact contact lost approach"),
        ((SEARCH, PRESS, CREEP), "approach impact contact"),
    ],
    ids=["a bounce is an impact", "a search after a loss", "a law that creeps does not slide"],
)
def test_states_of_a_job(job: list[Phase], states: str) -> None:
    """In the order of their changes."""
    assert ContactRun().play(job) == states.split()


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


def test_a_wrench_of_another_clock_begins_anew() -> None:
    """A duration across two clocks would be wrong, even negative."""
    run = ContactRun()
    run.play([SEARCH, PRESS])
    run.at_ns -= 800_000_000
    run.play([Phase(0.1, 10.0, law="contact")])
    found = run.events[-1]
    assert (found.state, found.before, found.before_s) == ("contact", "unknown", 0.0)
    assert run.tracker.event.duration_s == pytest.approx(0.1 - PERIOD_NS / 1e9)


# --- on the bus ---------------------------------------------------------------------------------

START = ForceStartRequest(mode="position", setpoint_N=5.0)
PERIOD_S = 1.0 / CELL.rates.status_hz


class ContactBench(RegulatorBench):
    """The regulator with every contact event that it has published."""

    def __init__(self) -> None:
        """Start armed, free of contact."""
        super().__init__()
        self.tap = self.client.tap(topics.CONTACT, 10_000)

    def taken(self) -> list[ContactEvent]:
        """Return the messages since the last call."""
        found = []
        while (data := self.tap.take()) is not None:
            found.append(decode(data, ContactEvent)[1])
        return found

    def states(self) -> list[str]:
        """Return the state of each message since the last call, repeated ones once."""
        return list({event.number: event.state for event in self.taken()}.values())


@pytest.fixture
def bench() -> ContactBench:
    """A regulator that has received its inputs."""
    bench = ContactBench()
    bench.pass_s(0.5)
    return bench


def test_it_is_published_at_the_status_rate_with_its_duration(bench: ContactBench) -> None:
    """Without a change the same number, and a duration that grows."""
    bench.taken()
    bench.pass_s(1.0)
    events = bench.taken()
    assert len(events) == pytest.approx(CELL.rates.status_hz, abs=4)  # whole periods of a sample
    assert {(event.number, event.state, event.valid) for event in events} == {(1, "free", True)}
    durations = [event.duration_s for event in events]
    assert durations == sorted(durations)
    assert durations[-1] - durations[0] == pytest.approx(1.0, abs=2 * PERIOD_S)


def test_a_force_without_force_feedback_is_a_contact_too(bench: ContactBench) -> None:
    """A collision in an ordinary move; each change is published in its own step."""
    bench.taken()
    bench.push((0.0, 3.0 * ContactSettings.of(CELL).touch_N, 0.0))
    event = bench.after_step(topics.CONTACT)
    assert (event.state, event.before) == ("impact", "free")
    assert event.normal == pytest.approx((0.0, 1.0, 0.0))
    assert bench.states() == ["impact"]
    bench.pass_s(0.5)
    bench.push()
    bench.pass_s(0.5)
    assert bench.states() == ["impact", "contact", "lost", "free"]


def test_with_force_feedback_the_law_decides(bench: ContactBench) -> None:
    """A force below the limit without feedback is a contact for a law that presses."""
    assert bench.start(START).accepted
    bench.pass_s(0.2)
    bench.push((0.0, 0.0, 4.0))
    bench.pass_s(0.4)
    assert bench.states()[1:] == ["approach", "impact", "contact"]
    bench.push((0.0, 0.0, 0.2))
    bench.pass_s(0.05)
    assert bench.published().contact == "approach"
    assert bench.states() == ["lost"]
    bench.push((0.0, 0.0, 4.0))
    bench.pass_s(0.4)
    bench.ask(topics.FORCE_STOP, Empty())
    bench.pass_s(0.4)
    assert bench.states()[-1] == "contact"  # without feedback the force decides again


@pytest.mark.parametrize("key", ["wrench", "robot/state"])
def test_without_a_valid_input_the_state_is_unknown(bench: ContactBench, key: str) -> None:
    """As soon as it is stale, at the status rate; a contact that is found later is no impact."""
    bench.push((0.0, 0.0, 20.0))
    bench.pass_s(0.5)
    bench.taken()
    bench.silent.add(key)
    bench.pass_s(1.0)
    events = [event for event in bench.taken() if event.state == "unknown"]
    assert {event.valid for event in events} == {False}
    assert {event.code for event in events} == {"stale"}
    assert events[0].reason.startswith(f"{key} stale")
    assert len(events) == pytest.approx(CELL.rates.status_hz, abs=4)
    bench.silent.clear()
    bench.pass_s(0.1)
    event = bench.taken()[-1]
    assert (event.state, event.before, event.valid) == ("contact", "unknown", True)


def test_a_wrench_that_is_not_calibrated_is_no_input(bench: ContactBench) -> None:
    """What is left of the tool's weight would be one."""
    bench.push((0.0, 0.0, 20.0))
    bench.wrench = bench.wrench.replaced(calibrated=False, calibration_fault="residual 4 N")
    event = bench.after_step(topics.CONTACT)
    assert (event.state, event.valid, event.code) == ("unknown", False, "payload")
    assert event.reason == "residual 4 N"


def test_a_replay_continues_the_contact_of_before() -> None:
    """Number, state and time of the next message follow the last one."""
    last = ContactEvent(number=7, state="free", since_ns=3_000_000_000, duration_s=0.5, slid_m=0.1)
    bench = ContactBench()
    bench.service = Regulator(bench._bus("regulator"), CELL, contact=last)
    bench.clock.advance_ns(3_500_000_000 - bench.clock.now_ns())
    bench.pass_s(3 * PERIOD_S)
    events = bench.taken()
    assert {(event.number, event.state, event.slid_m) for event in events} == {(7, "free", 0.1)}
    assert events[0].duration_s == pytest.approx(0.5 + PERIOD_S, abs=0.005)


def test_without_inputs_the_state_is_unknown_from_the_last_sample_on() -> None:
    """The state ends there with its peak; a contact found again is no impact."""
    run = ContactRun()
    run.play([SEARCH, PRESS])
    last_ns = run.at_ns
    run.tracker.fail("stale", "wrench stale")
    unknown = run.tracker.event
    assert (unknown.state, unknown.valid, unknown.code) == ("unknown", False, "stale")
    assert (unknown.since_ns, unknown.before_peak_N) == (last_ns, pytest.approx(10.0))
    run.at_ns += 10**9
    run.play([Phase(0.1, 10.0, law="contact")])
    assert (run.events[-1].state, run.events[-1].before) == ("contact", "unknown")
