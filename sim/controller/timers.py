"""TIMER 1 to 10: seconds since a program set them. TIMER 0 is the time since power-on."""

from forcemesh.clock import NS_PER_S
from sim.controller.behaviour import Behaviour

TIMERS = range(11)


class Timers:
    """All timers run from power-on."""

    def __init__(self, behaviour: Behaviour, *, now_ns: int) -> None:
        """Start all of them at zero."""
        self._behaviour = behaviour
        self._zero_ns = [now_ns for _ in TIMERS]

    def read_s(self, number: int, now_ns: int) -> float:
        """Return a timer [s]."""
        return self._behaviour.timer_s((now_ns - self._zero_ns[number]) / NS_PER_S)

    def write_s(self, number: int, value_s: float, now_ns: int) -> None:
        """Set a timer [s]."""
        self._zero_ns[number] = now_ns - round(value_s * NS_PER_S)
