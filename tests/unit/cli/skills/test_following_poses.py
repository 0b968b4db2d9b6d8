"""Paths of poses and repeated touches, on a whole cell in virtual time."""

import json
from functools import partial

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cli.skills import pressing
from cli.skills.contact_monitor import ContactSample, no_progress
from cli.skills.following import PathParameters, Standstill
from cli.skills.following_poses import follow_poses
from cli.skills.path_file import write_poses
from cli.skills.touch_repeats import TouchStatistics, touch_often
from forcemesh.errors import DataError, NotReachedError
from tests.fakes.bench import CELL
from tests.fakes.verb_calls import call_verb
from tests.unit.cli.skills.test_verbs import GAP_MM, SkillCell, start_request

HERE = PathParameters(0.02, from_here=True)


@pytest.fixture
def cell() -> SkillCell:
    """The demo's cell."""
    return SkillCell()


def square(cell: SkillCell, side_m: float = 0.01) -> list[pin.SE3]:
    """Return poses of the tool along two sides of a square; it turns by 3 degrees."""
    T, turn = cell.world.arm.T_base_tcp, pin.utils.rotate("z", np.radians(3.0))
    corners = ((0.0, 0.0, 0.0), (side_m, 0.0, 0.0), (side_m, side_m, 0.0))
    poses = [pin.SE3(T.rotation, T.translation + np.array(corner)) for corner in corners]
    return [*poses[:2], pin.SE3(turn @ T.rotation, poses[2].translation)]


def follow(cell: SkillCell, poses, parameters=HERE):
    """Follow poses with 8 N."""
    return follow_poses(cell.client, poses, parameters, start_request(8.0), within_s=20.0)


def test_the_tool_follows_a_blended_corner_and_turns_with_it(cell: SkillCell) -> None:
    """The end is that of the last pose across the force, and nothing is missed.

    The length of a given direction of the force does not count.
    """
    poses, direction = square(cell), (0.0, 0.0, -2.0)
    parameters = PathParameters(0.02, from_here=True, blend_m=0.003, direction=direction)
    done = follow(cell, poses, parameters)
    T = cell.world.arm.T_base_tcp
    assert T.translation[:2] == pytest.approx(poses[-1].translation[:2], abs=3e-4)
    assert pin.log3(T.rotation.T @ poses[-1].rotation) == pytest.approx(np.zeros(3), abs=5e-3)
    assert done.length_mm == pytest.approx(20.0)
    assert done.mean_error_N < 0.5
    assert (done.contacts_lost, done.missed_mm) == (0, pytest.approx(0.0, abs=1.0))
    assert "contact kept" in done.text()


def test_wrong_paths_are_refused_before_anything_moves(cell: SkillCell) -> None:
    """Each with the pose, the value and the limit."""
    first, second, _ = square(cell)
    tipped = pin.SE3(pin.utils.rotate("x", 0.5) @ first.rotation, first.translation)
    upside = pin.SE3(pin.utils.rotate("x", np.pi) @ first.rotation, second.translation)
    far = pin.SE3(first.rotation, first.translation + np.array([5.0, 0.0, 0.0]))
    aside = pin.SE3(first.rotation, first.translation + np.array([0.05, 0.0, 0.0]))
    start, at_tool = cell.p_tcp(), PathParameters(0.02)
    zero = PathParameters(0.02, direction=(0.0, 0.0, 0.0))
    for poses, parameters, problem in (
        ([tipped, second], HERE, "the first pose is turned by 29 degrees from the tool"),
        ([aside, second], at_tool, "the path starts 50 mm away from the tool"),
        ([first, far], at_tool, "pose 2 of the path: TCP x = .* outside"),
        ([first], at_tool, "the path has no length"),
        ([first, upside], at_tool, "pose 2 of the path: turned by 180 degrees .* at most 92"),
        ([first, second], zero, "direction .* has no length"),
    ):
        with pytest.raises(DataError, match=problem):
            follow(cell, poses, parameters)
    cell.world.advance(0.1)
    assert cell.p_tcp() == pytest.approx(start, abs=1e-4)


def sample(t_s: float, left_m: float | None, contact: str = "contact") -> ContactSample:
    """Return a sample of a path."""
    zero = np.zeros(3)
    return ContactSample(t_s, 8.0, zero, zero, pin.SE3.Identity(), contact, left_m, None)


