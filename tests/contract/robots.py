"""The four robots that keep the contract, and how they differ: every difference is said here.

All live on a virtual clock. `gateway` is the gateway with a fake controller that was written beside
the program that ships and shares nothing with it; the emulated ones run that program itself.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from common.config.cell import CellConfig
from common.config.load import load_cell
from common.runtime.service import Runner, Service
from forcemesh.bus import Bus
from forcemesh.clock import NS_PER_S, ManualClock
from forcemesh.messages import Gains, Host
from services.gateway.link import News
from services.gateway.service import Gateway
from sim.controller.behaviour import Behaviour
from sim.controller.machine import Machine
from sim.controller.network import MemoryNetwork
from sim.controller.parser import load
from sim.controller.service import ControllerSensor
from sim.controller.wire import LockStepLink
from sim.robot.service import SimRobot
from tests.contract.rig import DEADLINE_S, DEMO_CELL, Rig, gateway_cell
from tests.fakes.controller import PORT, FakeController

PROGRAM = Path(__file__).resolve().parents[2] / "controller" / "forcemesh.as"
GOOD = Behaviour(step_s=1e-4)  # a controller that has time for the program


class Emulated:
    """A rig whose robot is the gateway and, stepped before it, the emulated controller."""

    def __init__(self, behaviour: Behaviour = GOOD, host: Host = "controller") -> None:
        changes = {"rates.robot_hz": 60, "sim.gap_m": 0.1, "gateway.watchdog_s": 0.25}
        self.network = MemoryNetwork()
        self.controller: ControllerSensor | None = None
        self._behaviour = behaviour
        cell = gateway_cell(PORT, **changes)
        self.rig = Rig(cell, ManualClock(), self._make, feedback_host=host)

    def _make(self, bus: Bus, cell: CellConfig) -> Service:
        self.controller = ControllerSensor(
            bus.playing("sensor"), cell, self.network, behaviour=self._behaviour
        )
        machine = self.controller.machine
        machine.load(load(PROGRAM))
        machine.pendant.monitor_speed(100.0)
        machine.pendant.execute("fm.main")
        runner = Runner(self.controller, [], bus.clock)
        return Both(lock_step(bus, cell, self.network), living(runner))

    @property
    def machine(self) -> Machine:
        """The controller."""
        assert self.controller is not None
        return self.controller.machine


class Both:
    """The gateway as the rig's service; the controller lives up to the same moment first."""

    def __init__(self, gateway: Gateway, controller: Callable[[int], object]) -> None:
        self.gateway, self._controller = gateway, controller
        self.period_s, self.trigger = 0.001, None

    @property
    def fault(self) -> str:
        """The gateway's."""
        return self.gateway.fault

    def counters(self) -> dict[str, int]:
        """The gateway's."""
        return self.gateway.counters()

    def numbers(self, now_ns: int) -> dict[str, float]:
        """The gateway's."""
        return self.gateway.numbers(now_ns)

    def step(self, now_ns: int) -> None:
        """Controller first, then the gateway."""
        self._controller(now_ns)
        self.gateway.step(now_ns)


def living(runner: Runner) -> Callable[[int], object]:
    """Return what lets a service that has a period of its own live up to a moment."""
    return lambda now_ns: runner.step(now_ns) if runner.due(now_ns) else None


def lock_step(bus: Bus, cell: CellConfig, network: MemoryNetwork) -> Gateway:
    """Return a gateway whose wire is in memory."""
    return Gateway(bus, cell, LockStepLink(network, PORT, News))


def faked(controller: FakeController, network: MemoryNetwork) -> Callable[[Bus, CellConfig], Both]:
    """Return what makes a gateway for a fake controller, which lives on the gateway's clock."""

    def make(bus: Bus, cell: CellConfig) -> Both:
        gateway = lock_step(bus, cell, network)
        return Both(gateway, lambda now_ns: controller.live(now_ns / NS_PER_S))

    return make


def sim_rig() -> Rig:
    """The simulated robot on a virtual clock."""
    cell = load_cell(DEMO_CELL, {"deadlines.command_s": DEADLINE_S, "sim.gap_m": 0.1})
    return Rig(cell, ManualClock(), SimRobot, feedback_host="pc")


def gateway_rig() -> Rig:
    """The gateway and a fake controller."""
    network = MemoryNetwork()
    controller = FakeController(network, rate_hz=100.0)
    return Rig(gateway_cell(PORT), ManualClock(), faked(controller, network))


def emulated_pc_rig() -> Rig:
    """The gateway and the program that ships, freshly started; force feedback on the PC."""
    return Emulated(host="pc").rig


def emulated_controller_rig() -> Rig:
    """The same with force feedback in the controller."""
    return Emulated(host="controller").rig


def ran_feedback(rig: Rig) -> None:
    """Let force feedback run and end: nothing of it may be left over for what comes after."""
    rig.arm()
    rig.push(force_N=(5.0, 0.0, -5.0), torque_Nm=(0.0, 0.5, 0.0))
    gains = Gains(force_i_m_per_Ns=(2e-4,) * 3, torque_i_rad_per_Nms=(0.05,) * 3)
    rig.feed_back("both", gains)
    rig.advance(0.3)
    rig.silence()
    rig.until(lambda: rig.state.hold_reason)
    rig.wrench = None
    assert rig.is_at_rest()


def nothing(_rig: Rig) -> None:
    """Begin fresh."""


@dataclass(frozen=True, slots=True)
class Robot:
    """One robot of the contract, and what of it is not as in the others."""

    make: Callable[[], Rig]
    # Where force feedback runs. `pc`: the robot gets set points and never sees the wrench, so what
    # is promised about a bad wrench is the regulator's and the arbiter's promise, not its own.
    feedback_host: Host
    # Whether it has a controller that could run force feedback; without one it refuses.
    has_controller: bool = True
    # Whether it keeps the cell's limits again behind the arbiter (design section 6).
    guards_limits: bool = True
    before: Callable[[Rig], None] = nothing  # what it has been through when a test begins


ROBOTS = {
    "sim": Robot(sim_rig, "pc", has_controller=False),
    "gateway": Robot(gateway_rig, "controller"),
    "emulated, pc": Robot(emulated_pc_rig, "pc"),
    "emulated, controller": Robot(emulated_controller_rig, "controller", before=ran_feedback),
}
