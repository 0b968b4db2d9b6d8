"""Limits over time or at a wall: joint speeds, planes; and the ceilings."""

import math
from collections import deque

import numpy as np
import pinocchio as pin
import pytest

from common.config.load import cell_from_tree, dump_cell
from common.motion.limits import ArmBounds, JointTrack, Limits
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
