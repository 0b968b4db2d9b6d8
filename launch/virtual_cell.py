"""Virtual cell: the services of a simulated cell in one process on a virtual clock."""

from collections.abc import Callable

from common.bus.memory_bus import MemoryTransport
from common.config.cell import CellConfig
from common.runtime.service import HealthReporter, Runner, Service
from forcemesh.bus import Bus
from forcemesh.clock import NS_PER_S, ManualClock
from forcemesh.errors import ConfigError
from forcemesh.topics import CLIENT
from launch.controller_program import program_of
from services.arbiter.service import ArbiterService
from services.gateway.link import LinkEvents
from services.gateway.service import Gateway
from services.hub.service import Hub
from services.regulator.service import Regulator
from services.wrench.service import WrenchService
from sim.as_language.parser import parse
from sim.controller.network import LockStepLink, MemoryNetwork
from sim.controller.service import ControllerSensor
from sim.robot.arm import SimArm
from sim.robot.service import SimRobot

STEP_NS = 1_000_000
NOT_SIMULATED = "roles.sensor: only a simulated cell can run in lock step, so it must be sim"


class WorldClock:
    """Clock of the client: a sleep advances the virtual cell."""

    def __init__(self, world: "VirtualCell") -> None:
        """Bind to a cell."""
        self._world = world
        self.boot = world.clock.boot

    def now_ns(self) -> int:
        """Return the virtual time [ns]."""
        return self._world.clock.now_ns()

    def sleep_s(self, duration_s: float) -> None:
        """Advance virtual time."""
        self._world.advance(duration_s)


class VirtualCell:
    """Cell whose processes are stepped in turn each virtual millisecond."""

    def __init__(self, cell: CellConfig, transport: MemoryTransport | None = None) -> None:
        """Start all services at the same virtual instant; without a transport on a new bus."""
        self.cell = cell
        self.clock = ManualClock()
        self.transport = transport or MemoryTransport()
        self.transport.advance = self.advance
        self.client = Bus(CLIENT, cell.cell, self.transport, cell, WorldClock(self))
        self.runners: dict[str, Runner] = {}
        self.arm = self._add_controller() if cell.roles.robot == "gateway" else self._add_sim()
        for role, make in (
            ("hub", Hub),
            ("wrench", WrenchService),
            ("regulator", Regulator),
            ("arbiter", ArbiterService),
        ):
            bus = self._bus(role)
            self._add(role, make(bus, cell), bus)

    def _add_sim(self) -> SimArm:
        bus = self._bus("robot")
        robot = SimRobot(bus, self.cell)
        robot.driver.wake_ticks = 1  # an observer of the arm sees every tick
        self._add("robot", robot, bus, bus.playing("sensor"))
        return robot.arm

    def _add_controller(self) -> SimArm:
        """Add the real gateway on an in-memory wire to the emulated controller."""
        if self.cell.gateway is None or self.cell.roles.sensor != "sim":
            raise ConfigError(self.cell.cell, [NOT_SIMULATED])
        network, sensor_bus, bus = MemoryNetwork(), self._bus("sensor"), self._bus("robot")
        controller = ControllerSensor(sensor_bus, self.cell, network)
        program = program_of(self.cell)
        controller.machine.load(parse(program.text))
        controller.machine.pendant.monitor_speed(100.0)
        controller.machine.pendant.execute(program.start)
        self._add("sensor", controller, sensor_bus)
        wire = LockStepLink(network, self.cell.gateway.port, LinkEvents)
        self._add("robot", Gateway(bus, self.cell, wire), bus)
        return controller.arm

    def advance(self, duration_s: float, until: Callable[[], bool] = lambda: False) -> None:
        """Advance virtual time, at most until a condition holds."""
        end_ns = self.clock.now_ns() + round(duration_s * NS_PER_S)
        while self.clock.now_ns() < end_ns and not until():
            self.clock.advance_ns(STEP_NS)
            now_ns = self.clock.now_ns()
            for runner in list(self.runners.values()):
                runner.step(now_ns)

    def kill(self, role: str) -> None:
        """End a process: it is not stepped any more."""
        del self.runners[role]

    def _bus(self, role: str) -> Bus:
        return Bus(role, self.cell.cell, self.transport, self.cell, self.clock)

    def _add(self, role: str, service: Service, *buses: Bus) -> None:
        reporters = [HealthReporter(bus, self.cell) for bus in buses]
        self.runners[role] = Runner(service, reporters, self.clock)
