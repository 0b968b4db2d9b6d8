"""Set points in joint space: identity far from singularities, within every joint's limits near."""

from math import radians

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from common.config.arm import read_arm
from common.config.load import load_cell
from common.motion.frames import Array, moved
from common.motion.joint_space import (
    JOINT_ACCEL_MARGIN,
    JOINT_MARGIN,
    JointSpace,
    checks_off_text,
)
from common.motion.rate_limiter import CommandedMotion, at_rest, limit_motion
from forcemesh.messages import Trip
from tests.fakes.bench import DEMO

DT_S = 0.004
SLACK = 1.02  # of one step of inverse kinematics, where it is not iterated


def space_of(file: str) -> JointSpace:
    """Return the joint space of a cell."""
    space = JointSpace.of(load_cell(DEMO.with_name(file)))
    assert space is not None
    return space


KAWASAKI, PANDA = space_of("demo.yaml"), space_of("panda.yaml")
SPACES = {"rs007l": KAWASAKI, "panda": PANDA}
HOME = {name: np.radians(read_arm(name).home_deg) for name in SPACES}
SINGULAR = {  # joint and angle [rad] at which an arm is singular
    "wrist": ("rs007l", 4, 0.0),
    "elbow": ("rs007l", 2, 0.0),
    "wrist of seven": ("panda", 5, 0.0),
    "elbow of seven": ("panda", 3, radians(-4.0)),
}
drawn = hnp.arrays(float, 3, elements=st.floats(-1.0, 1.0))
names = st.sampled_from(sorted(SPACES))


def stream(
    space: JointSpace, q: Array, v: Array, w: Array, *, time_s: float = 0.6
) -> tuple[list[Array], Trip | None, bool]:
    """Follow constant speeds of the flange, then rest; return angles, refusal, unchanged."""
    T_start = space.arm.flange_pose(q)
    joints, motion = space.begin(T_start, q), at_rest(T_start)
    assert joints is not None
    angles, is_same = [q], True
    for period in range(round(1.5 * time_s / DT_S)):
        target = moved(T_start, (tuple(v), tuple(w)), min(period * DT_S, time_s))
        proposed = limit_motion(space.limits, motion, target, DT_S)
        released = joints.follow(motion, proposed, DT_S)
        if isinstance(released, Trip):
            return angles, released, is_same
        is_same = is_same and released is proposed
        assert released is proposed or released.lags
        away = released.T_base_flange.actInv(space.arm.flange_pose(joints.q))
        assert np.linalg.norm(pin.log6(away).vector) < 1e-4, "the angles are those of the pose"
        motion = released
        angles.append(joints.q)
    return angles, None, is_same


def assert_within_limits(space: JointSpace, angles: list[Array]) -> None:
    """Compare angles, speeds and accelerations with the arm's limits and the stated margins."""
    speeds = np.diff([angles[0], *angles], axis=0) / DT_S
    accelerations = np.diff(speeds, axis=0) / DT_S
    limits = space.limits
    assert (np.abs(speeds) <= SLACK * JOINT_MARGIN * space.speed_rad_s).all()
    assert (np.abs(accelerations) <= SLACK * JOINT_ACCEL_MARGIN * space.accel_rad_s2).all()
    assert (np.array(angles) >= np.minimum(limits.joint_min_rad, angles[0]) - 1e-9).all()
    assert (np.array(angles) <= np.maximum(limits.joint_max_rad, angles[0]) + 1e-9).all()


@given(names, drawn, drawn)
def test_far_from_singularities_set_points_are_released_as_they_are(name, v, w) -> None:
    """Around home, at the speeds of force control: the same object, whatever the direction."""
    _, trip, is_same = stream(SPACES[name], HOME[name], 0.03 * v, 0.2 * w, time_s=0.3)
    assert trip is None
    assert is_same


@given(st.sampled_from(sorted(SINGULAR)), st.floats(-0.15, 0.15), drawn, drawn)
def test_near_singularities_no_joint_exceeds_its_limits(name, off_rad, v, w) -> None:
    """From any distance, in any direction, to 0.25 m/s and 1 rad/s: slowed, or refused."""
    arm, joint, angle = SINGULAR[name]
    space, q = SPACES[arm], HOME[arm].copy()
    q[joint] = np.clip(angle + off_rad, space.limits.joint_min_rad[joint], None)
    angles, trip, _ = stream(space, q, 0.14 * v, 0.5 * w)
    assert_within_limits(space, angles)
    assert trip is None or trip.code in {"joint", "joint_speed", "acceleration", "unreachable"}


def through_the_wrist(off_rad: float) -> tuple[list[Array], Trip | None, bool]:
    """Turn joint 5 of the Kawasaki from -10 through 0, with joint 4 a little off."""
    q = HOME["rs007l"].copy()
    q[4] = radians(-10.0)
    R = KAWASAKI.arm.flange_pose(q).rotation
    axis = R @ KAWASAKI.arm.jacobian(q)[3:, 4]
    q[3] = off_rad
    return stream(KAWASAKI, q, np.zeros(3), 0.3 * axis, time_s=1.2)


