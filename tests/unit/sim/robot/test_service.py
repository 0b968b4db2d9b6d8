"""Simulated robot as a service: when its messages are published."""

import random
from collections.abc import Callable
from operator import methodcaller

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.bus.memory_bus import MemoryTransport
from common.config.cell import CellConfig
from common.motion.convert import record_of
from common.runtime.service import Runner
from common.runtime.stop import StopSignal
from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.clock import ManualClock
from forcemesh.messages import Goal, Speed
from sim.robot.arm import SimArm
from sim.robot.driver import MOST_TICKS_PER_STEP, TICK_NS, SimDriver
from sim.robot.service import SimRobot
from sim.robot.settings import SimSettings
from tests.fakes.bench import CELL, cell_with

STATE_TICKS = 8
SLOW_CELL = CellConfig.model_validate(
    {**CELL.model_dump(), "rates": {**CELL.rates.model_dump(), "robot_hz": 125, "sensor_hz": 125}}
)


class PublishTimes:
    """A robot in its own loop on a virtual clock, and when it published its states."""

    def __init__(self, loop_begins_ns: int = 0) -> None:
        """Build the robot; its loop begins this much later."""
        self.clock, transport = ManualClock(), MemoryTransport()
        self.start_ns = self.clock.now_ns()
        self.robot = SimRobot(Bus("robot", CELL.cell, transport, SLOW_CELL, self.clock), SLOW_CELL)
        self.robot.trigger.wait = self.clock.sleep_s  # type: ignore[method-assign,assignment]
        client = Bus(topics.CLIENT, CELL.cell, transport, SLOW_CELL, self.clock)
        self._state = client.reader(topics.ROBOT_STATE)
        self.clock.advance_ns(loop_begins_ns)

    def offsets_ns(self, count: int) -> list[int]:
        """Return how long after a multiple of its period each message was published [ns]."""
        stop, step = StopSignal(), self.robot.step
        published_ns: list[int] = []

        def noted(now_ns: int) -> None:
            step(now_ns)
            if self._state.poll():
                published_ns.append(now_ns)
            if len(published_ns) >= count:
                stop.set()

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(self.robot, "step", noted)
            Runner(self.robot, [], self.clock).run(stop)
        return [(at - self.start_ns) % (STATE_TICKS * TICK_NS) for at in published_ns]


@pytest.mark.parametrize("stall_ms", [3, 9, 25, 41, 57, 131])
def test_a_state_is_published_at_its_tick_after_a_stall(stall_ms: int) -> None:
    """Time that was dropped moves the ticks by whole ticks, and the messages with them."""
    run = PublishTimes()
    run.offsets_ns(3)
    run.clock.advance_ns(stall_ms * TICK_NS)
    offsets_ns = run.offsets_ns(5)[1:]
    lost = run.robot.counters()["ticks_lost"]
    assert (lost > 0) == (stall_ms > MOST_TICKS_PER_STEP)
    assert offsets_ns == [lost * TICK_NS % (STATE_TICKS * TICK_NS)] * 4


@pytest.mark.parametrize(
    ("robot_hz", "sensor_hz", "control_hz", "wake_ticks"),
    [
        (250, 500, 250, 4),  # two samples at a time
        (250, 1000, 250, 4),
        (250, 1000, 500, 1),  # no sample waits for longer than a control period
        (500, 250, 250, 2),
        (125, 125, 125, 8),
        (10, 50, 10, 20),  # a robot makes up so many ticks and no more
        (200, 500, 200, 1),  # the reports have no common tick with the samples
    ],
)
def test_samples_are_published_with_the_report_and_the_times_of_their_ticks(
    robot_hz: float, sensor_hz: float, control_hz: float, wake_ticks: int
) -> None:
    """All of them, in order, once each; a sample waits for a control period at most."""
    cell = cell_with(
        rates__robot_hz=robot_hz, rates__sensor_hz=sensor_hz, rates__control_hz=control_hz
    )
    clock, transport = ManualClock(), MemoryTransport()
    robot = SimRobot(Bus("robot", cell.cell, transport, cell, clock), cell)
    assert robot.driver.wake_ticks == wake_ticks
    client, began_ns = Bus(topics.CLIENT, cell.cell, transport, cell, clock), clock.now_ns()
    samples, runner = client.reader(topics.SENSOR_WRENCH, 100), Runner(robot, [], clock)
    offsets_ns = list[int]()
    for _ in range(40):
        clock.advance_ns(TICK_NS)
        if runner.step(clock.now_ns()):
            found = samples.readings(clock.now_ns())
            stamps_ns = [header.stamp_ns for each in found if (header := each.header) is not None]
            fresh_ns = [each for each in stamps_ns if each - began_ns > max(offsets_ns, default=0)]
            assert all(clock.now_ns() - each <= 1e9 / control_hz for each in fresh_ns)
            offsets_ns += [each - began_ns for each in fresh_ns]
    period_ns = round(1e9 / sensor_hz)
    assert offsets_ns == [*range(period_ns, 40 * TICK_NS + 1, period_ns)]


