"""One processor for all tasks: a step of each in turn, and a robot that moves each millisecond.

Every step costs the same processor time. A task that waits (TWAIT, WAIT, SWAIT, TCP_*, a motion)
costs nothing; what it waits for is looked at every millisecond. When nobody has anything to do,
time passes. The time is the caller's: `advance` goes up to a moment and stops.
"""

from collections.abc import Callable, Sequence

from forcemesh.clock import NS_PER_S
from sim.controller.behaviour import Behaviour
from sim.controller.task import Task
from sim.robot.settings import TICK_S

TICK_NS = round(TICK_S * NS_PER_S)
MOST_TICKS_BEHIND = 50  # a process that was held up longer loses time instead of racing


class Scheduler:
    """Gives processor time to tasks and the tick to the robot."""

    def __init__(
        self,
        tasks: Sequence[Task],
        tick: Callable[[], None],
        behaviour: Behaviour,
        *,
        now_ns: int,
    ) -> None:
        """Start at a moment; `tick` is called every millisecond after it."""
        self._tasks = tasks
        self._tick = tick
        self._step_ns = behaviour.step_ns
        self._next_tick_ns = now_ns + TICK_NS
        self._stalled_until_ns = 0
        # From whose turn it is on: each task once, with whose turn it is behind it.
        count = len(tasks)
        self._orders = tuple(
            tuple((tasks[(first + k) % count], (first + k + 1) % count) for k in range(count))
            for first in range(count)
        )
        self._turn = 0
        self.current = tasks[0]  # whose step is being executed
        self.now_ns = now_ns
        self.steps = 0
        self.ns_lost = 0
        self._offset_ns = 0  # of the real clock before the controller's

    def stall(self, duration_s: float) -> None:
        """Let no task make a step for a while: the processor plans a motion."""
        self._stalled_until_ns = self.now_ns + round(duration_s * NS_PER_S)

    def skip_to(self, clock_ns: int) -> None:
        """Let a moment of a real clock be now: what passed before, loading a file, is not lost."""
        self._offset_ns = clock_ns - self.now_ns

    def advance(self, until_ns: int) -> None:
        """Let time pass up to a moment, in lock step with it."""
        while self.now_ns < until_ns:
            self._round(until_ns)

    def catch_up(self, clock_ns: int) -> None:
        """Let time pass up to a real clock's moment; long delays are not made up for."""
        behind_ns = clock_ns - self._offset_ns - self.now_ns
        lost_ns = max(0, behind_ns - MOST_TICKS_BEHIND * TICK_NS)
        self.ns_lost += lost_ns
        self._offset_ns += lost_ns
        self.advance(clock_ns - self._offset_ns)

    def _round(self, until_ns: int) -> None:
        """Give every task that can go on one step; none can: let time pass to the next tick."""
        idle, step_ns = True, self._step_ns
        if self.now_ns >= self._stalled_until_ns:
            for task, next_turn in self._orders[self._turn]:
                if not task.ready:
                    continue
                idle, self.current = False, task
                task.step()
                self.steps += 1
                self.now_ns += step_ns
                while self.now_ns >= self._next_tick_ns:
                    self._pass_tick()
                if self.now_ns >= until_ns:
                    self._turn = next_turn
                    return
        if idle:
            self.now_ns = min(self._next_tick_ns, until_ns)
            while self.now_ns >= self._next_tick_ns:
                self._pass_tick()

    def _pass_tick(self) -> None:
        self._next_tick_ns += TICK_NS
        self._tick()
        for task in self._tasks:
            if task.waiting:
                self.current = task
                task.look(self.now_ns)
