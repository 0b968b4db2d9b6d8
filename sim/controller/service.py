"""Emulated controller of a cell: drives the simulated arm, and owns the sensor on it.

The gateway connects to it over TCP. Sensor samples are published on the bus, as by sim.robot, or
sent to the driver over RDT, as by a real sensor.
"""

from common.config.cell import CellConfig
from forcemesh.bus import Bus
from forcemesh.clock import NS_PER_S, Clock
from forcemesh.errors import SimulationError
from sim.controller.behaviour import Behaviour, behaviour_in
from sim.controller.machine import Machine
from sim.controller.network import Network
from sim.netft.feed import RdtFeed
from sim.netft.server import NetftServer
from sim.robot.arm import SimArm
from sim.robot.service import SensorFeed
from sim.robot.settings import TICK_S, SimSettings
from sim.robot.signals import followed_numbers
from sim.robot.trace import trace_from_environment


class EmulatedController:
    """Service that advances the controller to the clock in each step."""

    def __init__(
        self,
        clock: Clock,
        cell: CellConfig,
        network: Network,
        *,
        behaviour: Behaviour | None = None,
    ) -> None:
        """Build the arm of this cell and its controller, without programs.

        Raises SimulationError if the cell has no simulated arm.
        """
        if cell.sim is None:
            raise SimulationError("the cell file has no section `sim`: no simulated arm")
        self.period_s = TICK_S
        self.trigger = None
        self.arm = SimArm(SimSettings.of(cell), seed=cell.sim.seed)
        self.machine = Machine(
            self.arm,
            network,
            behaviour=behaviour or behaviour_in(cell.sim),
            now_ns=clock.now_ns(),
        )
        trace = trace_from_environment(self.arm, clock)
        if trace is not None:
            self.machine.after_tick.append(trace.ticked)
        if cell.sim.inputs_follow:
            self._follows = followed_numbers(cell)
            self.machine.after_tick.append(self._follow_outputs)

    def _follow_outputs(self) -> None:
        """Switch each input that follows an output."""
        signals = self.machine.hardware.signals
        for follower, output in self._follows.items():
            signals.set(follower if signals.holds(output) else -follower)

    @property
    def fault(self) -> str:
        """Error that stopped a program, empty without one."""
        error = self.machine.control.error
        return "" if error is None else str(error)

    def begin(self, now_ns: int) -> None:
        """Start real time, after files are loaded and programs are started."""
        self.machine.skip_to(now_ns)

    def step(self, now_ns: int) -> None:
        """Advance programs and arm to `now_ns`."""
        self.machine.catch_up(now_ns)

    def counters(self) -> dict[str, int]:
        """Return the number of AS steps and the lost time."""
        machine = self.machine
        return {"as_steps": machine.steps, "ms_lost": machine.ns_lost * 1000 // NS_PER_S}

    def close(self) -> None:
        """Switch the controller off."""
        self.machine.hardware.close_sockets()


class ControllerSensor(EmulatedController):
    """Emulated controller that publishes the samples of the sensor on its arm."""

    def __init__(
        self, bus: Bus, cell: CellConfig, network: Network, *, behaviour: Behaviour | None = None
    ) -> None:
        """Build the controller of this cell and claim the sensor topic as publisher."""
        super().__init__(bus.clock, cell, network, behaviour=behaviour)
        sensor = SensorFeed(bus, cell, self.arm)
        self.machine.after_tick += [sensor.ticked, sensor.publish]


class ControllerNetft(EmulatedController):
    """Emulated controller that serves the samples of the sensor on its arm over RDT."""

    def __init__(
        self,
        server: NetftServer,
        clock: Clock,
        cell: CellConfig,
        network: Network,
        *,
        behaviour: Behaviour | None = None,
    ) -> None:
        """Build the controller of this cell with the server of its sensor."""
        super().__init__(clock, cell, network, behaviour=behaviour)
        self._server = server
        self.machine.after_tick.append(RdtFeed(server, cell, self.arm).ticked)

    def step(self, now_ns: int) -> None:
        """Process requests of the sensor's client, then advance programs and arm to `now_ns`."""
        self._server.poll()
        super().step(now_ns)

    def close(self) -> None:
        """Switch the controller and its sensor off."""
        super().close()
        self._server.close()
