"""A whole simulated cell in one process on a virtual clock: the same services, faster than time."""

from collections.abc import Callable

from common.cell import Cell
from common.clock import NS_PER_S, ManualClock
from common.endpoints import Bus
from common.memory import MemoryTransport
from common.service import Runner, Service, reporter_of
from common.topics import CLIENT
from services.arbiter.service import ArbiterService
from services.hub.service import Hub
from services.regulator.service import Regulator
from services.wrench.service import WrenchService
from sim.robot.service import SimRobot

STEP_NS = 1_000_000


class WorldClock:
    """The client's clock: to sleep is to let the cell live on."""

    def __init__(self, world: "VirtualCell") -> None:
        """Belong to a cell."""
        self._world = world
        self.boot = world.clock.boot

    def now_ns(self) -> int:
        """Return the virtual time [ns]."""
        return self._world.clock.now_ns()

    def sleep_s(self, duration_s: float) -> None:
        """Let virtual time pass."""
        self._world.advance(duration_s)


class VirtualCell:
    """Every process of a cell, stepped in turn each virtual millisecond."""

    def __init__(self, cell: Cell) -> None:
        """Start all services at the same virtual instant."""
        self.cell = cell
        self.clock = ManualClock()
        self.transport = MemoryTransport()
        self.transport.advance = self.advance
        self.client = Bus(CLIENT, cell.cell, self.transport, cell, WorldClock(self))
        self.runners: dict[str, Runner] = {}
        robot_bus = self._bus("robot")
        self.robot = SimRobot(robot_bus, cell)
        self._add("robot", self.robot, robot_bus, robot_bus.playing("sensor"))
        for role, make in (
            ("hub", Hub),
            ("wrench", WrenchService),
            ("regulator", Regulator),
            ("arbiter", ArbiterService),
        ):
            bus = self._bus(role)
            self._add(role, make(bus, cell), bus)

    def advance(self, duration_s: float, until: Callable[[], bool] = lambda: False) -> None:
        """Let virtual time pass, at most until something is true."""
        end_ns = self.clock.now_ns() + round(duration_s * NS_PER_S)
        while self.clock.now_ns() < end_ns and not until():
            self.clock.advance_ns(STEP_NS)
            now_ns = self.clock.now_ns()
            for runner in list(self.runners.values()):
                if runner.due(now_ns):
                    runner.step(now_ns)

    def kill(self, role: str) -> None:
        """Let a process die: it is never stepped again."""
        del self.runners[role]

    def _bus(self, role: str) -> Bus:
        return Bus(role, self.cell.cell, self.transport, self.cell, self.clock)

    def _add(self, role: str, service: Service, *buses: Bus) -> None:
        reporters = [reporter_of(bus, self.cell) for bus in buses]
        self.runners[role] = Runner(service, reporters, self.clock)
