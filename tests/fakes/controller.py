"""The emulated controller that executes a program: on the clock of a test, or in real time."""

import threading
import time
from collections.abc import Callable
from functools import cache
from typing import Any

from forcemesh.clock import NS_PER_S
from sim.as_language.parser import parse
from sim.as_language.syntax import SourceFile
from sim.controller.behaviour import Behaviour
from sim.controller.machine import Machine
from sim.controller.network import MemoryNetwork, Network, SocketNetwork
from sim.robot.arm import SimArm
from sim.robot.settings import SimSettings

PORT = 49152  # of the programs; on sockets the real one is any free port
QUICK = Behaviour(step_s=1e-4)
TICK_NS = 1_000_000


@cache
def parsed(text: str) -> SourceFile:
    """The program, read once."""
    return parse(text)


class RunningController:
    """A controller in REPEAT whose robot program was started; a network in memory by default.

    As a context it runs in real time, in a thread, until the context ends.
    """

    def __init__(
        self,
        text: str,
        start: str = "fm.main",
        *,
        behaviour: Behaviour = QUICK,
        network: Network | None = None,
        speed_percent: float = 100.0,
        prepare: Callable[[Machine], None] | None = None,
        **sim: Any,
    ) -> None:
        """Switch on, load, set the monitor speed, EXECUTE.

        `sim` are settings of the arm and of what is below it; `prepare` is called before EXECUTE.
        """
        self.printed: list[str] = []
        self.network = network or MemoryNetwork()
        self.arm = SimArm(SimSettings(**{"gap_m": 0.1, "delay_s": 0.0, **sim}), seed=0)
        self.machine = Machine(
            self.arm, self.network, behaviour=behaviour, print_line=self.printed.append
        )
        self.machine.load(parsed(text))
        self.machine.pendant.monitor_speed(speed_percent)
        if prepare is not None:
            prepare(self.machine)
        self.machine.pendant.execute(start)
        self.is_frozen = False  # in real time: its sockets stay open
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    @property
    def port(self) -> int:
        """The real port of the program's socket."""
        assert isinstance(self.network, SocketNetwork)
        bound = self.network.bound
        assert self.advance(10.0, lambda: PORT in bound)
        return bound[PORT]

    def value(self, name: str) -> Any:
        """Return the value of a global variable."""
        return self.machine.memory.read(name)

    def advance(self, duration_s: float, until: Callable[[], object] = lambda: False) -> bool:
        """Advance by a time, or until a condition is true; return whether it came true."""
        end_ns = self.machine.now_ns + round(duration_s * NS_PER_S)
        while not until():
            if self.machine.now_ns >= end_ns:
                return False
            self.machine.advance(min(self.machine.now_ns + TICK_NS, end_ns))
        return True

    # --- in real time -----------------------------------------------------------------------------

    def __enter__(self) -> "RunningController":
        assert self.port
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self.machine.tcp.close_all()

    def _run(self) -> None:
        self.machine.skip_to(time.monotonic_ns())
        while not self._stop.wait(0.001):
            if not self.is_frozen:
                self.machine.catch_up(time.monotonic_ns())

    def wait_for(self, condition: Callable[[], object], timeout_s: float = 5.0) -> bool:
        """Wait in real time; return whether the condition came true."""
        end_s = time.monotonic() + timeout_s
        while not condition() and time.monotonic() < end_s:
            time.sleep(0.002)
        return bool(condition())
