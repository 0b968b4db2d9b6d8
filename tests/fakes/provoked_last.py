"""Procedures that cause the faults of the regulator's guards, a slow controller, a hand-over."""

import numpy as np
import pinocchio as pin

from common.motion.convert import record_of
from controller.packet import Packet
from controller.packet_table import Com
from forcemesh import topics
from forcemesh.messages import Feedback, Gains
from forcemesh.requests import ForceStartRequest, GainsRequest
from services.arbiter.commanders import SETTLE_WITHIN_S
from tests.fakes.arbiter_robot import RobotWorld
from tests.fakes.arbiter_world import PERIOD_NS, T_START
from tests.fakes.bench import CELL
from tests.fakes.gateway_world import FaultyController, GatewayWorld
from tests.fakes.regulator_bench import KI, RegulatorBench

TOUCH_N, SETPOINT_N = CELL.force.touch_N, 20.0
STEPS = 600  # of two milliseconds: longer than the controller may take to reply


def pressing() -> RegulatorBench:
    """Start to press without contact."""
    bench = RegulatorBench()
    bench.pass_s(0.1)
    assert bench.start(ForceStartRequest(mode="position", setpoint_N=SETPOINT_N)).accepted
    bench.pass_s(1.0)
    return bench


def push_sideways() -> str:
    """Touch a surface that does not push back in the tool's direction."""
    bench = pressing()
    bench.push((2.0 * TOUCH_N, 0.0, 0.0))
    bench.step(5)
    return bench.published().code


def search_too_far() -> str:
    """Go down the whole search travel without contact."""
    bench = pressing()
    down_m = np.array([0.0, 0.0, -1.1 * CELL.force.search_m])
    there = record_of(pin.SE3(T_START.rotation, T_START.translation + down_m))
    bench.robot = bench.robot.replaced(**there.as_dict())
    bench.step(2)
    return bench.published().code


def swing() -> str:
    """Alternate too much and too little force, as a loop with too high a gain does."""
    bench = pressing()
    for number in range(42):  # twice at lowered gains
        bench.push((0.0, 0.0, SETPOINT_N + (-15.0 if number % 2 else 15.0)))
        bench.pass_s(2.0 * CELL.loop_delay_s)
    return bench.published().code


def request_unstable_gains() -> str:
    """Request twenty times the gain of the cell's stiffness."""
    bench = RegulatorBench()
    bench.step()
    asked = GainsRequest(force_i_m_per_Ns=(0.0, 0.0, 20.0 * KI))
    return bench.ask(topics.GAINS, asked).code


# --- the gateway ----------------------------------------------------------------------------------


class IgnoringController(FaultyController):
    """Receives a command without executing it; optionally without the echo of its receipt."""

    def __init__(self, ignored: Com, *, echoes: bool = True) -> None:
        """Ignore one command; without `echoes` the ID of that packet stays the last one."""
        super().__init__()
        self._ignored, self._echoes, self._stuck = ignored, echoes, False

    def _take(self, packet: Packet) -> None:
        if self._stuck:
            return
        if packet.com != self._ignored:
            super()._take(packet)
        elif self._echoes:
            self._id = packet.id
        else:
            self._stuck = True


def feed_back(controller: FaultyController, gain: float = 1e-5) -> set[str]:
    """Command force feedback in the controller for a time; return the gateway's hold reason."""
    world = GatewayWorld(controller)
    world.lease += 1
    feedback = Feedback(mode="position", gains=Gains(force_p_m_per_N=(gain, gain, gain)))
    for _ in range(STEPS // 10):
        world.send(world.permitted("feedback", feedback=feedback))
        world.live(10)
    return world.codes


def request_gain_that_rounds_to_zero() -> str:
    """Request a gain below the last digit of the packet."""
    return one_of("unsendable", feed_back(FaultyController(), 1e-13))


def start_no_feedback() -> str:
    """Let the controller ignore the start of force feedback."""
    return one_of("feedback", feed_back(IgnoringController(Com.FEEDBACK)))


def answer_late() -> str:
    """Let the controller echo nothing after hello and hold, and continue its reports."""
    return one_of("link_slow", feed_back(IgnoringController(Com.LIMITS, echoes=False)))


def one_of(code: str, codes: set[str]) -> str:
    """Return the code if it is among the reported ones."""
    return code if code in codes else f"{sorted(codes)} instead"


# --- the hand-over --------------------------------------------------------------------------------


def preempt() -> str:
    """Let a person take the arm from the regulator."""
    world = RobotWorld().give("regulator")
    world.ask("operator")
    return world.core.status().trips[-1].code


def never_rest() -> str:
    """Keep the arm from rest, so that the next commander must wait."""
    world = RobotWorld(brake_periods=10**6).give("program")
    world.ask("operator")
    world.tick(round((SETTLE_WITHIN_S + 0.1) * 1e9 / PERIOD_NS))
    return world.core.status().trips[-1].code