def test_a_path_that_stands_still_too_long_ends_with_its_cause() -> None:
    """A path that moves a little never does; the time counts from its last motion."""
    still = Standstill(2.0)
    still.check(sample(0.0, None))
    for t_s in range(10):
        still.check(sample(float(t_s), 0.01 - 1e-5 * t_s))
    still.check(sample(11.0, 0.01 - 9e-5))
    with pytest.raises(NotReachedError, match=r"stood still for 2 s, 9\.9 mm .*: a limit keeps"):
        still.check(sample(11.1, 0.01 - 9e-5))
    with pytest.raises(NotReachedError, match="no contact"):
        still.check(sample(11.1, 0.01 - 9e-5, "approach"))


def test_the_verb_follows_poses_and_reports_what_was_missed(cell, monkeypatch, tmp_path) -> None:
    """As an object; the options of poses are refused for points."""
    path = tmp_path / "poses.csv"
    write_poses(path, [0.0, 1.0], square(cell, 0.004)[:2])
    words = ("follow", str(path), "--force", "8", "--from-here")
    done = call_verb(monkeypatch, cell.client, no_progress, *words, "--poses", "tcp", "--json")
    assert done.exit_code == 0
    found = json.loads(done.stdout)
    assert found["length_mm"] == pytest.approx(4.0, abs=0.01)
    assert {"missed_mm", "worst_press_N", "mean_error_N", "peak_error_N"} <= set(found)
    wrong = call_verb(monkeypatch, cell.client, no_progress, *words, "--blend", "3")
    assert wrong.exit_code == 2
    assert "--blend, --direction and --go-on need --poses" in wrong.stderr


places = st.lists(st.tuples(*[st.floats(-500.0, 500.0)] * 3), min_size=2, max_size=12)


def approach(cell: SkillCell, retract_m: float) -> partial[pressing.TouchResult]:
    """Return the touch that is repeated."""
    return partial(pressing.touch, cell.client, force_N=5.0, search_m=None, retract_m=retract_m)


@given(places, st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda d: np.linalg.norm(d) > 0.1))
def test_mean_and_deviation_are_those_of_the_places(found, direction) -> None:
    """Per axis with n - 1 in the denominator; along the axis that of the projections."""
    axis = np.array(direction) / np.linalg.norm(direction)
    touches = [pressing.TouchResult(place, 1.0, 2.0) for place in found]
    result = TouchStatistics.of(touches, axis)
    for index in range(3):
        column = [place[index] for place in found]
        mean = sum(column) / len(column)
        variance = sum((each - mean) ** 2 for each in column) / (len(column) - 1)
        assert result.mean_mm[index] == pytest.approx(mean, abs=1e-6)
        assert result.std_mm[index] == pytest.approx(variance**0.5, abs=1e-6)
    first, covariance = np.array(found[0]), np.cov(np.array(found).T)
    assert result.along_std_mm**2 == pytest.approx(axis @ covariance @ axis, rel=1e-6, abs=1e-4)
    assert result.along_mean_mm == pytest.approx(
        (np.array(result.mean_mm) - first) @ axis, abs=1e-6
    )


def test_touches_of_a_rigid_plate_repeat_within_a_tenth_of_a_millimetre(cell: SkillCell) -> None:
    """Each approach starts in free space, and the arm ends retracted."""
    start = cell.p_tcp()
    shown: list[pressing.TouchResult] = []
    result = touch_often(cell.client, approach(cell, 0.003), 3, retract_m=0.003, found=shown.append)
    assert list(result.touches) == shown
    assert len(shown) == 3
    assert result.mean_mm == pytest.approx(1e3 * start - [0.0, 0.0, GAP_MM], abs=0.3)
    assert max(*result.std_mm, result.along_std_mm) < 0.1
    assert abs(result.along_mean_mm) < 0.1
    travels = [found.travel_mm for found in shown]
    assert travels == pytest.approx([GAP_MM, 3.0, 3.0], abs=0.4)
    assert cell.client.contact.wait("free", within_s=1.0).valid
    assert max(found.peak_N for found in shown) < CELL.force.touch_N + CELL.force.approach_budget_N
