"""A controller that executes controller/fmprobe.as, and a PC in lock step with it."""

from collections.abc import Callable
from pathlib import Path

from cli.probe.link import ProbeLink
from forcemesh.clock import NS_PER_S
from sim.as_language.parser import parse
from sim.controller.behaviour import Behaviour
from sim.controller.machine import Machine
from sim.controller.network import MemoryNetwork, MemoryStream
from sim.robot.arm import SimArm
from sim.robot.settings import SimSettings

TEXT = (Path(__file__).resolve().parents[2] / "controller" / "fmprobe.as").read_text("ascii")
PORT = 49152
FREE = SimSettings(gap_m=0.1, delay_s=0.0)  # room below the tool
TICK_NS = 1_000_000
CHUNK = 65_536
STAGE_A_S = 60.0


class MemoryWire:
    """One connection to the controller, on its virtual clock."""

    def __init__(self, controller: "ProbedController") -> None:
        """Connect. Raises OSError."""
        self._controller = controller
        self._stream: MemoryStream = controller.network.dial(PORT)

    def now_s(self) -> float:
        """Return the virtual time [s]."""
        return self._controller.now_s()

    def wait(self, duration_s: float) -> None:
        """Advance the controller."""
        self._controller.advance(duration_s)

    def send(self, data: bytes) -> None:
        """Send bytes. Raises OSError."""
        self._stream.send(data)

    def receive(self, timeout_s: float) -> bytes:
        """Advance until there are bytes. Raises OSError at the end."""
        found: list[bytes] = []

        def came() -> bool:
            data = self._stream.receive(CHUNK)
            if data is not None:
                found.append(data)
            return data is not None

        self._controller.advance(timeout_s, came)
        if found == [b""]:
            raise ConnectionError("closed by the controller")
        return b"".join(found)

    def close(self) -> None:
        """Close the connection."""
        self._stream.close()

    def reset(self) -> None:
        """Abort the connection."""
        self._stream.reset()


class ProbedController:
    """A controller with fmprobe.as loaded and started, after stage a."""

    def __init__(
        self, behaviour: Behaviour, *, speed_percent: float = 50.0, text: str = TEXT
    ) -> None:
        """Switch on, load, set the monitor speed, EXECUTE, wait for the end of stage a."""
        self.printed: list[str] = []
        self.network = MemoryNetwork()
        self.machine = Machine(
            SimArm(FREE, seed=0), self.network, behaviour=behaviour, print_line=self.printed.append
        )
        self.machine.load(parse(text))
        self.machine.pendant.monitor_speed(speed_percent)
        self.machine.pendant.execute("fp.main")
        self.advance(STAGE_A_S, lambda: "stage.a  1" in self.printed)

    def advance(self, duration_s: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Advance by a time, or until a condition is true; return whether it came true."""
        end_ns = self.machine.now_ns + round(duration_s * NS_PER_S)
        while self.machine.now_ns < end_ns:
            self.machine.advance(min(self.machine.now_ns + TICK_NS, end_ns))
            if until():
                return True
        return False

    def permit_motion(self) -> None:
        """Type fp.ok=1 on the terminal."""
        self.machine.memory.write("fp.ok", 1)

    def link(self) -> ProbeLink:
        """Connect as `forcemesh probe` does."""
        return ProbeLink(lambda: MemoryWire(self), "the controller", self.wait, self.now_s)

    def now_s(self) -> float:
        """Return the virtual time [s]."""
        return self.machine.now_ns / NS_PER_S

    def wait(self, duration_s: float) -> None:
        """Advance by a time."""
        self.advance(duration_s)
