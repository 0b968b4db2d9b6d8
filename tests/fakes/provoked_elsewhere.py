"""Procedures that cause the faults which other processes than the arbiter's detect."""

from typing import Any

import numpy as np
import pinocchio as pin

from common.config.load import load_cell
from common.motion.limits import Limits
from common.motion.setpoint_monitor import SetpointMonitor
from common.motion.tracking import TrackingMonitor
from common.motion.unexplained import UnexplainedMotion
from forcemesh import topics
from forcemesh.bus import Origin
from forcemesh.messages import (
    Asker,
    Feedback,
    Gains,
    Message,
    Permission,
    RobotCommand,
    Trip,
    WrenchAtTcp,
)
from forcemesh.requests import Empty, ForceStartRequest, PathRequest, Reply, SignalRequest
from services.gateway.link import LinkEvents
from services.gateway.service import Gateway
from sim.controller.network import LockStepLink, MemoryNetwork
from sim.robot.service import SimRobot
from tests.contract.rig import gateway_cell
from tests.fakes.bench import CELL, DEMO, Bench
from tests.fakes.regulator_bench import RegulatorBench
from tests.fakes.signals import NAMED
from tests.fakes.wrench_bench import WrenchBench

LIMITS = Limits.of(CELL)
HERE = pin.SE3.Identity()
BEYOND = pin.SE3(np.eye(3), np.array([0.0, 0.0, 1.1 * LIMITS.step_m]))


def from_the_wrench(**sample: Any) -> str:
    """Publish a message of the sensor; return the wrench's fault code."""
    bench = WrenchBench()
    bench.settle()
    bench.sensor = sample
    bench.step(4)
    return bench.published().code


def from_a_frozen_sensor() -> str:
    """Repeat one reading in a cell whose sensor has noise."""
    bench = WrenchBench(CELL)
    bench.pass_s(0.3)
    return bench.published().code


def tare(wait_s: float = 1.0, **state: Any) -> str:
    """Request a tare after a time, with a force that acts or a status of the robot."""
    bench = WrenchBench()
    for name, value in state.items():
        setattr(bench, name, value)
    bench.pass_s(wait_s)
    return bench.ask(topics.TARE, Empty()).code


def start(**request: Any) -> str:
    """Send a start request to the regulator."""
    bench = RegulatorBench()
    bench.pass_s(0.1)
    return bench.start(ForceStartRequest(mode="position", **request)).code


def guide_without_axes_check() -> str:
    """Start hand guiding without a check of the sensor's axes."""
    bench = RegulatorBench()
    bench.wrench = WrenchAtTcp()
    bench.pass_s(0.1)
    return bench.start(ForceStartRequest(mode="position", law="admittance")).code


def request_path_in_force_direction() -> str:
    """Request a path in a direction in which the adaptive law may give way."""
    bench = RegulatorBench()
    bench.pass_s(0.1)
    bench.start(ForceStartRequest(mode="position", law="adaptive"))
    bench.pass_s(0.1)
    return bench.ask(topics.FORCE_PATH, PathRequest(points_m=((0.1, 0.1, 0.0),))).code


def start_without_a_wrench() -> str:
    """Send a start request to the regulator before the first wrench."""
    bench = RegulatorBench()
    bench.silent.add(topics.WRENCH.key)
    bench.pass_s(0.1)
    return bench.start().code


def from_a_gateway_alone() -> str:
    """Run a gateway without a controller."""
    cell = gateway_cell(49152)
    wire = LockStepLink(MemoryNetwork(), 49152, LinkEvents)
    bench = Bench("robot", lambda bus, _: Gateway(bus, cell, wire), cell)
    bench.watch(topics.ROBOT_STATE)
    bench.pass_s(0.1)
    state: Message = bench.newest(topics.ROBOT_STATE)
    return state.code


def from_a_bare_arm() -> str:
    """Command the simulated arm to do a task of a controller."""
    bench = Bench("robot", SimRobot)
    bench.watch(topics.ROBOT_STATE)
    bench.pass_s(0.1)
    challenge = bench.newest(topics.ROBOT_STATE).challenge
    permission = Permission(host="controller", lease=1, deadline_s=0.1, challenge=challenge)
    command = RobotCommand(
        kind="feedback", permission=permission, feedback=Feedback(mode="both", gains=Gains())
    )
    bench.before_step = lambda: bench.put(topics.ROBOT_COMMAND, command, Origin(1, 1))
    bench.pass_s(0.1)
    state = bench.newest(topics.ROBOT_STATE)
    return str(state.hold_code)


def ruled(trip: Trip | Reply | None) -> str:
    """Return the code of a rule's verdict."""
    return "nothing" if trip is None else trip.code


def flood_commands() -> Trip | None:
    """Accelerate gently to one and a half times the speed limit."""
    rule, x_m, speed_m_s = SetpointMonitor(LIMITS), 0.0, 0.0
    trip = rule.begin(HERE, 0)
    for now_ns in range(4_000_000, 2_000_000_000, 4_000_000):
        speed_m_s = min(speed_m_s + 2e-3 * LIMITS.accel_m_s2, 1.5 * LIMITS.speed_m_s)
        x_m += 4e-3 * speed_m_s
        trip = trip or rule.check(pin.SE3(np.eye(3), np.array([x_m, 0.0, 0.0])), now_ns)
    return trip


def reverse_at_once(rule: SetpointMonitor) -> Trip | None:
    """Run nearly at the speed limit, then reverse at once."""
    period_ns, place = 4_000_000, pin.SE3.Identity()
    trip = rule.begin(place, 0)
    for number in range(1, 60):
        travel_m = 9e-4 if number < 40 else -9e-4
        place = pin.SE3(np.eye(3), place.translation + np.array([travel_m, 0.0, 0.0]))
        trip = trip or rule.check(place, number * period_ns)
    return trip


def an_arm_that_stays_behind(rule: TrackingMonitor) -> Trip | None:
    """Command one pose and report another one for a second."""
    trips = []
    for now_ns in range(0, 1_000_000_000, 4_000_000):
        rule.stream(HERE, now_ns)
        trips.append(rule.judge(BEYOND, (0.0,) * 6, now_ns))
    return trips[-1]


def an_arm_that_leaves_its_rest(monitor: UnexplainedMotion) -> Trip | None:
    """Report one pose for a second, then another one, without a command."""
    trips = [monitor.judge(HERE, now_ns) for now_ns in range(0, 1_000_000_000, 4_000_000)]
    trips += [monitor.judge(BEYOND, 2_000_000_000 + now_ns) for now_ns in range(3)]
    return trips[-1]


def request_signal(signal: str, commander: Asker = "operator") -> str:
    """Request an output of a simulated robot that holds."""
    bench = Bench("robot", SimRobot, load_cell(DEMO, {"signals": NAMED}))
    request = SignalRequest(signal=signal, on=True, commander=commander)
    return bench.ask(topics.SIGNAL, request).code
