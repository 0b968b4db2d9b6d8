"""Our gateway drives plain.as in lock step: a) to g) of the specification alone."""

import numpy as np
import pytest

from controller.plain import PlainSection
from forcemesh.messages import Feedback, Gains
from tests.contract.rig import distance_m, goal, pose_goal, shifted
from tests.contract.robots import Emulated, plain_cell
from tests.fakes.controller import QUICK

GAINS = Gains(force_i_m_per_Ns=(4e-4, 4e-4, 4e-4))
NEAR_M, NEAR_RAD = 2e-3, 0.03  # with whole millimetres and degrees
FEEDBACK_S = 0.02  # a sample of the sensor


def armed(*, is_specification: bool = False, chars: int = 63) -> Emulated:
    """An armed cell whose program has its numbers, over a plate 3 mm below the tool."""
    names = set(PlainSection.model_fields) - {"packet_chars"} if is_specification else ()
    changes: dict[str, object] = {f"gateway.plain.{name}": 1 for name in names}
    changes |= {"gateway.plain.packet_chars": chars}
    changes |= {"sim.gap_m": 0.003, "sim.stiffness_N_m": 1e4}
    cell = Emulated(QUICK, cell=plain_cell(**changes))
    cell.rig.connect()
    cell.rig.arm()
    return cell


def until_done(cell: Emulated, id_: int) -> None:
    """Advance until a goal is done."""
    goal_done = (id_, "done")
    cell.rig.until(lambda: (cell.rig.state.goal.id, cell.rig.state.goal.state) == goal_done)


def run_feedback(cell: Emulated, setpoint_N: float, duration_s: float) -> float:
    """Run force feedback on the true wrench; return the force along z at the end."""
    feedback = Feedback(mode="position", gains=GAINS, setpoint_force_N=(0.0, 0.0, setpoint_N))
    cell.rig.push()
    cell.rig.send("feedback", host="controller", feedback=feedback)
    force_N = 0.0
    for _ in range(round(duration_s / FEEDBACK_S)):
        true = cell.machine.robot.arm.true_wrench()
        force_N = float(true.force_N[2])
        cell.rig.push(tuple(true.force_N.tolist()), tuple(true.torque_Nm.tolist()))
        cell.rig.advance(FEEDBACK_S)
    return force_N


@pytest.mark.parametrize("chars", [54, 63])
@pytest.mark.parametrize("is_specification", [False, True], ids=["fine", "whole mm and degrees"])
def test_goals_of_every_kind_are_reached(is_specification: bool, chars: int) -> None:
    """Commands 1, 2 and 3 after their speeds, and the echo of their IDs."""
    cell = armed(is_specification=is_specification, chars=chars)
    rig, arm = cell.rig, cell.machine.robot.arm
    target = shifted(arm.T_base_flange, x_m=0.02, z_m=0.03)
    near_m, near_rad = (NEAR_M, NEAR_RAD) if is_specification else (1e-4, 1e-3)

    rig.send("goal", goal=pose_goal(1, target))
    rig.until(lambda: rig.state.goal.state == "done")
    assert distance_m(arm.T_base_flange, target) < near_m
    for id_, kind, by in ((2, "joints", 0.1), (3, "by", -0.08)):
        start = arm.q
        angles = start + by if kind == "joints" else np.full(6, by)
        rig.send("goal", goal=goal(id_, kind, joint_rad=tuple(angles.tolist())))
        until_done(cell, id_)
        assert np.abs(arm.q - start - by).max() < near_rad


@pytest.mark.parametrize("chars", [54, 63])
def test_it_presses_and_releases_by_force_feedback_in_the_controller(chars: int) -> None:
    """Commands 6, 7 and 4; then a goal at its own speed, not at that of force feedback."""
    cell = armed(chars=chars)
    assert run_feedback(cell, 10.0, 5.0) == pytest.approx(10.0, abs=0.5)
    assert cell.rig.state.status.feedback == "position"
    assert run_feedback(cell, 0.0, 3.0) == pytest.approx(0.0, abs=0.5)
    up = shifted(cell.rig.T, z_m=0.05)
    cell.rig.send("goal", goal=pose_goal(1, up))
    cell.rig.until(lambda: cell.rig.state.goal.state == "done")
    assert cell.rig.state.status.feedback is None
    assert cell.rig.fastest(0.2)[0] > 0.2 * 0.05  # more than twice the speed of force feedback


def test_a_hold_stops_a_goal_and_force_feedback() -> None:
    """Command 3 with zeros: the arm stops within 0.2 s, and a new lease moves it again."""
    cell = armed()
    rig, arm = cell.rig, cell.machine.robot.arm
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
    run_feedback(cell, 10.0, 0.5)
    rig.send_hold()
    rig.advance(0.3)
    assert cell.machine.memory.read("pl.mode") == 0
    stopped = arm.T_base_flange
    rig.advance(0.5)
    assert distance_m(arm.T_base_flange, stopped) < 1e-5


def test_coarse_gains_are_refused_with_the_scale_to_change() -> None:
    """0.4 mm/(N s) is no whole number of mm/(N s): hold, nothing is started."""
    cell = armed(is_specification=True)
    run_feedback(cell, 0.0, 0.2)
    assert "gateway.plain.gain_i" in cell.rig.state.hold_reason
    assert cell.machine.memory.read("pl.mode") == 0


def test_the_gateway_comes_back_after_the_program_was_started_again() -> None:
    """The arm is held, the lease has ended, the connection is a new one."""
    cell = armed()
    machine = cell.machine
    machine.pendant.abort()
    cell.rig.advance(0.2)
    machine.pendant.execute("pl.main")
    cell.rig.until(lambda: not cell.rig.state.valid)
    cell.rig.until(lambda: cell.rig.state.valid)
    assert cell.rig.state.hold_reason
    cell.rig.arm()
