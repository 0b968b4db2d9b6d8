"""The regulator's part of the skills: hand guiding, a path across the tool's axis, presets."""

from functools import partial
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.motion.convert import vec3
from forcemesh import topics
from forcemesh.messages import ZERO3, Preset
from forcemesh.requests import ForceStartRequest, GainsRequest, PathRequest
from services.regulator import admittance
from services.regulator.admittance import AdmittanceSettings
from services.regulator.gains import PiGains
from services.regulator.law import start_at
from services.regulator.tcp_path import advance, path_along
from tests.fakes.arbiter_world import T_START
from tests.fakes.bench import CELL
from tests.fakes.law_input import mode_input
from tests.fakes.regulator_bench import PERIOD_S, T_FLANGE_TCP, FollowingBench
from tuning.gain_rule import LOOP_GAINS, tune

DOWN = (T_START * T_FLANGE_TCP).rotation[:, 2]
SETTINGS, GAINS = AdmittanceSettings.of(CELL), PiGains.of(tune(CELL).gains)
PRESS = ForceStartRequest(mode="position", setpoint_N=5.0, axes=(False, False, True) * 2)
coordinates = st.floats(-0.05, 0.05).map(lambda x: round(x, 4))
points = st.lists(st.tuples(*[coordinates] * 3).map(np.array), min_size=1, max_size=6)


# --- hand guiding ---------------------------------------------------------------------------------


