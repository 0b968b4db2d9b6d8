"""Round-robin scheduler: one processor for all tasks, one step each, and a robot tick every ms.

Every step costs the same processor time. A waiting task (TWAIT, WAIT, SWAIT, TCP_*, a motion)
costs nothing; its condition is polled every millisecond. If no task is ready, time advances to the
next tick. The caller controls time: `advance` runs up to a given time and stops.
"""

from collections.abc import Callable, Sequence

from forcemesh.clock import NS_PER_S
from sim.controller.hardware import Hardware
from sim.controller.tasks import Task
from sim.robot.settings import TICK_S

TICK_NS = round(TICK_S * NS_PER_S)
MOST_TICKS_BEHIND = 50  # a process delayed for longer drops time instead of catching up


class Scheduler:
    """Allocates processor time to tasks and calls the robot tick."""

    def __init__(self, tasks: Sequence[Task], hardware: Hardware, tick: Callable[[], None]) -> None:
        """Start at the time of the hardware; `tick` is called every millisecond after it."""
        self._tasks = tasks
        self._hardware = hardware
        self._tick = tick
        self._step_ns = hardware.behaviour.step_ns
        self._next_tick_ns = hardware.now_ns + TICK_NS
        # For each first task: all tasks in order, each with the index of its successor.
        count = len(tasks)
        self._orders = tuple(
            tuple((tasks[(first + k) % count], (first + k + 1) % count) for k in range(count))
            for first in range(count)
        )
        self._next_order = 0
        self.steps = 0
        self.ns_lost = 0
        self._offset_ns = 0  # real clock minus controller time

    def skip_to(self, clock_ns: int) -> None:
        """Set the real clock equal to controller time: time before, as for loading, is not lost."""
        self._offset_ns = clock_ns - self._hardware.now_ns

    def advance(self, until_ns: int) -> None:
        """Advance to `until_ns` in lock step."""
        while self._hardware.now_ns < until_ns:
            self._round(until_ns)

    def catch_up(self, clock_ns: int) -> None:
        """Advance to a time of the real clock; long delays are dropped."""
        behind_ns = clock_ns - self._offset_ns - self._hardware.now_ns
        lost_ns = max(0, behind_ns - MOST_TICKS_BEHIND * TICK_NS)
        self.ns_lost += lost_ns
        self._offset_ns += lost_ns
        self.advance(clock_ns - self._offset_ns)

    def _round(self, until_ns: int) -> None:
        """Execute one step of every ready task; without any, advance to the next tick."""
        hardware, step_ns, idle = self._hardware, self._step_ns, True
        if hardware.now_ns >= hardware.stalled_until_ns:
            for task, next_order in self._orders[self._next_order]:
                if not task.ready:
                    continue
                idle = False
                task.step()
                self.steps += 1
                hardware.now_ns += step_ns
                if hardware.now_ns >= self._next_tick_ns:
                    self._pass_ticks()
                if hardware.now_ns >= until_ns:
                    self._next_order = next_order
                    return
        if idle:
            hardware.now_ns = min(self._next_tick_ns, until_ns)
            self._pass_ticks()

    def _pass_ticks(self) -> None:
        hardware = self._hardware
        while hardware.now_ns >= self._next_tick_ns:
            self._next_tick_ns += TICK_NS
            self._tick()
            for task in self._tasks:
                if task.waiting:
                    task.check_wait(hardware.now_ns)
