"""Path files: round trip, thinning, and errors of one sentence."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cli.skills.path_file import read_points, read_poses, thinned, write_poses
from common.motion.frames import pose, rotation_between, rotation_from_vector
from forcemesh.errors import DataError

small = st.floats(-1.0, 1.0)
poses = st.builds(
    lambda p, r: pose(np.array(p), rotation_from_vector(np.array(r))),
    st.tuples(small, small, small),
    st.tuples(small, small, small),
)


@settings(max_examples=30)
@given(st.lists(poses, min_size=1, max_size=8))
def test_poses_come_back_to_a_micrometre_and_a_millidegree(tmp_path_factory, recorded) -> None:
    """Files hold millimetres and degrees; reading gives metres and rotations."""
    path = tmp_path_factory.mktemp("paths") / "path.csv"
    write_poses(path, [0.02 * n for n in range(len(recorded))], recorded)
    back = read_poses(path)
    for there, here in zip(recorded, back, strict=True):
        assert np.linalg.norm(there.translation - here.translation) < 1e-6
        assert np.linalg.norm(rotation_between(there.rotation, here.rotation)) < 2e-5
    points = read_points(path)
    assert points[0] == pytest.approx(recorded[0].translation, abs=1e-6)


@settings(max_examples=30)
@given(st.lists(poses, min_size=2, max_size=25), st.floats(1e-4, 0.5))
def test_a_thinned_path_keeps_its_ends_and_stays_near_every_pose(recorded, tolerance_m) -> None:
    """Each omitted pose is within the tolerance of a straight segment of the kept ones."""
    kept = thinned(recorded, tolerance_m)
    assert kept[0] is recorded[0]
    assert kept[-1] is recorded[-1]
    at = [next(n for n, T in enumerate(recorded) if T is chosen) for chosen in kept]
    assert at == sorted(at)
    for first, last in pairwise(at):
        a, b = recorded[first].translation, recorded[last].translation
        for pose_between in recorded[first:last]:
            share = np.linspace(0.0, 1.0, 400)[:, None]
            off = np.linalg.norm(a + share * (b - a) - pose_between.translation, axis=1).min()
            assert off <= tolerance_m + np.linalg.norm(b - a) / 399


ANGLES = "x_mm,y_mm,z_mm,o_deg,a_deg,t_deg"


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "no column x_mm, y_mm, z_mm"),
        ("x_mm,y_mm\n1,2\n", "no column z_mm; found x_mm, y_mm"),
        ("x_mm,y_mm,z_mm\n", "no rows"),
        ("x_mm,y_mm,z_mm\n1,2\n", "row 2: not 3 numbers"),
        ("x_mm,y_mm,z_mm\n1,2,3\n1,two,3\n", "row 3: not 3 numbers"),
        ("x_mm,y_mm,z_mm\n1,2,nan\n", "row 2: a number is not finite"),
        (f"{ANGLES}\n1,2,3,0,-720.01,0\n", "row 2: a_deg is .*, the limit is 720 degrees"),
        ("\udcff", "not UTF-8 text"),
    ],
)
def test_an_error_in_a_file_is_reported_with_its_name(tmp_path: Path, text, problem) -> None:
    """One sentence gives the file, the row and the cause."""
    path = tmp_path / "path.csv"
    path.write_text(text, errors="surrogateescape")
    with pytest.raises(DataError, match=problem) as caught:
        (read_poses if text.startswith(ANGLES) else read_points)(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
    with pytest.raises(DataError, match="cannot be read: No such file"):
        read_points(tmp_path / "none.csv")
    with pytest.raises(DataError, match="cannot be written"):
        write_poses(tmp_path, [0.0], [pose((0.0, 0.0, 0.0), np.eye(3))])
