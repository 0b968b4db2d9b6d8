"""Our gateway drives plain.as over a real TCP socket: a) to g) of the specification alone."""

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from forcemesh.messages import Gains
from tests.contract.rig import distance_m, goal, pose_goal, shifted
from tests.fakes.plain_rig import PlainRig

pytestmark = pytest.mark.realtime

GAINS = Gains(force_i_m_per_Ns=(4e-4, 4e-4, 4e-4))
NEAR_M, NEAR_RAD = 2e-3, 0.03  # with whole millimetres and degrees

Make = Callable[..., PlainRig]


@pytest.fixture
def make() -> Iterator[Make]:
    """Make cells that end with the test."""
    made: list[PlainRig] = []

    def one(**options: object) -> PlainRig:
        made.append(PlainRig(**options))  # type: ignore[arg-type]
        return made[-1]

    yield one
    for each in made:
        each.close()


@pytest.mark.parametrize("chars", [54, 63])
@pytest.mark.parametrize("is_specification", [False, True], ids=["fine", "whole mm and degrees"])
def test_goals_of_every_kind_are_reached(make, is_specification, chars):
    """Commands 1, 2 and 3 after their speeds, and the echo of their IDs."""
    cell = make(is_specification=is_specification, chars=chars)
    cell.arm()
    rig, arm = cell.rig, cell.controller.arm
    target = shifted(arm.T_base_flange, x_m=0.02, z_m=0.03)
    near_m, near_rad = (NEAR_M, NEAR_RAD) if is_specification else (1e-4, 1e-3)

    rig.send("goal", goal=pose_goal(1, target))
    rig.until(lambda: rig.state.goal.state == "done")
    assert distance_m(arm.T_base_flange, target) < near_m
    for id_, kind, by in ((2, "joints", 0.1), (3, "by", -0.08)):
        start = arm.q
        angles = start + by if kind == "joints" else np.full(6, by)
        rig.send("goal", goal=goal(id_, kind, joint_rad=tuple(angles.tolist())))
        rig.until(lambda number=id_: rig.state.goal.id == number)
        rig.until(lambda: rig.state.goal.state == "done")
        assert np.abs(arm.q - start - by).max() < near_rad


@pytest.mark.parametrize("chars", [54, 63])
def test_it_presses_and_releases_by_force_feedback_in_the_controller(make, chars):
    """Commands 6, 7 and 4; then a goal at its own speed, not at that of force feedback."""
    cell = make(chars=chars)
    cell.arm()
    assert cell.run_feedback(GAINS, 10.0, 5.0) == pytest.approx(10.0, abs=0.5)
    assert cell.rig.state.status.feedback == "position"
    assert cell.run_feedback(GAINS, 0.0, 3.0) == pytest.approx(0.0, abs=0.5)
    up = shifted(cell.rig.T, z_m=0.05)
    cell.rig.send("goal", goal=pose_goal(1, up))
    cell.rig.until(lambda: cell.rig.state.goal.state == "done")
    assert cell.rig.state.status.feedback is None
    assert cell.rig.fastest(0.2)[0] > 0.2 * 0.05  # more than twice the speed of force feedback


def test_a_hold_stops_a_goal_and_force_feedback(make):
    """Command 3 with zeros: the arm stops within 0.2 s, and a new lease moves it again."""
    cell = make()
    cell.arm()
    rig, arm = cell.rig, cell.controller.arm
    start = arm.T_base_flange
    rig.send("goal", goal=pose_goal(1, shifted(start, z_m=0.1)))
    rig.until(lambda: distance_m(arm.T_base_flange, start) > 0.02)
    rig.send_hold()
    rig.advance(0.2)
    stopped = arm.T_base_flange
    rig.advance(1.0)
    assert distance_m(arm.T_base_flange, stopped) < 1e-5
    assert distance_m(stopped, start) < 0.05
    assert rig.state.status.held
    rig.arm()
    cell.run_feedback(GAINS, 10.0, 0.5)
    rig.send_hold()
    rig.advance(0.3)
    assert cell.controller.value("pl.mode") == 0
    stopped = arm.T_base_flange
    rig.advance(0.5)
    assert distance_m(arm.T_base_flange, stopped) < 1e-5




