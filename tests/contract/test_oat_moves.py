"""Whole moves with singular O, A, T: encode, AS program, LMOVE, 101 back, decode.

Through and into A = 0 and A = 180, and over the ends of the ranges of O and of T, the arm turns
once about one axis by no more than was commanded, during the whole commanded path.
"""

import math
from collections.abc import Iterator

import numpy as np
import pinocchio as pin
import pytest

from common.motion.convert import record_of
from common.motion.frames import oat_from_R, rotate_about_base_axes, rotation_between
from forcemesh.messages import Speed
from tests.contract.rig import Rig, goal, pose_goal, shifted
from tests.contract.robots import Emulated

DOWN = (0.0, 0.0, -90.0, 0.0, -90.0, 0.0)  # A = 180
UP = (0.0, 20.0, -90.0, 0.0, 110.0, 0.0)  # A = 0
TURNED = (0.0, 10.0, -80.0, 0.0, -70.0, -90.0)  # A = 160, T near the end of its range
SAMPLE_EVERY = 4  # ms
UNIT_RAD = math.radians(1 / 500)  # of O, A, T in a packet

# name: joints at the start [deg], turns [deg] about base axes one after the other, way [m].
MOVES: dict[str, tuple[tuple[float, ...], list[tuple[float, float, float]], float]] = {
    "through 180": (DOWN, [(10, 0, 0), (-20, 0, 0), (10, 0, 0)], 0.0),
    "through 180, slanted and in motion": (DOWN, [(6, 7, 0), (-14, -13, 0)], 0.03),
    "about the axis at 180": (DOWN, [(0, 0, 15), (0, 0, -30)], 0.02),
    "a hundredth of a degree off 180": (DOWN, [(0.02, 0, 0), (-0.02, 0.02, 0)], 0.01),
    "through 0": (UP, [(10, 0, 0), (-20, 0, 0), (10, 0, 0)], 0.0),
    "about the axis at 0": (UP, [(0, 0, 15), (0, 0, -30)], 0.0),
    "over the end of O": (DOWN, [(0, 15, 0), (0, 0, 6), (0, 0, -12)], 0.0),
    "over the end of T": (TURNED, [(0, 0, 15), (0, 0, -25), (5, 5, 12)], 0.0),
}
WRAPS = {"over the end of O": 0, "over the end of T": 2}


class Arm:
    """One emulated cell and the commanded poses of its arm, sampled every few milliseconds."""

    def __init__(self) -> None:
        self.emulated = Emulated()
        self.rig: Rig = self.emulated.rig
        self.rig.connect()
        self.quick = Speed(mechanical_m_s=self.rig.cell.limits.speed_m_s)
        self.path_poses: list[pin.SE3] = []
        self._goals = 0
        self._ticks = 0
        self.emulated.machine.after_tick.append(self._record_pose)

    @property
    def commanded(self) -> pin.SE3:
        """The commanded pose of the flange at this time."""
        robot = self.emulated.machine.robot
        return robot.pose_of(robot.queue.q_command)

    def _record_pose(self) -> None:
        self._ticks += 1
        if self._ticks % SAMPLE_EVERY == 0:
            self.path_poses.append(self.commanded)

    def go(self, **target: object) -> None:
        """Carry out one goal."""
        self._goals += 1
        if "pose" in target:
            next_goal = pose_goal(self._goals, target["pose"])
        else:
            next_goal = goal(self._goals, "joints", **target)
        rig = self.rig
        rig.send("goal", goal=next_goal, speed=self.quick)
        rig.until(lambda: rig.state.goal.id == next_goal.id)
        rig.until(lambda: rig.state.goal.state in {"done", "refused"}, within_s=30.0)
        assert rig.state.goal.state == "done", rig.state.goal

    def start_at(self, joints_deg: tuple[float, ...]) -> pin.SE3:
        """Bring the arm to joint angles and wait until it rests."""
        self.rig.arm()
        begin, end = self.rig.joint_rad, np.radians(joints_deg)
        if not np.allclose(begin, end, atol=2e-4):
            for q in (0.5 * (begin + end), end):  # the tool turns by more than the tether in all
                self.go(joint_rad=tuple(q.tolist()))
                assert self.rig.is_at_rest()
                self.rig.arm()
        return pin.SE3(self.rig.T)


