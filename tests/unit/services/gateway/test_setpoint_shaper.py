"""Set points as they leave for a slow controller: within the limits, smoothed, and never stuck."""

import random
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.config.load import load_cell
from common.motion.frames import rotation_between, rotation_from_vector
from forcemesh.faults import tripped
from services.gateway.setpoint_shaper import CatchUp, SetpointShaper
from tests.contract.rig import DEMO_CELL, shifted
from tests.fuzz.judges import CommandedPath

CELL = load_cell(DEMO_CELL)
LIMITS = CELL.limits
DOWN = pin.SE3(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.5, 0.3]))
MS = 1_000_000
Seen = tuple[int, pin.SE3]


def anywhere(_: pin.SE3) -> None:
    """Every place is a good one."""


def flowing(limits=LIMITS) -> SetpointShaper:
    """A stream that has begun at rest."""
    departures = SetpointShaper(limits, anywhere)
    assert departures.seed(DOWN, 0) is None
    assert departures.leave(DOWN, 0) is DOWN
    return departures


def away_m(a: pin.SE3, b: pin.SE3) -> float:
    """Distance of two poses."""
    return float(np.linalg.norm(a.translation - b.translation))


@given(st.integers(0, 2**32), st.floats(0.1, 20.0), st.booleans())
@settings(max_examples=60, deadline=None)
def test_whatever_is_wanted_what_leaves_keeps_the_limits(
    seed: int, factor: float, anew: bool
) -> None:
    """Any rhythm, ways, turns, waiting and new beginnings; the evil arbiter's judge looks on."""
    rng, departures, path, T, now_ns = random.Random(seed), flowing(), CommandedPath(CELL), DOWN, 0
    path.add(0.0, DOWN.translation, DOWN.rotation)
    last = DOWN
    for _ in range(300):
        now_ns += rng.choice((0, 1, 1, 4, 20, 60, 130)) * MS
        if anew and rng.random() < 0.1:
            T = shifted(last, x_m=rng.uniform(-0.01, 0.01))
            if departures.seed(T, now_ns) is not None:
                continue
        way_m = np.array([rng.gauss(0.0, factor * LIMITS.speed_m_s * 8e-3) for _ in range(3)])
        turn = np.array([rng.gauss(0.0, 0.02 * factor) for _ in range(3)])
        T = pin.SE3(rotation_from_vector(turn) @ T.rotation, T.translation + way_m)
        leaves = departures.leave(T, now_ns)
        if leaves is not None:
            last = leaves
            broken = path.add(now_ns * 1e-9, leaves.translation.copy(), leaves.rotation.copy())
            assert broken == []


@given(st.floats(0.001, 0.2), st.floats(0.0, 1.5), st.floats(0.05, 20.0), st.floats(0.01, 1.0))
@settings(max_examples=60, deadline=None)
def test_the_newest_set_point_is_always_reached(
    far_m: float, turn_rad: float, accel_m_s2: float, speed_m_s: float
) -> None:
    """However far it is and however low the limits: part by part, on a straight line."""
    update = {"accel_m_s2": accel_m_s2, "speed_m_s": speed_m_s}
    departures, now_ns = flowing(LIMITS.model_copy(update=update)), 0
    wanted = shifted(DOWN, x_m=far_m)
    wanted = pin.SE3(
        rotation_from_vector(np.array([0, 0, turn_rad])) @ DOWN.rotation, wanted.translation
    )
    left: list[pin.SE3] = []
    while not left or left[-1] is not wanted:
        now_ns += 4 * MS
        assert now_ns < 100_000 * MS
        leaves = departures.leave(wanted, now_ns)
        left += [] if leaves is None else [leaves]
    ways = [away_m(DOWN, T) for T in left]
    turns = [float(np.linalg.norm(rotation_between(DOWN.rotation, T.rotation))) for T in left]
    assert ways == sorted(ways)
    assert turns == pytest.approx([turn_rad * way / far_m for way in ways], abs=1e-6)
    assert all(away_m(DOWN, T) + away_m(T, wanted) == pytest.approx(far_m) for T in left)


