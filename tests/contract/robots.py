"""The robots of the contract and all differences between them.

All run on a virtual clock. The emulated robots are the gateway and the shipped program.
"""

from collections.abc import Callable
from dataclasses import dataclass

from common.config.cell import CellConfig
from common.config.load import load_cell
from common.runtime.service import Runner, Service
from forcemesh.bus import Bus
from forcemesh.clock import ManualClock
from forcemesh.messages import Gains, Host
from launch.controller_program import program_of
from services.gateway.link import LinkEvents
from services.gateway.service import Gateway
from sim.as_language.parser import parse
from sim.controller.behaviour import Behaviour
from sim.controller.machine import Machine
from sim.controller.network import LockStepLink, MemoryNetwork
from sim.controller.service import ControllerSensor
from sim.robot.arm import SimArm
from sim.robot.service import SimRobot
from tests.contract.rig import DEADLINE_S, DEMO_CELL, Rig, gateway_cell
from tests.fakes.controller import PORT

GOOD = Behaviour(step_s=1e-4)  # a controller with time for the program


class Emulated:
    """A rig whose robot is the gateway and the emulated controller, which is stepped first."""

    def __init__(
        self,
        behaviour: Behaviour = GOOD,
        host: Host = "controller",
        cell: CellConfig | None = None,
        network: MemoryNetwork | None = None,
        **overrides: object,
    ) -> None:
        changes: dict[str, object] = {
            "rates.robot_hz": 60, "sim.gap_m": 0.1, "gateway.watchdog_s": 0.25, **overrides
        }  # fmt: skip
        self.network = network or MemoryNetwork()
        self.controller: ControllerSensor | None = None
        self._behaviour = behaviour
        cell = cell or gateway_cell(PORT, **changes)
        self.rig = Rig(cell, ManualClock(), self._make, feedback_host=host)
        self.rig.stall = self._stall
        self.rig.shove = lambda: load(self.machine.robot.arm)
        self._stalled = (False, False)

    def _stall(self, on: bool) -> None:
        """Keep the robot program from its next step, as planning does; the PC programs run on."""
        task = self.machine.robot_task
        if on:
            self._stalled, task.ready, task.waiting = (task.ready, task.waiting), False, False
        else:
            task.ready, task.waiting = self._stalled

    def _make(self, bus: Bus, cell: CellConfig) -> Service:
        self.controller = ControllerSensor(
            bus.playing("sensor"), cell, self.network, behaviour=self._behaviour
        )
        machine = self.controller.machine
        program = program_of(cell)
        machine.load(parse(program.text))
        machine.pendant.monitor_speed(100.0)
        machine.pendant.execute(program.start)
        runner = Runner(self.controller, [], bus.clock)
        self.wire = LockStepLink(self.network, PORT, LinkEvents)
        return Both(Gateway(bus, cell, self.wire), runner.step)

    @property
    def machine(self) -> Machine:
        """The emulated controller."""
        assert self.controller is not None
        return self.controller.machine


class Both:
    """The gateway as service of the rig; the controller advances to the same time first."""

    def __init__(self, gateway: Gateway, controller: Callable[[int], object]) -> None:
        self.gateway, self._controller = gateway, controller
        self.period_s, self.trigger = 0.001, None

    @property
    def fault(self) -> str:
        """The fault of the gateway."""
        return self.gateway.fault

    def counters(self) -> dict[str, int]:
        """The counters of the gateway."""
        return self.gateway.counters()

    def numbers(self, now_ns: int) -> dict[str, float]:
        """The numbers of the gateway's health."""
        return self.gateway.numbers(now_ns)

    def step(self, now_ns: int) -> None:
        """Step the controller, then the gateway."""
        self._controller(now_ns)
        self.gateway.step(now_ns)


def sim_rig() -> Rig:
    """The simulated robot on a virtual clock."""
    cell = load_cell(DEMO_CELL, {"deadlines.command_s": DEADLINE_S, "sim.gap_m": 0.1})
    rig = Rig(cell, ManualClock(), SimRobot, feedback_host="pc")
    assert isinstance(rig.service, SimRobot)
    arm = rig.service.arm
    rig.shove = lambda: load(arm)
    return rig


def load(arm: SimArm) -> None:
    """Put half a tonne on the tool."""
    arm.data.xfrc_applied[arm.model.body("tool").id][:3] = (0.0, 0.0, -5000.0)


def emulated_pc_rig() -> Rig:
    """The gateway and the shipped program, freshly started; force feedback on the PC."""
    return Emulated(host="pc").rig


def emulated_controller_rig() -> Rig:
    """The gateway and the shipped program with force feedback in the controller."""
    return Emulated(host="controller").rig


def plain_cell(**overrides: object) -> CellConfig:
    """The demo's cell with protocol plain."""
    changes = {"gateway.port": PORT, "roles.sensor": "external", "deadlines.command_s": DEADLINE_S}
    return load_cell(DEMO_CELL.with_name("demo-plain.yaml"), changes | overrides)


def plain_rig() -> Rig:
    """The gateway and plain.as, which checks no limit of the cell."""
    return Emulated(cell=plain_cell()).rig


def ran_feedback(rig: Rig) -> None:
    """Run force feedback once and end it: it must leave no state that affects later tests."""
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
    """Make no preparation."""


@dataclass(frozen=True, slots=True)
class Robot:
    """One robot of the contract and its deviations from the others."""

    make: Callable[[], Rig]
    # Where force feedback runs. `pc`: the robot gets set points and does not read the wrench;
    # the regulator and the arbiter handle an invalid wrench.
    feedback_host: Host
    # Whether its controller can run force feedback; a robot without one refuses it.
    has_controller: bool = True
    # Whether it checks the limits of the cell after the arbiter (design section 6).
    guards_limits: bool = True
    before: Callable[[Rig], None] = nothing  # preparation before a test begins


ROBOTS = {
    "sim": Robot(sim_rig, "pc", has_controller=False),
    "emulated, pc": Robot(emulated_pc_rig, "pc"),
    "emulated, controller": Robot(emulated_controller_rig, "controller", before=ran_feedback),
}
ALL = {**ROBOTS, "plain": Robot(plain_rig, "controller")}  # for what the PC alone guarantees