def guided(force_N, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the travel and the last speed under a force of each period, in base axes."""
    law, memory = start_at(T_START), admittance.begin(T_START, T_START, None, SETTINGS)
    before = T_START.translation
    for number in range(round(seconds / PERIOD_S)):
        force = vec3(np.array(force_N(number * PERIOD_S)))
        sample = mode_input(force, ZERO3, 0.0, "position", PERIOD_S, GAINS, law, law.T_base_tcp)
        before = law.T_base_tcp.translation
        memory, law = admittance.step(memory, sample, SETTINGS)
    speed = (law.T_base_tcp.translation - before) / PERIOD_S
    return law.T_base_tcp.translation - T_START.translation, speed


@settings(max_examples=8)
@given(st.tuples(*[st.floats(-1.0, 1.0)] * 3), st.floats(0.0, 1.0))
def test_a_residual_force_never_moves_a_tool_without_a_hand(direction, share) -> None:
    """With the largest bias that the preflight accepts nothing moves; after a push it stops."""
    length = max(float(np.linalg.norm(direction)), 1e-9)
    bias_N = np.array(direction) / length * CELL.force.idle_max_N * share * 0.999
    assert np.linalg.norm(guided(lambda _: bias_N, 0.5)[0]) < 1e-12
    after_push = guided(
        lambda t: bias_N + (20.0 if t < 0.2 else 0.0) * np.array(direction) / length, 4.0
    )
    assert np.linalg.norm(after_push[1]) < 1e-4


def test_it_yields_more_to_a_hand_than_the_gain_rule_and_never_too_fast() -> None:
    """At 10 N several times the plain law's speed; at 100 N the cell's speed limit."""
    _, speed = guided(lambda _: (0.0, 10.0, 0.0), 1.0)
    assert speed[1] > 3.0 * tune(CELL).force_i_m_per_Ns * 10.0 or speed[1] >= 0.99 * SPEED
    _, fastest = guided(lambda _: (60.0, 80.0, 0.0), 1.0)
    assert np.linalg.norm(fastest) == pytest.approx(SPEED, rel=1e-6)
    assert fastest[1] / fastest[0] == pytest.approx(80.0 / 60.0, rel=1e-6)


SPEED = CELL.force.speed_max_m_s


@pytest.mark.parametrize("stiffness_N_m", [2e3, 2e4])
def test_a_contact_stiffer_than_a_hand_is_damped_at_once(stiffness_N_m: float) -> None:
    """Pushed with 10 N into a wall through the loop's delay: it comes to rest without bouncing."""
    late = round((CELL.loop_delay_s - CELL.filter.lowpass_s) / PERIOD_S)
    law, memory = start_at(T_START), admittance.begin(T_START, T_START, None, SETTINGS)
    places = [T_START.copy()] * (late + 1)
    forces = []
    for number in range(800):
        deep_m = max(0.0, float(T_START.translation[2] - 0.002 - places[0].translation[2]))
        forces.append(stiffness_N_m * deep_m)
        force_N = (0.0, 0.0, forces[-1] - (10.0 if number < 600 else 0.0))
        sample = mode_input(force_N, ZERO3, 0.0, "position", PERIOD_S, GAINS, law, places[0])
        memory, law = admittance.step(memory, sample, SETTINGS)
        places = [*places[1:], law.T_base_tcp]
    resting = np.array(forces[400:600])
    assert resting.std() < 0.5
    assert resting.mean() == pytest.approx(10.0, abs=SETTINGS.plain.deadband_N + 0.5)


def test_guiding_is_requested_by_its_law_and_changes_without_a_step() -> None:
    """From guiding to pressing and back while after_push: no step beyond one period's limit."""
    bench = FollowingBench()
    guide = ForceStartRequest(mode="both", law="admittance")
    for request in (guide, PRESS, guide, ForceStartRequest(mode="orientation", law="adaptive")):
        bench.push((3.0, -25.0, 12.0), (0.3, 0.0, -0.4))
        assert bench.start(request).accepted
        bench.pass_s(0.3)
    assert max(bench.steps_m) <= SPEED * PERIOD_S * (1 + 1e-6)
    assert max(bench.steps_m) > 0.9 * SPEED * PERIOD_S
    refused = bench.start(ForceStartRequest(mode="position", law="admittance", setpoint_N=5.0))
    assert (refused.accepted, refused.code) == (False, "setpoint")
    refused = bench.start(ForceStartRequest(mode="position", law="admittance", host="controller"))
    assert (refused.accepted, refused.code) == (False, "host")


def test_the_reply_to_a_start_names_the_defaults_of_the_cell_file() -> None:
    """The reply has law and host, and the requested preset."""
    bench = FollowingBench()
    law = bench.cell.force.law
    assert bench.start(PRESS).text.endswith(f"N, law {law}, on the PC")
    request = PRESS.replaced(law="adaptive", preset="gentle")
    assert bench.start(request).text.endswith("N, law adaptive with preset gentle, on the PC")


# --- a path ---------------------------------------------------------------------------------------


@settings(max_examples=20)
@given(points, st.floats(0.005, 0.2), st.floats(0.1, 2.0))
def test_a_path_visits_its_points_across_the_axis_within_its_speed(
    direction, speed_m_s, accel_m_s2
) -> None:
    """Each point is passed within a period's travel, without motion along the axis."""
    R = pin.exp3(np.array([-np.arcsin(0.6), 0.0, 0.0]))
    axis, p = R[:, 2], np.zeros(3)
    route = path_along(
        tuple(direction), speed_m_s=speed_m_s, accel_m_s2=accel_m_s2, in_contact=False
    )
    rest, visited, speeds = np.zeros(3), [p], [0.0]
    left_m = route.report(pin.SE3(R, p))["path_left_m"]
    expected_s = left_m / speed_m_s + len(direction) * speed_m_s / accel_m_s2 + 1.0
    for _ in range(round(3.0 * expected_s / PERIOD_S)):
        route, shift = advance(route, p, axis, dt_s=PERIOD_S, pushed_m=rest, most_m=1.0)
        p = p + shift
        visited.append(p)
        speeds.append(route.now_m_s)
        assert np.linalg.norm(shift) <= route.now_m_s * PERIOD_S * (1 + 1e-9)
        assert abs(float(shift @ axis)) < 1e-12
    assert not route.points
    assert max(speeds) <= speed_m_s * (1 + 1e-9)
    rises = [b - a for a, b in pairwise(speeds)]
    assert max(rises) <= accel_m_s2 * PERIOD_S * (1 + 1e-9)
    for point in direction:
        across = np.array(visited) - point
        across -= np.outer(across @ axis, axis)
        assert np.linalg.norm(across, axis=1).min() < max(1e-5, speed_m_s * PERIOD_S)


@given(st.tuples(*[st.floats(-1.0, 1.0)] * 3), st.floats(0.0, 1.0))
def test_force_and_path_together_are_within_the_speed_limit(direction, share) -> None:
    """The path takes the rest of the period's motion that the force leaves."""
    pushed_m = 2e-4 * share * np.array(direction) / max(1.0, float(np.linalg.norm(direction)))
    axis = np.array([0.0, 0.0, 1.0])
    route = path_along(
        (np.array([0.1, 0.0, 0.0]),), speed_m_s=0.2, accel_m_s2=100.0, in_contact=False
    )
    _, shift = advance(route, np.zeros(3), axis, dt_s=PERIOD_S, pushed_m=pushed_m, most_m=2e-4)
    assert np.linalg.norm(pushed_m + shift) <= 2e-4 * (1 + 1e-9)


def test_a_path_of_points_ends_at_the_present_height_and_orientation() -> None:
    """Without pending points it ends where the tool is."""
    T = pin.SE3(pin.exp3(np.array([0.3, 0.0, 0.0])), np.array([0.1, 0.5, 0.2]))
    path_to = partial(path_along, speed_m_s=0.02, accel_m_s2=1.0, in_contact=False)
    end = path_to((np.zeros(3), np.array([0.2, 0.4, 0.9]))).end(T)
    assert end.rotation == pytest.approx(T.rotation)
    assert T.actInv(end).translation[2] == pytest.approx(0.0, abs=1e-12)
    assert T.actInv(end).translation[:2] == pytest.approx(
        (T.rotation.T @ (np.array([0.2, 0.4, 0.9]) - T.translation))[:2]
    )
    assert path_to(()).end(T) is T


def test_a_pressed_tool_follows_points_and_stops_where_contact_ends() -> None:
    """It reports the remaining path, waits without contact, and stops on request."""
    bench = FollowingBench()
    request_of_path = PathRequest(points_m=((0.1, 0.1, 0.0),))
    assert bench.ask(topics.FORCE_PATH, request_of_path).code == "not_armed"
    bench.push((0.0, 0.0, 5.0))
    bench.start(PRESS)
    bench.pass_s(0.1)
    start = bench.p_tcp_m
    ahead = tuple(tuple(start + np.array([x, 0.0, 0.3])) for x in (0.01, 0.02))
    assert bench.ask(topics.FORCE_PATH, PathRequest(points_m=ahead, speed_m_s=0.04)).accepted
    bench.pass_s(0.2)
    halfway = bench.p_tcp_m
    assert 0.002 < halfway[0] - start[0] < 0.01
    assert bench.published().path_left_m == pytest.approx(0.02 - (halfway - start)[0], abs=1e-4)
    bench.push()
    bench.pass_s(0.2)
    stopped_at = bench.p_tcp_m
    bench.pass_s(0.2)
    assert bench.p_tcp_m[:2] == pytest.approx(stopped_at[:2], abs=1e-9)
    bench.push((0.0, 0.0, 5.0))
    bench.pass_s(1.0)
    assert bench.p_tcp_m[:2] == pytest.approx((start + np.array([0.02, 0.0, 0.0]))[:2], abs=1e-6)
    assert bench.published().path_left_m == 0.0
    more = PathRequest(points_m=(tuple(start),), append=True)
    assert bench.ask(topics.FORCE_PATH, more).accepted
    bench.pass_s(0.3)
    assert bench.ask(topics.FORCE_PATH, PathRequest()).accepted
    bench.pass_s(0.1)
    stopped_at = bench.p_tcp_m
    bench.pass_s(0.3)
    assert bench.p_tcp_m == pytest.approx(stopped_at, abs=1e-9)
    fast = bench.ask(topics.FORCE_PATH, PathRequest(points_m=ahead, speed_m_s=0.2))
    assert (fast.code, fast.limit) == ("setpoint", SPEED)


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"law": "plain"}, "ok"),
        ({"frame": "base"}, "ok"),
        ({"frame": "base", "axes": (False, True, True) * 2}, "axes"),
        ({"frame": "tool"}, "ok"),
        ({"frame": "tool", "axes": (True, False, True) * 2}, "axes"),
        ({"mode": "orientation"}, "ok"),
    ],
)
def test_the_adaptive_law_follows_points_only_across_its_press_axis(changes, code) -> None:
    """Its prediction uses its own commands: other motion would count as a push."""
    bench = FollowingBench()
    bench.push((0.0, 0.0, 5.0))
    bench.start(PRESS.replaced(**({"law": "adaptive"} | changes)))
    bench.pass_s(0.1)
    ahead = tuple(bench.p_tcp_m + np.array([0.01, 0.01, 0.0]))
    assert bench.ask(topics.FORCE_PATH, PathRequest(points_m=(ahead,))).code == code
    assert bench.ask(topics.FORCE_PATH, PathRequest()).accepted  # a stop is always allowed


