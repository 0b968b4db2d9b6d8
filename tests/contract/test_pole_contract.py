"""Orientations at which O, A, T are not unique: A = 180 (tool down) and A = 0 (tool up).

There O and T alone have no meaning, and half a degree off they may have any value: an interpolation
or comparison of O and T would spin the tool. No effect may be visible on the bus.
"""

import numpy as np
import pinocchio as pin
import pytest

from common.motion.convert import record_of
from common.motion.frames import oat_from_R, rotate_about_base_axes, rotation_between
from forcemesh.messages import Gains, Speed
from tests.contract.rig import Rig, goal, pose_goal

# Joint angles [deg] at which the tool points exactly down, and exactly up.
AT_POLE_DEG = {180: (0.0, 0.0, -90.0, 0.0, -90.0, 0.0), 0: (0.0, 20.0, -90.0, 0.0, 110.0, 0.0)}
TILT_RAD = 0.03
PARTS = 5  # of the path from pole to pole
AXES = {"x": (1.0, 0.0, 0.0), "slanted": (0.6, -0.8, 0.0)}


def at_pole(rig: Rig, a_deg: int) -> pin.SE3:
    """Bring the tool exactly to a pole; return the flange there."""
    rig.arm()
    begin, end = np.array(rig.joint_rad), np.radians(AT_POLE_DEG[a_deg])
    if not np.allclose(begin, end, atol=np.radians(0.01)):
        speed = Speed(mechanical_m_s=rig.cell.limits.speed_m_s)
        # The tool turns by more than limits.tether_deg in all: armed again on the way. The fake
        # controller jumps, and a jump must not be taken for a joint that is too fast.
        for number, q in enumerate(np.linspace(begin, end, PARTS + 1)[1:], start=1):
            target = goal(number, "joints", joint_rad=tuple(q.tolist()))
            rig.send("goal", goal=target, speed=speed)
            rig.until(lambda id_=number: rig.state.goal.id == id_)  # type: ignore[misc]
            rig.until(lambda: rig.state.goal.state in {"done", "refused"}, within_s=30.0)
            assert rig.state.goal.state == "done", rig.state.goal
            # A move shorter than the tolerance of arrival is done before it has begun.
            rig.until(lambda q=q: np.abs(rig.joint_rad - q).max() < np.radians(0.01))  # type: ignore[misc]
            rig.send("idle")
            assert rig.is_at_rest()
            rig.arm()
    assert abs(rig.T.rotation[2, 2]) == pytest.approx(1.0, abs=1e-6)
    return rig.T


def tilted(T: pin.SE3, axis: str, angle_rad: float) -> pin.SE3:
    """Return the flange turned about a base axis, in its place."""
    vector = np.array(AXES[axis]) * angle_rad
    return pin.SE3(rotate_about_base_axes(T.rotation, vector), T.translation)


def assert_a_plain_turn(rig: Rig, T_pole: pin.SE3, axis: str) -> None:
    """All reported poses lie on the one rotation about that axis, in one place."""
    for _, T in rig.track:
        assert np.linalg.norm(T.translation - T_pole.translation) < 2e-4
        turn = rotation_between(T_pole.rotation, T.rotation)
        assert np.linalg.norm(turn - (turn @ AXES[axis]) * np.array(AXES[axis])) < 1.5e-3


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("a_deg", AT_POLE_DEG)
@pytest.mark.long
def test_moves_through_a_pole_turn_about_their_one_axis(rig: Rig, a_deg: int, axis: str) -> None:
    """To one side, through the pole to the other, back into it: one rotation, in place."""
    T_pole = at_pole(rig, a_deg)
    rig.track.clear()
    for number, angle_rad in enumerate((TILT_RAD, -TILT_RAD, 0.0), start=PARTS + 1):
        rig.send("goal", goal=pose_goal(number, tilted(T_pole, axis, angle_rad)))
        rig.until(lambda id_=number: rig.state.goal.id == id_)  # type: ignore[misc]
        rig.until(lambda: rig.state.goal.state in {"done", "refused"})
        assert rig.state.goal.state == "done", rig.state.goal
        reached_rad = rotation_between(T_pole.rotation, rig.T.rotation) @ AXES[axis]
        assert reached_rad == pytest.approx(angle_rad, abs=3e-3)
    assert_a_plain_turn(rig, T_pole, axis)