@given(st.floats(0.01, 1.0), st.floats(0.02, 1.0), st.integers(15, 66), st.integers(0, 2**16))
@settings(max_examples=60, deadline=None)
def test_an_honest_stream_leaves_as_it_is_over_a_controller_of_15_to_65_hz(
    speed: float, accel: float, period_ms: int, seed: int
) -> None:
    """Any share of both limits, there and back, the controller up to 5 ms late.

    Near the speed limit 60 ms hold one set point more than the 60 before, now and then:
    then a part of its way waits for the next one.
    """
    departures, rng = flowing(), random.Random(seed)
    accel_m_s2, speed_m_s = accel * LIMITS.accel_m_s2, speed * LIMITS.speed_m_s
    x_m, v_m_s, towards, free_ms, last = 0.0, 0.0, 1.0, 0.0, DOWN
    for now_ms in range(0, 3000, 4):
        if abs(x_m) > 0.1:
            towards = -np.sign(x_m)
        v_m_s = float(np.clip(v_m_s + towards * accel_m_s2 * 4e-3, -speed_m_s, speed_m_s))
        x_m += v_m_s * 4e-3
        if now_ms >= free_ms:
            wanted = shifted(DOWN, x_m=x_m)
            leaves = departures.leave(wanted, now_ms * MS)
            assert leaves is wanted or speed > 0.85
            last = leaves or last
            assert away_m(last, wanted) <= 0.06 * speed_m_s
            free_ms = now_ms if leaves is None else now_ms + period_ms + rng.choice((0, 0, 0, 5))


def test_nothing_leaves_before_a_stream_begins_and_after_it_ends() -> None:
    """What has not left by then stays, also the rest of a way."""
    departures = SetpointShaper(LIMITS, anywhere)
    assert departures.leave(DOWN, 0) is None
    departures = flowing()
    far = shifted(DOWN, x_m=0.1)
    part = departures.leave(far, 4 * MS)
    assert part is not None
    assert part is not far
    departures.end()
    assert all(departures.leave(far, at_ms * MS) is None for at_ms in range(8, 1000, 4))


def test_a_stream_begins_where_the_arm_is_or_not_at_all() -> None:
    """Its first set point is the measured pose itself; after another motion any pose will do."""
    departures, far = flowing(), shifted(DOWN, x_m=0.1)
    trip = departures.seed(far, 4 * MS)
    assert trip is not None
    assert trip.code == "acceleration"
    departures.moved_otherwise()
    assert departures.seed(far, 4 * MS) is None
    assert departures.leave(far, 4 * MS) is far


def test_a_part_of_a_way_that_lies_where_none_may_be_waits() -> None:
    """Both ends are good places; what is between them was never judged."""
    departures = SetpointShaper(LIMITS, lambda _: tripped("workspace", "not there"))
    departures.seed(DOWN, 0)
    departures.leave(DOWN, 0)
    assert departures.leave(shifted(DOWN, x_m=0.1), 4 * MS) is None
    near = shifted(DOWN, x_m=0.005)
    assert departures.leave(near, 8 * MS) is near


def test_what_waited_behind_a_stall_leaves_slowly_and_the_stream_then_runs_on() -> None:
    """A stream of 50 mm/s with a departure that is 60 ms late: 10 mm/s for what waited, no more."""
    departures = SetpointShaper(LIMITS, anywhere, CatchUp(speed_m_s=0.01, late_s=0.045))
    assert departures.seed(DOWN, 0) is None
    assert departures.leave(DOWN, 0) is DOWN
    times_ms = [30, 60, 120, *range(150, 1500, 30)]
    left = [(0, DOWN)]
    for now_ms in times_ms:
        leaves = departures.leave(shifted(DOWN, x_m=-5e-5 * now_ms), now_ms * MS)
        assert leaves is not None
        left.append((now_ms, leaves))
    speeds_m_s = [
        away_m(b, a) / (later - earlier) * 1e3 for (earlier, a), (later, b) in pairwise(left)
    ]
    assert speeds_m_s[2] <= 0.01 + 1e-9  # right after the stall
    assert away_m(left[-1][1], shifted(DOWN, x_m=-5e-5 * times_ms[-1])) < 1e-9