@pytest.fixture
def arm() -> Iterator[Arm]:
    """Yield a cell of its own: the way to a start depends on where the arm is."""
    cell = Arm()
    yield cell
    assert cell.emulated.machine.stops == []


def turn_rad(T_from: pin.SE3, T_to: pin.SE3) -> float:
    """Angle between two orientations."""
    return float(np.linalg.norm(rotation_between(T_from.rotation, T_to.rotation)))


def assert_no_detour(
    path_poses: list[pin.SE3], T_from: pin.SE3, T_to: pin.SE3, slack_rad: float
) -> None:
    """Start, each pose and the end together turn no more than the direct rotation does."""
    commanded_rad = turn_rad(T_from, T_to)
    for T in path_poses:
        assert turn_rad(T_from, T) + turn_rad(T, T_to) < commanded_rad + slack_rad


@pytest.mark.parametrize("name", MOVES)
def test_a_move_turns_no_more_than_commanded_and_ends_where_commanded(arm: Arm, name: str) -> None:
    """The commanded poses on the path, every report, and the end."""
    joints_deg, turns_deg, travel_m = MOVES[name]
    T = arm.start_at(joints_deg)
    triples = [oat_from_R(T.rotation)]
    for index, turn_deg in enumerate(turns_deg):
        R = rotate_about_base_axes(T.rotation, np.radians(np.array(turn_deg, dtype=float)))
        T_to = shifted(pin.SE3(R, T.translation), z_m=travel_m * (-1) ** index)
        arm.path_poses.clear()
        arm.rig.track.clear()
        begin = arm.commanded
        arm.go(pose=T_to)
        assert arm.rig.is_at_rest()
        assert_no_detour(arm.path_poses, begin, T_to, 6 * UNIT_RAD)
        assert_no_detour([T_flange for _, T_flange in arm.rig.track], T, T_to, 15 * UNIT_RAD)
        steps = [turn_rad(a, b) for a, b in zip(arm.path_poses, arm.path_poses[1:], strict=False)]
        assert sum(steps) < turn_rad(begin, T_to) + 6 * UNIT_RAD
        assert turn_rad(arm.rig.T, T_to) < 8 * UNIT_RAD
        assert np.linalg.norm(arm.rig.T.translation - T_to.translation) < 1e-4
        T = T_to
        triples.append(oat_from_R(T.rotation))
    if name in WRAPS:
        angles = [triple[WRAPS[name]] for triple in triples]
        assert np.ptp(angles) > math.radians(300), "the move does not go over the end of the range"


@pytest.mark.parametrize("pole", [DOWN, UP], ids=["180", "0"])
def test_a_stream_round_a_pole_turns_the_tool_by_its_tilt_only(
    arm: Arm, pole: tuple[float, ...]
) -> None:
    """The tool's axis goes round the pole one degree off it: O runs through all its values.

    The axis goes 2 pi times one degree; were O and T interpolated, the flange would spin.
    """
    T_pole, tilt_rad = arm.start_at(pole), math.radians(1.0)
    azimuths = np.linspace(0.0, math.tau, 181)

    def tilted_pose(azimuth: float, tilt: float) -> pin.SE3:
        vector = tilt * np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
        return pin.SE3(rotate_about_base_axes(T_pole.rotation, vector), T_pole.translation)

    path = [tilted_pose(0.0, share * tilt_rad) for share in np.linspace(0.0, 1.0, 40)]
    path += [tilted_pose(azimuth, tilt_rad) for azimuth in azimuths]
    arm.path_poses.clear()
    for T in path:
        arm.rig.send("setpoint", pose=record_of(T), speed=arm.quick)
        arm.rig.advance(0.012)
    arm.rig.advance(1.0)
    assert arm.rig.state.hold_reason == ""
    assert max(turn_rad(T_pole, T) for T in arm.path_poses) < tilt_rad * 1.05
    steps = [turn_rad(a, b) for a, b in zip(arm.path_poses, arm.path_poses[1:], strict=False)]
    assert sum(steps) < (math.tau + 1.0) * tilt_rad * 1.1
    assert turn_rad(arm.rig.T, path[-1]) < 10 * UNIT_RAD
    values = [oat_from_R(T.rotation).o for T in path[40:]]
    assert np.ptp(values) > math.radians(350)
