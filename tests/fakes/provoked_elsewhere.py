"""How to bring about the faults that other processes than the arbiter's find."""

from typing import Any

import numpy as np
import pinocchio as pin

from common.motion.limits import Limits
from common.motion.rate_limiter import PathWindow, check_rate
from common.motion.setpoint_monitor import SetpointMonitor
from common.motion.tracking import TrackingMonitor
from forcemesh import topics
from forcemesh.bus import Origin
from forcemesh.messages import (
    Feedback,
    Gains,
    Message,
    Permission,
    RobotCommand,
    RobotStatus,
    Trip,
    WrenchAtTcp,
)
from forcemesh.requests import Empty, ForceStartRequest, PathRequest, Reply
from services.gateway.link import News
from services.gateway.service import Gateway
from sim.controller.network import MemoryNetwork
from sim.controller.wire import LockStepLink
from sim.robot.service import SimRobot
from tests.contract.rig import gateway_cell
from tests.fakes.bench import CELL, Bench
from tests.fakes.regulator_bench import RegulatorBench
from tests.fakes.wrench_bench import WrenchBench

LIMITS = Limits.of(CELL)
HERE = pin.SE3.Identity()
BEYOND = pin.SE3(np.eye(3), np.array([0.0, 0.0, 1.1 * LIMITS.step_m]))


def from_the_wrench(**sample: Any) -> str:
    """Let the sensor say something; return what the wrench is called."""
    bench = WrenchBench()
    bench.settle()
    bench.sensor = sample
    bench.step(4)
    return bench.said().code


def from_a_frozen_sensor() -> str:
    """Repeat one and the same reading in a cell whose sensor has noise."""
    bench = WrenchBench(CELL)
    bench.pass_s(0.3)
    return bench.said().code


def tare(bench: WrenchBench, wait_s: float = 1.0) -> str:
    """Ask for a tare."""
    bench.pass_s(wait_s)
    return bench.ask(topics.TARE, Empty()).code


def tare_in_contact() -> str:
    """Ask for a tare while something pushes."""
    bench = WrenchBench()
    bench.force_N = np.array([0.0, 0.0, 20.0])
    return tare(bench)


def tare_in_motion() -> str:
    """Ask for a tare while the controller says that the arm moves."""
    bench = WrenchBench()
    bench.status = RobotStatus(moving=True)
    return tare(bench)


def start(**wanted: Any) -> str:
    """Ask the regulator to start."""
    bench = RegulatorBench()
    bench.pass_s(0.1)
    return bench.start(ForceStartRequest(mode="position", **wanted)).code


def guide_before_the_check() -> str:
    """Let a hand guide what nobody has checked."""
    bench = RegulatorBench()
    bench.wrench = WrenchAtTcp()
    bench.pass_s(0.1)
    return bench.start(ForceStartRequest(mode="position", law="admittance")).code


def go_where_force_may_move() -> str:
    """Ask for a path while the adaptive law may give way along it."""
    bench = RegulatorBench()
    bench.pass_s(0.1)
    bench.start(ForceStartRequest(mode="position", law="adaptive"))
    bench.pass_s(0.1)
    return bench.ask(topics.FORCE_PATH, PathRequest(points_m=((0.1, 0.1, 0.0),))).code


def start_without_a_wrench() -> str:
    """Ask the regulator to start before the wrench service was ever heard."""
    bench = RegulatorBench()
    bench.silent.add(topics.WRENCH.key)
    bench.pass_s(0.1)
    return bench.start().code


def from_a_gateway_alone() -> str:
    """Let a gateway speak that has no controller."""
    cell = gateway_cell(49152)
    wire = LockStepLink(MemoryNetwork(), 49152, News)
    bench = Bench("robot", lambda bus, _: Gateway(bus, cell, wire), cell)
    bench.watch(topics.ROBOT_STATE)
    bench.pass_s(0.1)
    said: Message = bench.newest(topics.ROBOT_STATE)
    return said.code


def from_a_bare_arm() -> str:
    """Ask the simulated arm for what only a controller can do."""
    bench = Bench("robot", SimRobot)
    permission = Permission(host="controller", lease=1, deadline_s=0.1)
    command = RobotCommand(
        kind="feedback", permission=permission, feedback=Feedback(mode="both", gains=Gains())
    )
    bench.before_step = lambda: bench.put(topics.ROBOT_COMMAND, command, Origin(1, 1))
    bench.watch(topics.ROBOT_STATE)
    bench.pass_s(0.1)
    said = bench.newest(topics.ROBOT_STATE)
    return str(said.hold_code)


def ruled(trip: Trip | Reply | None) -> str:
    """Return the code of a rule's answer."""
    return "nothing" if trip is None else trip.code


def a_flood() -> Trip | None:
    """Command ten steps of a millimetre within a hundredth of a second, a hundred times."""
    window, there = PathWindow(), pin.SE3(np.eye(3), np.array([1e-3, 0.0, 0.0]))
    for now_ns in range(1_000_000, 200_000_000, 1_000_000):
        window = window.after(now_ns, HERE, there)
    return check_rate(LIMITS, window)


def too_sudden(rule: SetpointMonitor) -> Trip | None:
    """Run nearly as fast as is allowed, then back at once."""
    period_ns, place = 4_000_000, pin.SE3.Identity()
    trip = rule.begin(place, 0)
    for number in range(1, 60):
        way_m = 9e-4 if number < 40 else -9e-4
        place = pin.SE3(np.eye(3), place.translation + np.array([way_m, 0.0, 0.0]))
        trip = trip or rule.spend(place, number * period_ns)
    return trip


def an_arm_that_stays_behind(rule: TrackingMonitor) -> Trip | None:
    """Command one place and report another one, for a second."""
    trips = []
    for now_ns in range(0, 1_000_000_000, 4_000_000):
        rule.stream(HERE, now_ns)
        trips.append(rule.judge(BEYOND, (0.0,) * 6, now_ns))
    return trips[-1]
