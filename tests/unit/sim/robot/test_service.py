"""Simulated robot as a service: when its messages are published."""

import pytest

from common.bus.memory_bus import MemoryTransport
from common.config.cell import CellConfig
from common.runtime.service import Runner
from common.runtime.stop import StopSignal
from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.clock import ManualClock
from sim.robot.driver import MOST_TICKS_PER_STEP, TICK_NS
from sim.robot.service import SimRobot
from tests.fakes.bench import CELL

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
