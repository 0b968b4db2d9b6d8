"""The emulated controller in a cell: it moves the same simulated arm, and plays the role sensor.

Towards the gateway it is a controller on TCP. On the bus it only publishes the readings of the
sensor on its arm, as sim.robot does.
"""

from common.cell import Cell
from common.clock import NS_PER_S
from common.endpoints import Bus
from common.errors import SimulationError
from sim.controller.behaviour import Behaviour, behaviour_in
from sim.controller.machine import Machine
from sim.controller.network import Network
from sim.robot.arm import SimArm
from sim.robot.sensor_feed import SensorFeed
from sim.robot.service import sim_settings
from sim.robot.settings import TICK_S
from sim.robot.trace import wanted_trace


class ControllerSensor:
    """A service whose steps let the controller catch up with the clock."""

    def __init__(
        self, bus: Bus, cell: Cell, network: Network, *, behaviour: Behaviour | None = None
    ) -> None:
        """Build the arm of this cell and a controller without programs around it.

        Raises SimulationError if the cell has no simulated arm.
        """
        if cell.sim is None:
            raise SimulationError("the cell file has no section `sim`, so there is no arm to move")
        self.period_s = TICK_S
        self.trigger = None
        self.arm = SimArm(sim_settings(cell, cell.sim), seed=cell.sim.seed)
        self.machine = Machine(
            self.arm,
            network,
            behaviour=behaviour or behaviour_in(cell.sim),
            now_ns=bus.clock.now_ns(),
        )
        self.machine.after_tick.append(SensorFeed(bus, cell, self.arm).ticked)
        trace = wanted_trace(self.arm, bus.clock)
        if trace is not None:
            self.machine.after_tick.append(trace.ticked)

    @property
    def fault(self) -> str:
        """Why the controller's program has stopped, empty while it has not."""
        return "" if self.machine.error is None else str(self.machine.error)

    def begin(self, now_ns: int) -> None:
        """Say that real time counts from now on: files are loaded, programs are started."""
        self.machine.scheduler.skip_to(now_ns)

    def step(self, now_ns: int) -> None:
        """Let programs and arm live up to now."""
        self.machine.scheduler.catch_up(now_ns)

    def counters(self) -> dict[str, int]:
        """Return how many AS steps were made, and how much time was lost."""
        scheduler = self.machine.scheduler
        return {
            "as_steps": scheduler.steps,
            "ms_lost": scheduler.ns_lost * 1000 // NS_PER_S,
        }

    def close(self) -> None:
        """Switch the controller off."""
        self.machine.tcp.close_all()
