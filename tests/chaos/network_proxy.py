"""Network faults by a proxy between gateway and controller, for faults the kernel cannot create.

Delay, jitter, split and merged writes; on loopback, so no namespace is needed.
"""

import random
import tempfile
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path

from launch.processes import EMULATOR, processes_of
from tests.chaos.common_net import free_port, make_cell
from tests.chaos.network_faults import Ends
from tests.chaos.network_judge import TrialBounds
from tests.chaos.network_trials import CABLE, NetworkTrial, Row, bounds_of, is_selected, played
from tests.chaos.tcp_proxy import HostileProxy
from tests.fakes.hostile_stream import MS, Abuse, Chop, Gather

DIRECTIONS = ("to_controller", "to_gateway")
LASTS_S = 2.0


@dataclass
class Delay(Abuse):
    """In-order delay: a fixed time plus a random part per read."""

    by_ns: int = 0
    jitter_ns: int = 0
    rng: random.Random = field(default_factory=lambda: random.Random(1))
    _in_transit: deque[tuple[int, bytes]] = field(default_factory=deque)

    def pass_on(self, waiting: bytearray, now_ns: int) -> list[bytes]:
        """Return the data that is due; a bite is a delayed read."""
        if waiting:
            due_ns = now_ns + self.by_ns + self.rng.randint(0, self.jitter_ns)
            self._in_transit.append((due_ns, bytes(waiting)))
            self.bites += due_ns > now_ns
            waiting.clear()
        pieces = []
        while self._in_transit and self._in_transit[0][0] <= now_ns:
            pieces.append(self._in_transit.popleft()[1])
        return pieces

    def heal(self) -> None:
        """Stop delaying; data already in transit keeps its due time."""
        self.by_ns = self.jitter_ns = 0


# Name: fault of a direction, and expected result.
ABUSES: dict[str, tuple[Callable[[], Abuse], Ends]] = {
    "delay-10": (lambda: Delay(by_ns=10 * MS), "either"),
    "delay-400": (lambda: Delay(by_ns=400 * MS), "held"),
    "jitter-40": (lambda: Delay(jitter_ns=40 * MS), "either"),
    "half-writes": (lambda: Chop(size=31), "either"),
    "merged-writes": (lambda: Gather(size=255, wait_ns=20 * MS), "either"),
}


def through_proxy(only: str, seed: int) -> Iterator[Row]:
    """Run all proxy faults between gateway and controller."""
    with ExitStack() as exits:
        folder = Path(exits.enter_context(tempfile.TemporaryDirectory(prefix="forcemesh-chaos-")))
        port = free_port()
        proxy = exits.enter_context(HostileProxy(lambda: port))
        overrides = {"cell": "chaos-proxy", "gateway.port": proxy.port}
        cell, path = make_cell("demo-tcp", folder, overrides)
        processes = [
            replace(process, arguments=(*process.arguments, "--port", str(port)))
            if process.module == EMULATOR
            else process
            for process in processes_of(cell)
        ]
        bounds = bounds_of(cell, is_cable=True)
        trials = [trial_of(name, proxy, bounds) for name in ABUSES]
        trials = [trial for trial in trials if is_selected(trial, only)]
        yield from played("demo-tcp", cell, path, processes=processes, trials=trials, seed=seed)


def trial_of(name: str, proxy: HostileProxy, bounds: TrialBounds) -> NetworkTrial:
    """Return one proxy fault on both directions."""
    make, ends = ABUSES[name]
    struck: list[Abuse] = []

    def begin() -> None:
        struck[:] = [proxy.strike(direction, make()) for direction in DIRECTIONS]

    def end() -> int:
        for direction, abuse in zip(DIRECTIONS, struck, strict=True):
            if isinstance(abuse, Delay):
                abuse.heal()
            else:
                proxy.strike(direction, Abuse())
        return sum(abuse.bites for abuse in struck)

    return NetworkTrial(CABLE, name, begin, end, LASTS_S, ends, bounds)
