"""The emulated controller with plain.as on a real TCP port, on the clock of the test."""

from collections.abc import Callable
from functools import cache
from typing import Any

from controller.plain import PROGRAM, START
from forcemesh.clock import NS_PER_S
from sim.as_language.parser import parse
from sim.as_language.syntax import SourceFile
from sim.controller.behaviour import Behaviour
from sim.controller.machine import Machine
from sim.controller.network import MemoryNetwork, SocketNetwork
from sim.robot.arm import SimArm
from sim.robot.settings import SimSettings
from tests.chaos.common_net import free_port

TEXT = PROGRAM.read_text(encoding="ascii")
PORT = 49152  # of the program; the real one is any free port
# It stops with E1117 (process time over) where a motion is too short to be planned.
QUICK = Behaviour(step_s=1e-4, least_segment_s=0.03, least_speed_m_s=0.0012)
TICK_NS = 1_000_000


@cache
def parsed(text: str) -> SourceFile:
    """The program, read once."""
    return parse(text)


class PlainController:
    """A controller in REPEAT at full monitor speed, whose pl.main runs; no client is connected."""

    def __init__(
        self,
        text: str = TEXT,
        behaviour: Behaviour = QUICK,
        *,
        memory: MemoryNetwork | None = None,
        prepare: Callable[[Machine], None] = lambda _: None,
        **sim: Any,
    ) -> None:
        """Switch on, load, EXECUTE; `sim` are settings of the arm and of the plate below it.

        `memory` replaces the sockets; `prepare` is called before EXECUTE.
        """
        self.printed: list[str] = []
        self.network = SocketNetwork(port=free_port())
        self.arm = SimArm(SimSettings(**{"delay_s": 0.0, **sim}), seed=0)
        self.machine = Machine(
            self.arm, memory or self.network, behaviour=behaviour, print_line=self.printed.append
        )
        self.machine.load(parsed(text))
        self.machine.pendant.monitor_speed(100.0)
        prepare(self.machine)
        self.machine.pendant.execute(START)
        listening = self.network.bound if memory is None else memory.listeners
        self.until(lambda: PORT in listening)

    @property
    def port(self) -> int:
        """The real port."""
        return self.network.bound[PORT]

    def advance(self, duration_s: float) -> None:
        """Advance the controller."""
        self.machine.advance(self.machine.now_ns + round(duration_s * NS_PER_S))

    def until(self, condition: Callable[[], object], within_s: float = 10.0) -> None:
        """Advance until a condition is true; fail after `within_s`."""
        end_ns = self.machine.now_ns + round(within_s * NS_PER_S)
        while not condition():
            assert self.machine.now_ns < end_ns, f"not in {within_s} s; stops {self.machine.stops}"
            self.machine.advance(self.machine.now_ns + TICK_NS)

    def wrench(self) -> tuple[list[float], list[float]]:
        """Return force [N] and torque [N m] of the environment: base axes, about the TCP."""
        true = self.arm.true_wrench()
        return true.force_N.tolist(), true.torque_Nm.tolist()

    def value(self, name: str) -> Any:
        """Return the value of a global variable."""
        return self.machine.memory.read(name)

    def close(self) -> None:
        """Switch off."""
        self.machine.tcp.close_all()
