"""The arm's geometry: the vendor's numbers, the two readers of one model file, the inverse."""

import math

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from common.config.arm import model_file
from common.motion.frames import GRAVITY_M_S2, Oat, R_from_oat, rotation_between
from common.motion.kinematics import ArmKinematics
from sim.robot.engine import mujoco

ARM = ArmKinematics("rs007l")
MODEL = model_file("rs007l")
HOME = np.radians([0.0, 0.0, -90.0, 0.0, -90.0, 0.0])

# Joints [deg], flange [mm], O A T [deg]; derived from the vendor's description of the RS007L.
# At A = 0 and A = 180 only O + T and O - T count, which the rotation matrix takes care of.
ACCEPTANCE = [
    ((0, 0, 0, 0, 0, 0), (0, 0, 1008), (0, 0, 0)),
    ((0, 90, 0, 0, 0, 0), (0, 1008, 0), (90, 90, -90)),
    ((0, 90, 90, 0, 0, 0), (0, 455, 553), (0, 0, 0)),
    ((0, 0, -90, 0, -90, 0), (0, 475, 377), (180, 180, 0)),
    ((90, 0, -90, 0, -90, 0), (475, 0, 377), (90, 180, 0)),
    ((0, 0, -90, 0, -80, 0), (0, 488.545, 378.185), (90, 170, -90)),
    ((0, 0, -90, 0, -100, 0), (0, 461.455, 378.185), (-90, 170, 90)),
    ((0, 45, -90, 0, -45, 0), (0, 657.609, -92.142), (180, 180, 0)),
    ((10, 20, -30, 40, -50, 60), (64.163, 585.066, 730.048), (109.520, 92.084, -0.480)),
    ((-35, 25, -70, 15, -60, 120), (-415.050, 562.271, 302.572), (152.796, 151.272, 62.441)),
]

joints = hnp.arrays(float, 6, elements=st.floats(-0.9, 0.9)).map(
    lambda share: np.where(share > 0, share * ARM.upper_rad, -share * ARM.lower_rad)
)


@pytest.mark.parametrize(("joints_deg", "flange_mm", "oat_deg"), ACCEPTANCE)
def test_flange_stands_at_the_pose_of_the_vendor(joints_deg, flange_mm, oat_deg):
    """Forward kinematics gives the controller's pose, to the last digit of the reference."""
    T = ARM.flange_pose(np.radians(joints_deg))
    assert T.translation * 1e3 == pytest.approx(flange_mm, abs=1e-3)
    R = R_from_oat(Oat(*np.radians(np.array(oat_deg, dtype=float))))
    assert np.degrees(np.linalg.norm(rotation_between(R, T.rotation))) < 1e-3


@given(joints)
@settings(max_examples=40, deadline=None)
def test_pinocchio_and_mujoco_read_the_same_robot(q):
    """Pose, mass matrix and gravity torque agree, so one file describes the robot for both."""
    model = mujoco.MjModel.from_xml_path(str(MODEL))
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_forward(model, data)
    twin = ARM.model.copy()
    twin.gravity = pin.Motion(np.array([0.0, 0.0, -GRAVITY_M_S2]), np.zeros(3))
    twin_data = twin.createData()
    T = ARM.flange_pose(q)
    assert T.translation == pytest.approx(data.site("flange").xpos, abs=1e-12)
    assert T.rotation.ravel() == pytest.approx(data.site("flange").xmat, abs=1e-12)
    mass = np.zeros((6, 6))
    mujoco.mj_fullM(model, data, mass)
    upper = np.triu(pin.crba(twin, twin_data, q))
    assert upper == pytest.approx(np.triu(mass), abs=1e-9)
    gravity = pin.computeGeneralizedGravity(twin, twin_data, q)
    assert gravity == pytest.approx(data.qfrc_bias, abs=1e-9)
    assert data.qfrc_gravcomp == pytest.approx(data.qfrc_bias, abs=1e-9)


def test_gravity_torque_of_the_stretched_arm_is_that_of_the_mass_table():
    """Arm held out level: the table's 94.2, -24.5, -0.2 Nm about joints 2, 3, 5, plus link 6.

    The table leaves out link 6, 0.05 kg (0.49 N) at 1.005, 0.55 and 0.075 m from those joints.
    """
    data = ARM.model.createData()
    q = np.radians([0.0, 90.0, 0.0, 0.0, 0.0, 0.0])
    torque = -pin.computeGeneralizedGravity(ARM.model, data, q)
    assert torque[[1, 2, 4]] == pytest.approx([94.2 + 0.49, -24.5 - 0.27, -0.2 - 0.04], abs=0.06)


@given(joints, hnp.arrays(float, 6, elements=st.floats(-0.1, 0.1)))
@settings(max_examples=200, deadline=None)
def test_inverse_kinematics_undoes_forward_kinematics(q, offset):
    """A solution stands at the pose asked for, within the limits; otherwise it gives the reason."""
    goal = ARM.flange_pose(q)
    result = ARM.solve(goal, q + offset, jump_rad=1.0)
    if result.q is None:
        assert result.reason
        return
    assert pin.log6(ARM.flange_pose(result.q).actInv(goal)).vector == pytest.approx(0, abs=1e-7)
    assert not ARM.limit_violation(result.q)


def test_a_pose_out_of_reach_is_refused_with_both_lengths():
    """The reason names the distance and the arm's length."""
    T = ARM.flange_pose(HOME)
    far = ARM.solve(pin.SE3(T.rotation, np.array([0.0, 1.2, 0.3])), HOME, jump_rad=1.0)
    assert far.q is None
    assert "out of reach" in far.reason
    assert "930 mm" in far.reason


def test_a_pose_beyond_a_joint_limit_is_refused_with_the_limit():
    """Turning joint 1 by more than half a turn is refused, and the reason names the joint."""
    q = np.radians([179.0, 0.0, -90.0, 0.0, -90.0, 0.0])
    beyond = q + np.radians([2.0, 0, 0, 0, 0, 0])
    result = ARM.solve(ARM.flange_pose(beyond), q, jump_rad=1.0)
    assert result.q is None
    assert "joint 1" in result.reason
    assert "180 deg" in result.reason


def test_a_jump_of_the_wrist_is_refused():
    """At joint 5 = 0 a turn across the wrist's axes needs a quarter turn at once: refused."""
    q = np.array([0.0, 0.3, -1.0, 0.0, 0.0, 0.0])
    T = ARM.flange_pose(q)
    across = pin.SE3(T.rotation @ pin.exp3(np.array([0.0, 1e-3, 0.0])), T.translation)
    result = ARM.solve(across, q, jump_rad=0.35)
    assert result.q is None
    assert "jump" in result.reason or "singular" in result.reason


def test_a_pose_that_is_not_finite_is_refused():
    """NaN in, a reason out, no exception."""
    T = ARM.flange_pose(HOME)
    T.translation = np.array([0.0, math.nan, 0.3])
    assert "not finite" in ARM.solve(T, HOME, jump_rad=1.0).reason