# --- presets --------------------------------------------------------------------------------------


@pytest.mark.parametrize("preset", LOOP_GAINS)
def test_a_preset_is_a_loop_gain_limited_by_inertia(preset: Preset) -> None:
    """The loop gain is the preset's, or the gain is the inertia's; single gains take precedence."""
    bench = FollowingBench()
    reply = bench.ask(topics.GAINS, GainsRequest(preset=preset, force_i_m_per_Ns=(0.0, 0.0, 1e-6)))
    assert reply.gains is not None
    assert reply.gains.force_i_m_per_Ns == (0.0, 0.0, 1e-6)
    assert reply.gains.torque_i_rad_per_Nms == tune(CELL, preset).gains.torque_i_rad_per_Nms
    tuned, contact = tune(CELL, preset), CELL.contact
    loop = tuned.force_i_m_per_Ns * contact.stiffness_N_m * tuned.tau_s
    cap = 0.5 / (contact.inertia_kg * CELL.robot.bandwidth_rad_s)
    assert loop == pytest.approx(LOOP_GAINS[preset]) or tuned.force_i_m_per_Ns == cap
    assert bench.start(ForceStartRequest(mode="position", preset=preset)).accepted
    after = bench.ask(topics.GAINS, GainsRequest()).gains
    assert after == tuned.gains


@settings(max_examples=10)
@given(st.lists(st.sampled_from(sorted(LOOP_GAINS)), min_size=2, max_size=5))
def test_a_preset_changed_in_operation_makes_no_step_beyond_one_periods_limit(changes) -> None:
    """On the bus under a large force every command is within the limit; the speed has no step."""
    bench = FollowingBench()
    bench.push((0.0, 8.0, 20.0))
    bench.start()
    bench.pass_s(0.2)
    before = len(bench.steps_m)
    for preset in changes:
        assert bench.ask(topics.GAINS, GainsRequest(preset=preset)).accepted
        bench.pass_s(0.08)
    steps = np.array(bench.steps_m[before - 1 :])
    assert steps.max() <= SPEED * PERIOD_S * (1 + 1e-6)
    widest = max(LOOP_GAINS.values()) - min(LOOP_GAINS.values())
    largest = steps.max() * widest / min(LOOP_GAINS.values()) * PERIOD_S / 0.1
    assert np.abs(np.diff(steps)).max() <= 2.0 * largest
