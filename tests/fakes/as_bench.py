"""An emulated controller on a virtual clock, for tests of AS snippets."""

from collections.abc import Callable
from typing import Any

from forcemesh.clock import NS_PER_S
from sim.as_language.errors import AsError
from sim.as_language.parser import parse
from sim.controller.behaviour import Behaviour
from sim.controller.hardware import Robot
from sim.controller.machine import Machine
from sim.controller.network import MemoryNetwork
from sim.controller.tasks import Task
from sim.robot.arm import SimArm
from sim.robot.settings import SimSettings

FREE = SimSettings(gap_m=0.1, delay_s=0.0)  # room below the tool
FAST = Behaviour(step_s=2e-5)


class AsBench:
    """A controller with motors on, in REPEAT, at full monitor speed, with a loaded program."""

    def __init__(self, source: str, behaviour: Behaviour = FAST) -> None:
        self.printed: list[str] = []
        self.network = MemoryNetwork()
        arm, note = SimArm(FREE, seed=0), self.printed.append
        self.machine = Machine(arm, self.network, behaviour=behaviour, print_line=note)
        self.machine.load(parse(source))
        self.pendant = self.machine.pendant
        self.pendant.monitor_speed(100.0)

    @property
    def robot(self) -> Robot:
        """The arm of the controller."""
        return self.machine.robot

    @property
    def task(self) -> Task:
        """The robot program."""
        return self.machine.robot_task

    @property
    def stopped_at(self) -> tuple[str, int]:
        """Program and step where the robot program stopped by an error."""
        assert self.task.stop is not None, "no error stopped the program"
        return self.task.stop.program, self.task.stop.step

    @property
    def codes(self) -> list[str]:
        """Codes of the errors so far."""
        return [stop.error.code for stop in self.machine.stops]

    def value(self, name: str) -> Any:
        """Return the value of a global variable."""
        return self.machine.memory.read(name)

    def start(self, program: str = "main", cycles: int = 1) -> "AsBench":
        """Execute EXECUTE."""
        self.pendant.execute(program, cycles=cycles)
        return self

    def advance(self, duration_s: float, until: Callable[[], object] = lambda: False) -> bool:
        """Advance by a time; return whether a condition came true in it."""
        end_ns = self.machine.now_ns + round(duration_s * NS_PER_S)
        while self.machine.now_ns < end_ns:
            self.machine.advance(min(self.machine.now_ns + 1_000_000, end_ns))
            if until():
                return True
        return False

    def run(self, program: str = "main", limit_s: float = 20.0) -> "AsBench":
        """Execute EXECUTE and wait until the robot program ends without an error."""
        self.start(program)
        over = self.advance(limit_s, lambda: self.task.state in ("idle", "stopped"))
        assert not self.machine.stops, str(self.machine.stops[-1])
        assert over, f"still {self.task.state} after {limit_s} s"
        return self

    def fail(self, program: str = "main", limit_s: float = 20.0) -> AsError:
        """Execute EXECUTE and wait for the error that stops the robot program."""
        self.start(program)
        assert self.advance(limit_s, lambda: self.task.state in ("idle", "stopped"))
        assert self.task.stop is not None, "no error stopped the program"
        return self.task.stop.error


def program(*lines: str, name: str = "main") -> str:
    """Return a program of these steps."""
    return "\n".join([f".PROGRAM {name}()", *lines, ".END", ""])
