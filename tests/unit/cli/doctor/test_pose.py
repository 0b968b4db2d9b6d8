"""Pose check against the kinematics: correct poses pass despite rounding, mistakes are named."""

from functools import cache
from math import radians

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cli.doctor.checks import ReportLine
from cli.doctor.pose import check_pose
from cli.doctor.remedies import REMEDIES
from common.config.load import load_cell
from common.motion.frames import Oat, R_from_oat, oat_from_R
from common.motion.kinematics import ArmKinematics
from controller.packet_table import Scales
from tests.fakes.bench import DEMO

CELL = load_cell(DEMO.with_name("demo-tcp.yaml"))  # its sensor is rotated by 30 degrees
COARSE = Scales(position_per_mm=10, oat_per_deg=100, joint_per_deg=50)
Q = np.radians([20.0, 35.0, -80.0, 15.0, -70.0, 40.0])  # an arbitrary posture


@cache
def arm() -> ArmKinematics:
    """Return the model of the arm."""
    return ArmKinematics("rs007l")


def judge(T: pin.SE3, q: np.ndarray = Q, scales: Scales | None = None) -> ReportLine:
    """Return the line for a reported pose."""
    assert CELL.gateway is not None
    gateway = CELL.gateway.model_copy(update=(scales or Scales()).model_dump())
    cell = CELL.model_copy(update={"gateway": gateway})
    return check_pose(cell, T, tuple(q.tolist()), arm())


def moved(x: float = 0.0, y: float = 0.0, z: float = 0.0, o: float = 0.0) -> pin.SE3:
    """Return a frame from millimetres and degrees about z."""
    return pin.SE3(pin.exp3(np.array([0, 0, radians(o)])), np.array([x, y, z]) * 1e-3)


def through_packet(T: pin.SE3, scales: Scales) -> pin.SE3:
    """Return a pose after rounding in packet 101."""
    oat = np.round(np.degrees(oat_from_R(T.rotation)) * scales.oat_per_deg) / scales.oat_per_deg
    position_mm = np.round(T.translation * 1e3 * scales.position_per_mm) / scales.position_per_mm
    return pin.SE3(R_from_oat(Oat(*np.radians(oat))), position_mm * 1e-3)


joint_angles = st.tuples(
    *(st.floats(low, high) for low, high in zip(arm().lower_rad, arm().upper_rad, strict=True))
)


@given(joint_angles, st.sampled_from([Scales(), COARSE]))
@settings(max_examples=100)
def test_a_right_pose_passes_in_every_posture_and_scale(q: tuple, scales: Scales) -> None:
    """Pose and joints are rounded separately; the tolerance allows for it."""
    joints = np.array(q)
    reported = through_packet(arm().flange_pose(joints), scales)
    units = np.round(np.degrees(joints) * scales.joint_per_deg)
    q_reported = np.radians(units / scales.joint_per_deg)
    assert judge(reported, q_reported, scales).result == "PASS"


FLANGE = arm().flange_pose(Q)
MISTAKES = {
    "TCP": (FLANGE * CELL.tool.T_flange_tcp.pose, "cell file's TCP", "pose.TOOL"),
    "long tool": (FLANGE * moved(z=93.0), "TOOL (0.0, 0.0, 93.0", "pose.TOOL"),
    "turned tool": (FLANGE * moved(o=17.0), "along the flange's axis", "pose.TOOL"),
    "pedestal": (moved(z=360.0) * FLANGE, "BASE (0.0, 0.0, -360.0", "pose.BASE"),
    "turned base": (moved(o=17.0) * FLANGE, "at another height or rotated", "pose.BASE"),
    "any base": (moved(100.0, 50.0, 20.0) * FLANGE, "BASE (-100.0, -50.0, -20.0", "pose.unclear"),
    "scale": (pin.SE3(FLANGE.rotation, FLANGE.translation * 0.5), "scaled by 0.5", "pose.scale"),
    "half a millimetre": (moved(z=0.5) * FLANGE, "", "pose.small"),  # from no setting of a frame
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_of_frames_is_named(name: str) -> None:
    """The numbers are those of the pendant."""
    T, text, remedy = MISTAKES[name]
    line = judge(T)
    assert line.result == ("WARN" if remedy == "pose.small" else "FAIL")
    assert text in line.found
    assert line.remedy == REMEDIES[remedy]


@pytest.mark.parametrize("joint", range(6))
@pytest.mark.parametrize("kind", ["direction", "zero"])
def test_a_joint_that_differs_from_the_model_is_named(joint: int, kind: str) -> None:
    """A wrong direction, or a zero off by 90 degrees, is identified from the pose."""
    q = Q.copy()
    q[joint] = -q[joint] if kind == "direction" else q[joint] - np.pi / 2
    line = judge(arm().flange_pose(q))
    text = "the opposite sign" if kind == "direction" else "is -90 deg off the model's"
    assert f"joint {joint + 1}" in line.found
    assert text in line.found
    assert line.remedy == REMEDIES["pose.model"]
