"""Set points for a slow controller: within the limits, smoothed, and never stuck."""

import random
from itertools import pairwise
from math import inf

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.config.load import load_cell
from common.motion.frames import rotation_between, rotation_from_vector
from forcemesh.faults import tripped
from services.gateway.setpoint_shaper import CatchUp, SetpointShaper, Steps
from tests.contract.rig import DEMO_CELL, shifted
from tests.fuzz.judges import CommandedPath

CELL = load_cell(DEMO_CELL)
LIMITS = CELL.limits
DOWN = pin.SE3(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.5, 0.3]))
MS = 1_000_000


def accept_any(_: pin.SE3) -> None:
    """Accept every pose."""


def begun_shaper(limits=LIMITS, step: Steps = (inf, inf)) -> SetpointShaper:
    """Return a stream that has begun at rest."""
    shaper = SetpointShaper(limits, accept_any, step=step)
    assert shaper.seed(DOWN, 0) is None
    assert shaper.release(DOWN, 0) is DOWN
    return shaper


def distance_m(a: pin.SE3, b: pin.SE3) -> float:
    """Return the distance between two poses."""
    return float(np.linalg.norm(a.translation - b.translation))


@given(st.integers(0, 2**32), st.floats(0.1, 20.0), st.booleans())
@settings(max_examples=60, deadline=None)
def test_every_sent_set_point_keeps_the_limits(seed: int, factor: float, anew: bool) -> None:
    """Any rhythm, travel, rotation, pause and restart passes the checks of the hostile arbiter."""
    rng, shaper, path, T, now_ns = (
        random.Random(seed),
        begun_shaper(),
        CommandedPath(CELL),
        DOWN,
        0,
    )
    path.add(0.0, DOWN.translation, DOWN.rotation)
    last = DOWN
    for _ in range(300):
        now_ns += rng.choice((0, 1, 1, 4, 20, 60, 130)) * MS
        if anew and rng.random() < 0.1:
            T = shifted(last, x_m=rng.uniform(-0.01, 0.01))
            if shaper.seed(T, now_ns) is not None:
                continue
        travel_m = np.array([rng.gauss(0.0, factor * LIMITS.speed_m_s * 8e-3) for _ in range(3)])
        turn = np.array([rng.gauss(0.0, 0.02 * factor) for _ in range(3)])
        T = pin.SE3(rotation_from_vector(turn) @ T.rotation, T.translation + travel_m)
        sent = shaper.release(T, now_ns)
        if sent is not None:
            last = sent
            broken = path.add(now_ns * 1e-9, sent.translation.copy(), sent.rotation.copy())
            assert broken == []


@given(
    st.floats(0.001, 0.2), st.floats(0.0, 1.5), st.floats(0.05, 20.0), st.floats(0.01, 1.0),
    st.floats(1e-3, 2e-2),
)  # fmt: skip
@settings(max_examples=60, deadline=None)
def test_the_newest_set_point_is_always_reached(
    far_m: float, turn_rad: float, accel_m_s2: float, speed_m_s: float, step_m: float
) -> None:
    """Any distance is sent in steps on a straight line, also with low limits."""
    update = {"accel_m_s2": accel_m_s2, "speed_m_s": speed_m_s}
    steps = (step_m, 4.0 * step_m)
    shaper, now_ns = begun_shaper(LIMITS.model_copy(update=update), steps), 0
    target = shifted(DOWN, x_m=far_m)
    target = pin.SE3(
        rotation_from_vector(np.array([0, 0, turn_rad])) @ DOWN.rotation, target.translation
    )
    poses: list[pin.SE3] = []
    while not poses or poses[-1] is not target:
        now_ns += 4 * MS
        assert now_ns < 100_000 * MS
        sent = shaper.release(target, now_ns)
        poses += [] if sent is None else [sent]
    travels = [distance_m(DOWN, T) for T in poses]
    turns = [float(np.linalg.norm(rotation_between(DOWN.rotation, T.rotation))) for T in poses]
    assert travels == sorted(travels)
    for values, most in ((travels, steps[0]), (turns, steps[1])):
        assert max(after - before for before, after in pairwise([0.0, *values])) < most + 1e-6
    assert turns == pytest.approx([turn_rad * travel / far_m for travel in travels], abs=1e-6)
    assert all(distance_m(DOWN, T) + distance_m(T, target) == pytest.approx(far_m) for T in poses)