def angle_rad(T_from: pin.SE3, T_to: pin.SE3) -> float:
    """Return the angle between two orientations."""
    return float(np.linalg.norm(rotation_between(T_from.rotation, T_to.rotation)))


def test_moves_over_the_end_of_a_range_turn_by_no_more_than_commanded(rig: Rig) -> None:
    """O goes over 180 degrees: from start to each pose to the end is the direct rotation."""
    T, values = at_pole(rig, 180), []
    turns_deg = ((0.0, 15.0, 0.0), (0.0, 0.0, 6.0), (0.0, 0.0, -12.0))
    for number, turn_deg in enumerate(turns_deg, start=PARTS + 1):
        R = rotate_about_base_axes(T.rotation, np.radians(turn_deg))
        T_to = pin.SE3(R, T.translation)
        rig.track.clear()
        rig.send("goal", goal=pose_goal(number, T_to))
        rig.until(lambda id_=number: rig.state.goal.id == id_)  # type: ignore[misc]
        rig.until(lambda: rig.state.goal.state == "done")
        for _, U in rig.track:
            assert angle_rad(T, U) + angle_rad(U, T_to) < angle_rad(T, T_to) + 1.5e-3
        T = T_to
        values.append(oat_from_R(T.rotation).o)
    assert np.ptp(values) > np.radians(300.0), "no move goes over the end of the range"


@pytest.mark.parametrize("a_deg", AT_POLE_DEG)
def test_set_points_through_a_pole_turn_about_their_one_axis(rig: Rig, a_deg: int) -> None:
    """A stream in steps of 0.02 degrees, from one side of the pole to the other."""
    T_pole = at_pole(rig, a_deg)
    rig.send("setpoint", pose=record_of(T_pole))
    rig.advance(0.05)
    rig.track.clear()
    angles_rad = np.concatenate((np.linspace(0.0, 0.03, 90), np.linspace(0.03, -0.03, 180)))
    for angle_rad in angles_rad:
        rig.send("setpoint", pose=record_of(tilted(T_pole, "slanted", float(angle_rad))))
        rig.advance(0.004)
    rig.advance(1.0)
    assert rig.state.hold_reason == ""
    assert_a_plain_turn(rig, T_pole, "slanted")
    reached_rad = rotation_between(T_pole.rotation, rig.T.rotation) @ AXES["slanted"]
    assert reached_rad == pytest.approx(-0.03, abs=1e-3)


@pytest.mark.parametrize("a_deg", AT_POLE_DEG)
def test_a_torque_turns_the_tool_through_a_pole(rig: Rig, a_deg: int) -> None:
    """Force feedback of orientation, there and back: the TCP stays, the axis is the torque's."""
    T_pole = at_pole(rig, a_deg)
    start = rig.T_tcp
    rig.push()
    rig.feed_back("orientation", Gains(torque_i_rad_per_Nms=(0.06,) * 3))
    rig.track.clear()
    for sign, duration_s in ((1.0, 0.6), (-1.0, 1.2)):
        x, y, z = (sign * part for part in AXES["slanted"])
        rig.push(torque_Nm=(x, y, z))
        rig.advance(duration_s)
    assert rig.state.hold_reason == ""
    turned_rad = [
        rotation_between(T_pole.rotation, T.rotation) @ AXES["slanted"] for _, T in rig.track
    ]
    assert max(turned_rad) > 0.02
    assert min(turned_rad) < -0.02
    T_flange_tcp = rig.cell.tool.T_flange_tcp.pose
    for _, T in rig.track:
        assert np.linalg.norm((T * T_flange_tcp).translation - start.translation) < 2e-4
        turn = rotation_between(T_pole.rotation, T.rotation)
        across = turn - (turn @ AXES["slanted"]) * np.array(AXES["slanted"])
        assert np.linalg.norm(across) < 1.5e-3
