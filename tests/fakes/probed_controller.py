"""A controller that executes controller/fmprobe.as, and a PC in lock step with it."""

from pathlib import Path

from cli.probe.link import ProbeLink
from forcemesh.clock import NS_PER_S
from sim.controller.behaviour import Behaviour
from sim.controller.network import MemoryNetwork, MemoryStream
from tests.fakes.controller import PORT, RunningController

TEXT = (Path(__file__).resolve().parents[2] / "controller" / "fmprobe.as").read_text("ascii")
CHUNK = 65_536
STAGE_A_S = 60.0


class MemoryWire:
    """One connection to the controller, on its virtual clock."""

    def __init__(self, controller: "ProbedController") -> None:
        """Connect. Raises OSError."""
        self._controller = controller
        assert isinstance(controller.network, MemoryNetwork)
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


class ProbedController(RunningController):
    """A controller with fmprobe.as loaded and started, after stage a."""

    def __init__(
        self, behaviour: Behaviour, *, speed_percent: float = 50.0, text: str = TEXT
    ) -> None:
        """Wait for the end of stage a."""
        super().__init__(text, "fp.main", behaviour=behaviour, speed_percent=speed_percent)
        self.advance(STAGE_A_S, lambda: "stage.a  1" in self.printed)

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