@given(st.floats(0.01, 1.0), st.floats(0.02, 1.0), st.integers(15, 66), st.integers(0, 2**16))
@settings(max_examples=60, deadline=None)
def test_a_stream_within_the_limits_is_sent_unchanged_at_15_to_65_hz(
    speed: float, accel: float, period_ms: int, seed: int
) -> None:
    """Any share of both limits, in both directions, with a controller up to 5 ms late.

    Near the speed limit 60 ms sometimes have one set point more than the 60 before;
    then a part of its travel waits for the next one.
    """
    shaper, rng = begun_shaper(), random.Random(seed)
    accel_m_s2, speed_m_s = accel * LIMITS.accel_m_s2, speed * LIMITS.speed_m_s
    x_m, v_m_s, towards, free_ms, last = 0.0, 0.0, 1.0, 0.0, DOWN
    for now_ms in range(0, 3000, 4):
        if abs(x_m) > 0.1:
            towards = -np.sign(x_m)
        v_m_s = float(np.clip(v_m_s + towards * accel_m_s2 * 4e-3, -speed_m_s, speed_m_s))
        x_m += v_m_s * 4e-3
        if now_ms >= free_ms:
            target = shifted(DOWN, x_m=x_m)
            sent = shaper.release(target, now_ms * MS)
            assert sent is target or speed > 0.85
            last = sent or last
            assert distance_m(last, target) <= 0.06 * speed_m_s
            free_ms = now_ms if sent is None else now_ms + period_ms + rng.choice((0, 0, 0, 5))


def test_nothing_is_sent_before_a_stream_begins_and_after_it_ends() -> None:
    """A pending set point stays unsent, also the rest of a split one."""
    shaper = SetpointShaper(LIMITS, accept_any)
    assert shaper.release(DOWN, 0) is None
    shaper = begun_shaper()
    far = shifted(DOWN, x_m=0.1)
    part = shaper.release(far, 4 * MS)
    assert part is not None
    assert part is not far
    shaper.end()
    assert all(shaper.release(far, at_ms * MS) is None for at_ms in range(8, 1000, 4))


def test_a_stream_begins_where_the_arm_is_or_not_at_all() -> None:
    """Its first set point is the measured pose; after another motion any pose is accepted."""
    shaper, far = begun_shaper(), shifted(DOWN, x_m=0.1)
    trip = shaper.seed(far, 4 * MS)
    assert trip is not None
    assert trip.code == "acceleration"
    shaper.moved_otherwise()
    assert shaper.seed(far, 4 * MS) is None
    assert shaper.release(far, 4 * MS) is far


def test_an_intermediate_pose_outside_the_workspace_is_not_sent() -> None:
    """Both ends are inside; the poses between them were never checked."""
    shaper = SetpointShaper(LIMITS, lambda _: tripped("workspace", "not there"))
    shaper.seed(DOWN, 0)
    shaper.release(DOWN, 0)
    assert shaper.release(shifted(DOWN, x_m=0.1), 4 * MS) is None
    near = shifted(DOWN, x_m=0.005)
    assert shaper.release(near, 8 * MS) is near


def test_a_backlog_after_a_stall_is_sent_slowly_and_the_stream_then_continues() -> None:
    """A stream of 50 mm/s is sent 60 ms late: the backlog is sent at 10 mm/s at most."""
    shaper = SetpointShaper(LIMITS, accept_any, CatchUp(speed_m_s=0.01, late_s=0.045))
    assert shaper.seed(DOWN, 0) is None
    assert shaper.release(DOWN, 0) is DOWN
    times_ms = [30, 60, 120, *range(150, 1500, 30)]
    sent = [(0, DOWN)]
    for now_ms in times_ms:
        pose = shaper.release(shifted(DOWN, x_m=-5e-5 * now_ms), now_ms * MS)
        assert pose is not None
        sent.append((now_ms, pose))
    speeds_m_s = [
        distance_m(b, a) / (later - earlier) * 1e3 for (earlier, a), (later, b) in pairwise(sent)
    ]
    assert speeds_m_s[2] <= 0.01 + 1e-9  # right after the stall
    assert distance_m(sent[-1][1], shifted(DOWN, x_m=-5e-5 * times_ms[-1])) < 1e-9


@pytest.mark.parametrize(("robot_hz", "late_s"), [(125.0, 0.045), (50.0, 0.05), (40.0, 0.0625)])
def test_a_stall_is_longer_than_the_reports_are_apart(robot_hz: float, late_s: float) -> None:
    """Two and a half of the periods of a slow controller, or the largest delay of a set point."""
    slow = load_cell(DEMO_CELL, {"robot.delay_s": 0.0, "rates.robot_hz": robot_hz})
    assert CatchUp.of(slow).late_s == pytest.approx(late_s)


def test_a_pause_within_the_delay_of_the_controller_is_no_stall() -> None:
    """Segments that are slower than the reports are its pace: a set point of 80 ms goes whole."""
    slow = load_cell(DEMO_CELL, {"robot.delay_s": 0.12})
    for cell, share in ((CELL, 0.5), (slow, 1.0)):
        shaper, now_ns, T = SetpointShaper(LIMITS, accept_any, CatchUp.of(cell)), 0, DOWN
        sent: pin.SE3 | None = None
        assert shaper.seed(DOWN, 0) is None
        for _ in range(5):
            now_ns += 80 * MS
            T = shifted(T, z_m=0.002)
            sent = shaper.release(T, now_ns)
        assert sent is not None
        assert (sent is T) == (share == 1.0)
