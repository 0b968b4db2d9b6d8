"""Limits over time or at a wall: joint speeds, planes; and the ceilings."""

import math
from collections import deque

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from common.config.load import cell_from_tree, dump_cell
from common.motion.limits import ArmBounds, JointTrack, Limits, check_workspace
from forcemesh.errors import ConfigError
from forcemesh.messages import Trip
from tests.fakes.arbiter_world import CELL, pose_at

LIMITS = Limits.of(CELL)
CENTRE = (LIMITS.workspace_min_m + LIMITS.workspace_max_m) / 2.0
JOINT_WINDOW_S, JOINT_WINDOW_NS = 0.1, 100_000_000  # as docs/arbitration.md has it


# --- windows --------------------------------------------------------------------------------------


def check_joint_speed(speed_rad_s: np.ndarray | list[float]) -> Trip | None:
    """Check an arm that is within all limits but that of its joint speeds."""
    bounds = ArmBounds(LIMITS, pin.SE3.Identity(), pose_at(CENTRE))
    track = JointTrack(deque([(0, np.zeros(6)), (10**9, tuple(speed_rad_s))]))
    return bounds.measured(pose_at(CENTRE), np.zeros(6), track)


@pytest.mark.parametrize("period_ms", [4, 20, 25, 70, 200])
def test_a_joint_s_speed_is_from_the_last_sample_that_is_a_tenth_of_a_second_old(
    period_ms: int,
) -> None:
    """Also where it jumps at once; before there is such a sample no speed is known."""
    back = -(-100 // period_ms)  # samples
    for known in range(1, 3 * back):
        track, stamp_ns = JointTrack(), 10**9
        for number in range(known + 1):
            stamp_ns = 10**9 + number * period_ms * 1_000_000
            assert (track.speed_rad_s is not None) == (number > back)
            track.add(stamp_ns, np.full(6, 0.5 + (number == known)))
        speed = track.speed_rad_s
        if known < back:
            assert speed is None
        else:
            assert speed == pytest.approx(np.full(6, 1e3 / (back * period_ms)))


def test_a_joint_s_speed_is_known_after_a_tenth_of_a_second_to_the_nanosecond() -> None:
    """A shorter time would make more of rounding and jitter."""
    track = JointTrack()
    track.add(10**9, np.zeros(6))
    track.add(10**9 + JOINT_WINDOW_NS - 1, np.ones(6))
    assert track.speed_rad_s is None
    track.add(10**9 + JOINT_WINDOW_NS, np.ones(6))
    assert track.speed_rad_s == pytest.approx(np.full(6, 10.0))


@settings(max_examples=40)
@given(
    joint=st.integers(0, 5),
    share=st.floats(-2.0, 2.0),
    repeats=st.lists(st.integers(1, 3), min_size=60, max_size=60),
)
def test_joint_speed_is_right_though_samples_repeat(joint, share, repeats) -> None:
    """Each sample is published one to three times: the mean is off by those periods alone."""
    track, stamp_ns, speed = JointTrack(), 10**9, share * LIMITS.joint_speed_rad_s[joint]
    speeds = []
    for count in repeats:
        q = np.zeros(6)
        q[joint] = speed * stamp_ns * 1e-9
        for _ in range(count):
            track.add(stamp_ns, q)
            stamp_ns += 4_000_000
            speeds.append(track.speed_rad_s)
    known = [found[joint] for found in speeds if found is not None]
    assert len(known) >= len(speeds) - 0.1 / 0.004 - 2
    doubt = 2 * 0.004 / JOINT_WINDOW_S + 0.001
    assert all(abs(found - speed) <= abs(speed) * doubt + 1e-9 for found in known)
    tripped = [check_joint_speed(found) for found in speeds if found is not None]
    if abs(share) * (1.0 + doubt) < 1.0:
        assert not any(tripped)
    if abs(share) * (1.0 - doubt) > 1.0:
        assert all(trip is not None and trip.code == "joint_speed" for trip in tripped)
        assert all(trip is not None and f"joint {joint + 1} " in trip.text for trip in tripped)


def test_a_sample_that_is_published_again_with_its_stamp_changes_nothing() -> None:
    """Nor does an older one: time never goes back."""
    track = JointTrack()
    for stamp_ns, angle_rad in ((10**9, 0.0), (2 * 10**9, 1.0), (2 * 10**9, 9.0), (10**9 + 1, 9.0)):
        track.add(stamp_ns, np.full(6, angle_rad))
    assert track.speed_rad_s == pytest.approx(np.ones(6))


@pytest.mark.parametrize("joint", range(6))
def test_each_joint_has_its_speed(joint: int) -> None:
    """Swept about the limit, both signs; not finite is a trip, too."""
    fastest = LIMITS.joint_speed_rad_s[joint]
    for speed in (fastest, -fastest, 1.001 * fastest, -1.001 * fastest, math.nan):
        speeds = np.zeros(6)
        speeds[joint] = speed
        trip = check_joint_speed(speeds)
        assert (trip is None) == (abs(speed) <= fastest)
        if trip is not None:
            assert trip.code == ("joint_speed" if math.isfinite(speed) else "not_finite")


# --- planes ---------------------------------------------------------------------------------------


def with_plane(point_m, normal) -> Limits:
    """Return the demo cell's limits and a wall."""
    tree = CELL.model_dump(mode="json")
    tree["limits"]["planes"] = [{"point_m": list(point_m), "normal": list(normal)}]
    return Limits.of(cell_from_tree(tree, "x.yaml"))


@given(
    st.floats(-0.2, 0.2),
    hnp.arrays(float, 3, elements=st.floats(-3.0, 3.0)).filter(lambda n: np.linalg.norm(n) > 0.1),
    hnp.arrays(float, 3, elements=st.floats(-0.15, 0.15)),
)
def test_the_tool_stays_on_the_side_that_the_normal_points_to(offset_m, normal, p) -> None:
    """Anywhere in the box, for any wall; the normal's length does not matter."""
    centre = (LIMITS.workspace_min_m + LIMITS.workspace_max_m) / 2.0
    unit = normal / np.linalg.norm(normal)
    limits = with_plane(centre + offset_m * unit, normal)
    before_m = float(p @ unit) - offset_m
    trip = check_workspace(limits, pose_at(centre + p, np.zeros(3)))

    if abs(before_m) > 1e-9:
        assert (trip is None) == (before_m > 0.0)
    if trip is not None:
        assert (trip.code, trip.limit) == ("workspace", 0.0)
        assert trip.value == pytest.approx(before_m, abs=1e-12)
        assert "plane 1" in trip.text


def test_a_plane_without_a_normal_is_a_mistake() -> None:
    """Reported when the cell file is read, with its place."""
    with pytest.raises(ConfigError, match=r"limits\.planes\.0: the normal has length zero"):
        with_plane((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


# --- ceilings -------------------------------------------------------------------------------------

CEILINGS = {
    "limits.step_m": 0.2,
    "limits.step_deg": 90.0,
    "limits.speed_m_s": 2.0,
    "limits.speed_deg_s": 360.0,
    "limits.accel_m_s2": 20.0,
    "limits.accel_deg_s2": 5000.0,
    "limits.tether_m": 5.0,
    "limits.force_N": 1000.0,
    "limits.torque_Nm": 100.0,
    "limits.joint_speed_share": 1.0,
    "force.speed_max_m_s": 0.25,
    "force.speed_max_rad_s": 2.0,
    "force.approach_m_s": 0.25,
    "force.retreat_m": 0.002,
    "force.retreat_m_s": 0.01,
}


@pytest.mark.parametrize("path", CEILINGS)
def test_no_cell_file_gets_above_the_ceilings_of_the_code(path: str) -> None:
    """Swept: the ceiling itself loads, the next number does not, and the mistake names it."""
    section, name = path.split(".")
    tree = CELL.model_dump(mode="json")
    tree["sensor"] |= {"force_range_N": 4000.0, "torque_range_Nm": 400.0}  # saturates beyond them
    tree[section][name] = CEILINGS[path]
    assert dump_cell(cell_from_tree(tree, "x.yaml"))
    tree[section][name] = math.nextafter(CEILINGS[path], math.inf)
    with pytest.raises(ConfigError, match=rf"{section}\.{name}: must be at most"):
        cell_from_tree(tree, "x.yaml")