def test_a_pass_that_a_joint_cannot_follow_is_refused_with_the_joint_and_its_limit() -> None:
    """0.006 degrees beside the singularity, joint 4 would have to stop at once."""
    angles, trip, _ = through_the_wrist(1e-4)
    assert_within_limits(KAWASAKI, angles)
    assert trip is not None
    assert trip.code == "acceleration"
    assert trip.text.startswith("joint 4 would accelerate by ")
    assert trip.value is not None
    assert trip.limit is not None
    assert trip.limit == pytest.approx(JOINT_ACCEL_MARGIN * KAWASAKI.accel_rad_s2[3])
    assert trip.value > trip.limit


def test_a_joint_at_the_end_of_its_range_is_refused_with_its_number() -> None:
    """Joint 6 turns about the tool's axis until it would not rest within its range."""
    q = HOME["rs007l"].copy()
    q[5] = KAWASAKI.limits.joint_max_rad[5] - 0.05
    angles, trip, is_same = stream(KAWASAKI, q, np.zeros(3), np.array([0.0, 0.0, -0.3]))
    assert is_same
    assert angles[-1][5] <= KAWASAKI.limits.joint_max_rad[5]
    assert trip is not None
    assert (trip.code, trip.unit) == ("joint", "rad")
    assert trip.text.startswith("joint 6 = 360.")
    assert trip.limit == pytest.approx(radians(360.0))


def test_a_joint_beyond_its_range_may_return() -> None:
    """A stream that begins there moves back in, and is refused the other way."""
    q = HOME["rs007l"].copy()
    q[5] = KAWASAKI.limits.joint_max_rad[5] + 0.005
    _, trip, _ = stream(KAWASAKI, q, np.zeros(3), np.array([0.0, 0.0, 0.1]))
    assert trip is None
    _, trip, _ = stream(KAWASAKI, q, np.zeros(3), np.array([0.0, 0.0, -0.1]))
    assert trip is not None
    assert trip.code == "joint"


def test_a_stop_that_joints_cannot_make_is_refused() -> None:
    """Far from a singularity: the flange, against its own limits, reverses within a period."""
    q = HOME["rs007l"]
    T = KAWASAKI.arm.flange_pose(q)
    joints, motion = KAWASAKI.begin(T, q), at_rest(T)
    assert joints is not None
    for period in range(1, 40):
        target = moved(T, ((0.25, 0.0, 0.0), (0.0, 0.0, 0.0)), period * DT_S)
        found = joints.follow(motion, limit_motion(KAWASAKI.limits, motion, target, DT_S), DT_S)
        assert isinstance(found, CommandedMotion)
        motion = found
    back = ((-0.25, 0.0, 0.0), (0.0, 0.0, 0.0))
    T_back = moved(motion.T_base_flange, back, DT_S)
    trip = joints.follow(motion, CommandedMotion(T_back, T_back, back), DT_S)
    assert isinstance(trip, Trip)
    assert trip.code == "acceleration"
    assert trip.text.startswith("joint 1 would accelerate by ")


def test_no_time_changes_nothing_and_a_pause_ends_the_joints_speeds() -> None:
    """The clock of the set points stood still; after a pause the arm is at rest."""
    q = HOME["rs007l"]
    T = KAWASAKI.arm.flange_pose(q)
    joints = KAWASAKI.begin(T, q)
    assert joints is not None
    before = at_rest(T)
    after = limit_motion(KAWASAKI.limits, before, moved(T, ((0.1, 0, 0), (0, 0, 0)), DT_S), DT_S)
    assert joints.follow(before, after, 0.0) is after
    assert np.array_equal(joints.q, q)
    assert joints.follow(before, after, DT_S) is after
    assert np.abs(joints.speed_rad_s).max() > 0.0
    resting = at_rest(after.T_base_flange)
    assert joints.follow(resting, resting, DT_S) is resting
    assert np.abs(joints.speed_rad_s).max() < 1e-3


def test_an_arm_without_a_fitting_model_is_not_checked_and_the_reply_gives_the_reason() -> None:
    """No model, another number of joints, a pose that is not the model's."""
    q, T = HOME["rs007l"], KAWASAKI.arm.flange_pose(HOME["rs007l"])
    section = load_cell(DEMO).robot
    unknown = load_cell(DEMO).model_copy(
        update={"robot": section.model_copy(update={"model": "unknown"})}
    )
    assert JointSpace.of(unknown) is None
    off = "; joints are not checked ahead: "
    assert checks_off_text(None, T, q) == off + "robot.model is unknown"
    assert checks_off_text(KAWASAKI, T, q) == ""
    assert "7 joint angles, arms/rs007l has 6" in checks_off_text(KAWASAKI, T, HOME["panda"])
    shifted = pin.SE3(T.rotation, T.translation + np.array([0.01, 0.0, 0.0]))
    assert "10.0 mm and 0.0 degrees" in checks_off_text(KAWASAKI, shifted, q)
    assert KAWASAKI.begin(shifted, q) is None


@given(hnp.arrays(float, 3, elements=st.floats(-0.002, 0.002)))
def test_the_errors_of_a_real_arm_do_not_move_its_joints(error_m) -> None:
    """A pose a few millimetres beside the model's begins a stream at the measured angles."""
    q, T = HOME["rs007l"], KAWASAKI.arm.flange_pose(HOME["rs007l"])
    T_measured = pin.SE3(T.rotation, T.translation + error_m)
    joints = KAWASAKI.begin(T_measured, q)
    assert joints is not None
    resting = at_rest(T_measured)
    assert joints.follow(resting, resting, DT_S) is resting
    assert joints.q == pytest.approx(q, abs=1e-9)