def test_the_times_of_samples_increase_also_after_a_late_step() -> None:
    """A reader divides by them, and takes none for a repetition or a jump."""
    clock, transport = ManualClock(), MemoryTransport()
    robot = SimRobot(Bus("robot", CELL.cell, transport, CELL, clock), CELL)
    client, runner = Bus(topics.CLIENT, CELL.cell, transport, CELL, clock), Runner(robot, [], clock)
    samples, stamps_ns = client.reader(topics.SENSOR_WRENCH, 100), list[int]()
    for wait_ms in (4.0, 6.5, 1.5, 4.0, 30.0, 2.0, 4.0, 4.0):
        clock.advance_ns(round(wait_ms * TICK_NS))
        runner.step(clock.now_ns())
        headers = [each.header for each in samples.readings(clock.now_ns())]
        stamps_ns += [header.stamp_ns for header in headers if header is not None]
    apart_ns = np.diff(sorted(set(stamps_ns)))
    assert len(apart_ns) >= 24
    assert apart_ns.min() >= TICK_NS // 2


def test_samples_go_out_also_from_a_step_that_breaks_off() -> None:
    """The sensor is a role of its own, and nothing piles up."""
    clock, transport = ManualClock(), MemoryTransport()
    robot = SimRobot(Bus("robot", CELL.cell, transport, CELL, clock), CELL)
    samples = Bus(topics.CLIENT, CELL.cell, transport, CELL, clock).reader(topics.SENSOR_WRENCH)
    robot.driver.signals = lambda: 1 / 0  # type: ignore[method-assign,assignment,return-value]
    clock.advance_ns(4 * TICK_NS)
    with pytest.raises(ZeroDivisionError):
        robot.step(clock.now_ns())
    assert samples.poll()


Action = Callable[[SimDriver], object]


def commanded(wake_ticks: int, actions: dict[int, Action], ticks: int) -> list[list[float]]:
    """Return the commanded joint angles of each tick of a driver [rad].

    Args:
        wake_ticks: Of the driver.
        actions: What happens to it at a tick.
        ticks: How long it runs.
    """
    driver, found = SimDriver(CELL, 0), list[list[float]]()
    driver.wake_ticks = wake_ticks
    driver.after_tick.append(lambda: found.append(driver.arm.q_command.tolist()))
    for tick in range(1, ticks + 1):
        if tick in actions or tick % wake_ticks == 0:
            driver.receive(tick * TICK_NS)
            actions.get(tick, lambda _: None)(driver)
            driver.report()
    return found


@settings(max_examples=40)
@given(
    at=st.sets(st.integers(1, 60), min_size=1, max_size=12),
    seed=st.integers(0, 2**32 - 1),
    wake_ticks=st.sampled_from([2, 4, 8]),
)
def test_a_command_acts_from_the_tick_of_its_arrival(
    at: set[int], seed: int, wake_ticks: int
) -> None:
    """Whenever the physics runs: as in a robot that wakes at each tick."""
    draw, T = random.Random(seed), SimArm(SimSettings.of(CELL), seed=0).T_base_flange
    kinds, actions = [draw.choice("ssssgh") for _ in at], dict[int, Action]()
    for tick, kind in zip(sorted(at), kinds, strict=True):
        shift_m = np.array([draw.uniform(-4e-4, 4e-4) for _ in range(3)])
        goal = pin.SE3(T.rotation, T.translation + shift_m)
        record = Goal(id=tick, kind="pose", pose=record_of(goal))
        actions[tick] = {
            "s": methodcaller("stream", goal, begins=False),
            "g": methodcaller("goal", record, Speed()),
            "h": methodcaller("hold", begins=True),
        }[kind]
    fine, coarse = commanded(1, actions, 64), commanded(wake_ticks, actions, 64)
    assert np.array(coarse) == pytest.approx(np.array(fine), abs=1e-9)


def test_a_set_point_right_after_a_goal_is_followed() -> None:
    """The goal may have ended since the last wake-up."""
    T = SimArm(SimSettings.of(CELL), seed=0).T_base_flange
    near = pin.SE3(T.rotation, T.translation + np.array([0.0, 0.0, 1e-5]))
    goal = Goal(id=1, kind="pose", pose=record_of(near))
    driver = SimDriver(CELL, 0)
    driver.wake_ticks = 8
    for tick in (1, 7):
        driver.receive(tick * TICK_NS)
        if tick == 1:
            assert driver.goal(goal, Speed()) == ""
        else:
            assert driver.explains_motion  # as far as is known
            assert driver.stream(T, begins=False) is None
        driver.report()
