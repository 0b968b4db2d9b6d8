"""Force feedback in the controller as the gateway runs it: start, wrenches, end."""

import numpy as np
import pytest

from controller.packet import Packet
from controller.packet_table import Com, Status
from forcemesh.messages import Feedback, Gains, WrenchAtTcp
from tests.contract.rig import pose_goal, shifted
from tests.fakes.gateway_cell import GatewayCell, a_cell

GAINS = Gains(force_p_m_per_N=(2e-6, 2e-6, 2e-6), force_i_m_per_Ns=(1e-5, 1e-5, 1e-5))


@pytest.fixture
def cell() -> GatewayCell:
    """Return a connected cell."""
    cell = a_cell()
    cell.rig.connect()
    return cell


def start_feedback(cell: GatewayCell) -> None:
    """Run position feedback with 10 N as set point, while 12 N act along z."""
    cell.rig.arm()
    cell.rig.wrench = WrenchAtTcp(force_N=(1.0, 0.0, 12.0), torque_Nm=(0.1, 0.2, 0.3))
    feedback = Feedback(mode="position", setpoint_force_N=(0.0, 0.0, 10.0), gains=GAINS)
    cell.rig.send("feedback", host="controller", feedback=feedback)
    cell.rig.until(lambda: len(cell.controller.of(Com.WRENCH)) >= 5)


def test_the_controller_gets_centre_and_gains_then_the_start_then_set_point_and_wrench(
    cell: GatewayCell,
) -> None:
    """11, 6, 6, 7, 14, and then 4 with the measured newtons and newton metres in base axes."""
    start_feedback(cell)
    assert cell.coms()[9:15] == [
        Com.TCP, Com.GAINS, Com.GAINS, Com.FEEDBACK, Com.FORCE_SET_POINT, Com.WRENCH,
    ]  # fmt: skip
    assert cell.controller.robot.tcp == (0, 0, 160 * 50, 0, 0, 0)
    assert cell.controller.of(Com.WRENCH)[0].vec == (100, 0, 1200, 100, 200, 300)
    assert [p.vec for p in cell.controller.of(Com.FORCE_SET_POINT)] == [(0, 0, 1000, 0, 0, 0)]
    assert cell.controller.robot.gains_p == (1000, 1000, 1000, 0, 0, 0)
    assert cell.controller.robot.gains_i == (50, 50, 50, 0, 0, 0)
    assert cell.rig.state.status.feedback == "position"


def test_a_wrench_is_sent_once(cell: GatewayCell) -> None:
    """The controller integrates the samples: the same sample again would count twice."""
    start_feedback(cell)
    cell.rig._next_ns += 10**12  # the stand-ins for arbiter and wrench publish nothing new
    cell.rig.advance(0.02)
    sent = len(cell.controller.of(Com.WRENCH))
    cell.rig.advance(0.05)
    assert len(cell.controller.of(Com.WRENCH)) <= sent + 1
    assert cell.rig.state.hold_reason == ""


def test_idle_stops_force_feedback(cell: GatewayCell) -> None:
    """7 with Param 2 is sent, and moves are possible again."""
    start_feedback(cell)
    cell.rig.send("idle")
    cell.rig.until(lambda: cell.rig.state.status.feedback is None)
    assert Packet(0, 7, 2).frames[1:] in [p.frames[1:] for p in cell.controller.of(Com.FEEDBACK)]
    cell.rig.send("goal", goal=pose_goal(1, shifted(cell.rig.T, z_m=0.005)))
    cell.rig.until(lambda: cell.rig.state.goal.state == "done")


def test_a_move_waits_until_force_feedback_has_ended(cell: GatewayCell) -> None:
    """The stop is sent first, then the move."""
    start_feedback(cell)
    cell.rig.send("goal", goal=pose_goal(1, shifted(cell.rig.T, z_m=0.005)))
    cell.rig.until(lambda: cell.rig.state.goal.state == "done")
    tail = [com for com in cell.coms() if com in {Com.FEEDBACK, Com.MOVE_POSE}]
    assert tail == [Com.FEEDBACK, Com.FEEDBACK, Com.MOVE_POSE]


def test_new_gains_reach_a_running_feedback(cell: GatewayCell) -> None:
    """The gains are sent without a stop."""
    start_feedback(cell)
    gains = GAINS.replaced(force_p_m_per_N=(3e-06, 3e-06, 3e-06))
    cell.rig.send("feedback", host="controller", feedback=Feedback(mode="position", gains=gains))
    cell.rig.until(lambda: cell.controller.robot.gains_p[0] == 1500)
    assert len(cell.controller.of(Com.FEEDBACK)) == 1


@pytest.mark.parametrize("cause", ["hold", "no wrench", "too much force", "ended by itself"])
def test_force_feedback_ends_in_hold(cell: GatewayCell, cause: str) -> None:
    """8 is sent, no wrench follows, and it does not start again under the same lease."""
    start_feedback(cell)
    if cause == "hold":
        cell.rig.send_hold()
    elif cause == "no wrench":
        cell.rig.wrench = None
    elif cause == "too much force":
        cell.rig.wrench = WrenchAtTcp(force_N=(0.0, 0.0, 61.0))
    else:
        cell.controller.robot.status &= ~Status.POSITION_FEEDBACK
    cell.rig.until(lambda: cell.rig.state.hold_reason)
    cell.rig.until(lambda: cell.rig.state.status.feedback is None)
    cell.rig.advance(0.05)
    assert cell.controller.received[-1].packet.com == Com.HOLD
    cell.rig.wrench = WrenchAtTcp()
    starts, wrenches = len(cell.controller.of(Com.FEEDBACK)), len(cell.controller.of(Com.WRENCH))
    cell.rig.advance(0.2)
    assert len(cell.controller.of(Com.FEEDBACK)) == starts
    assert len(cell.controller.of(Com.WRENCH)) == wrenches


def test_the_arm_yields_to_the_force(cell: GatewayCell) -> None:
    """The sign from end to end: the environment pushes up, and the flange moves up only."""
    start = cell.controller.T_base_flange.translation
    cell.rig.arm()
    cell.rig.wrench = WrenchAtTcp(force_N=(0.0, 0.0, 20.0))
    feedback = Feedback(mode="position", gains=GAINS)
    cell.rig.send("feedback", host="controller", feedback=feedback)
    cell.rig.until(lambda: cell.controller.T_base_flange.translation[2] > start[2] + 0.001)
    moved = cell.controller.T_base_flange.translation - start
    assert np.abs(moved[:2]).max() < 1e-5


def test_the_controller_turns_about_the_point_of_contact(cell: GatewayCell) -> None:
    """11 is TCP plus lever at the start, and again after a move of 3 mm."""
    cell.rig.arm()
    cell.rig.wrench = WrenchAtTcp()

    def send_feedback(x_m: float) -> None:
        feedback = Feedback(mode="both", lever_m=(x_m, 0.0, 0.0), gains=GAINS)
        cell.rig.send("feedback", host="controller", feedback=feedback)

    send_feedback(0.025)
    cell.rig.until(lambda: len(cell.controller.of(Com.WRENCH)) >= 3)
    send_feedback(0.023)
    cell.rig.advance(0.05)
    send_feedback(0.020)
    cell.rig.until(lambda: len(cell.controller.of(Com.TCP)) == 3)
    centres = [(p.param, *p.vec[:3]) for p in cell.controller.of(Com.TCP)]
    assert centres == [(0, 0, 0, 8000), (1, 1250, 0, 8000), (1, 1000, 0, 8000)]
