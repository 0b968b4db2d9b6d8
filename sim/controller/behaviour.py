"""Behaviour of the emulated controller where the manuals are ambiguous.

Each field is one open question. The defaults are the interpretation that public AS programs rely
on; `pessimistic` selects the worse one of each. A program that passes with both is independent of
the answers.
"""

import math
from dataclasses import dataclass

from common.config.cell_sim import SimSection

SHORTEST_STEP_S = 1e-6
DEFAULT_STEP_S = 0.0005


@dataclass(frozen=True, slots=True)
class Behaviour:
    """Interpreter speed and the answers to the open questions."""

    step_s: float = DEFAULT_STEP_S  # one AS step of one task; all tasks share one processor
    whole_second_timeouts: bool = False  # a TCP time-out of 0.2 s becomes 1 s
    brake_keeps_prefetched: bool = False  # the motion queued behind the braked one starts
    timer_grain_s: float = 0.0  # resolution of TIMER
    send_ignores_timeout: bool = False  # TCP_SEND waits forever for a peer that does not read
    planning_stall_s: float = 0.0  # no task executes a step while the robot program plans
    stall_at_motions: tuple[int, ...] = ()  # motions of a run with a stall, counted from 1

    def __post_init__(self) -> None:
        """Raise ValueError for a step time out of range."""
        if not SHORTEST_STEP_S <= self.step_s <= 1.0:
            raise ValueError(f"step time is {self.step_s:g} s, must be within 1e-6 .. 1 s")

    def timeout_s(self, asked_s: float) -> float:
        """Return the effective time-out of a TCP instruction [s]."""
        if self.whole_second_timeouts:
            return float(max(1, math.ceil(asked_s)))
        return max(0.0, asked_s)

    def timer_s(self, elapsed_s: float) -> float:
        """Return the reading of TIMER after an elapsed time [s]."""
        if self.timer_grain_s <= 0.0:
            return elapsed_s
        return math.floor(elapsed_s / self.timer_grain_s + 1e-9) * self.timer_grain_s


def pessimistic(step_s: float = DEFAULT_STEP_S) -> Behaviour:
    """Return the pessimistic answer to every open question, with the given step time."""
    return Behaviour(
        step_s=step_s,
        whole_second_timeouts=True,
        brake_keeps_prefetched=True,
        timer_grain_s=0.016,
        send_ignores_timeout=True,
        planning_stall_s=1.0,
        stall_at_motions=(1,),
    )


def behaviour_in(sim: SimSection) -> Behaviour:
    """Return the behaviour of the emulated controller of a simulated cell."""
    return (pessimistic if sim.as_pessimistic else Behaviour)(step_s=sim.as_step_s)
