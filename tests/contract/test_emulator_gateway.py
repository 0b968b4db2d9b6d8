"""The shipped program in the emulator and the real gateway, in lock step on a virtual clock."""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from common.cell import Cell
from common.clock import ManualClock
from common.convert import record_of
from common.endpoints import Bus
from common.service import Runner, Service
from services.gateway.link import News
from services.gateway.service import Gateway
from sim.controller.behaviour import Behaviour, pessimistic
from sim.controller.machine import Machine
from sim.controller.network import MemoryNetwork
from sim.controller.parser import load
from sim.controller.service import ControllerSensor
from sim.controller.wire import LockStepWire
from tests.contract.rig import Rig, gateway_cell, pose_goal, shifted

PROGRAM = Path(__file__).resolve().parents[2] / "controller" / "forcemesh.as"
PORT = 49152


class Emulated:
    """A rig whose robot is the gateway and, stepped before it, the emulated controller."""

    def __init__(self, behaviour: Behaviour) -> None:
        cell = gateway_cell(PORT, **{"rates.robot_hz": 60, "sim.gap_m": 0.1})
        self.network = MemoryNetwork()
        self.controller: ControllerSensor | None = None
        self._behaviour = behaviour
        self.rig = Rig(cell, ManualClock(), self._make)

    def _make(self, bus: Bus, cell: Cell) -> Service:
        self.controller = ControllerSensor(
            bus.playing("sensor"), cell, self.network, behaviour=self._behaviour
        )
        machine = self.controller.machine
        machine.load(load(PROGRAM))
        machine.pendant.monitor_speed(100.0)
        machine.pendant.execute("fm.main")
        wire = LockStepWire(self.network, PORT, News)
        return Both(Gateway(bus, cell, wire), Runner(self.controller, [], bus.clock))

    @property
    def machine(self) -> Machine:
        """The controller."""
        assert self.controller is not None
        return self.controller.machine


class Both:
    """The gateway as the rig's service; the controller lives up to the same moment first."""

    def __init__(self, gateway: Gateway, controller: Runner) -> None:
        self.gateway, self._controller = gateway, controller
        self.period_s, self.trigger = 0.001, None

    @property
    def fault(self) -> str:
        """The gateway's."""
        return self.gateway.fault

    def counters(self) -> dict[str, int]:
        """The gateway's."""
        return self.gateway.counters()

    def step(self, now_ns: int) -> None:
        """Controller first, then the gateway."""
        if self._controller.due(now_ns):
            self._controller.step(now_ns)
        self.gateway.step(now_ns)


@pytest.mark.parametrize(
    "behaviour", [Behaviour(step_s=1e-4), pessimistic(1e-4)], ids=["kind", "pessimistic"]
)
def test_a_goal_goes_through_gateway_and_program_to_the_arm_and_comes_back_as_done(
    behaviour: Behaviour,
) -> None:
    """Hello, limits, command 1, LMOVE, MuJoCo, poses back, status bits, done; then it stays."""
    emulated = Emulated(behaviour)
    rig = emulated.rig
    assert rig.advance(5.0, lambda: rig.state.valid), rig.service.fault
    start = pin.SE3(rig.T)
    _goal_to(rig, 1, shifted(start, y_m=0.02, z_m=0.03))
    end = emulated.machine.robot.here()
    assert np.linalg.norm(end.translation - start.translation - [0, 0.02, 0.03]) < 2e-4
    assert emulated.machine.stops == []


def _goal_to(rig: Rig, id_: int, T: pin.SE3) -> None:
    """Arm, ask for a pose, wait until it is done; after a stall of the controller, again."""
    for _ in range(3):
        rig.arm()
        rig.say("goal", goal=pose_goal(id_, T))
        rig.advance(5.0, lambda: rig.state.goal.state in ("done", "refused"))
        if rig.state.goal.state == "done":
            return
        id_ += 1
    pytest.fail(f"{rig.state.goal} {rig.state.hold_reason}")


def test_two_runs_in_lock_step_are_the_same_to_the_last_bit() -> None:
    """Gateway, program and arm on one virtual clock: nothing depends on the machine's speed."""

    def end() -> tuple[bytes, int]:
        emulated = Emulated(Behaviour(step_s=1e-4))
        rig = emulated.rig
        rig.connect()
        rig.arm()
        rig.say("setpoint", pose=record_of(shifted(rig.T, x_m=0.005)))
        rig.advance(0.5)
        return emulated.machine.robot.q.tobytes(), emulated.machine.scheduler.steps

    assert end() == end()


def test_a_wire_that_is_cut_is_opened_again_and_nothing_moves_by_that() -> None:
    """The controller's program accepts the next connection; the arm stays until armed again."""
    emulated = Emulated(Behaviour(step_s=1e-4))
    rig = emulated.rig
    assert rig.advance(5.0, lambda: rig.state.valid)
    rig.arm()
    rig.say("goal", goal=pose_goal(1, shifted(rig.T, z_m=0.05)))
    rig.advance(0.25)
    assert isinstance(rig.service, Both)
    wire = rig.service.gateway._connection._wire
    wire.close("cut by the test", rig.clock.now_ns())
    assert rig.advance(5.0, lambda: wire.connections == 2 and rig.state.valid)
    rig.advance(1.0)
    q = emulated.machine.robot.q
    rig.advance(2.0)
    assert np.abs(emulated.machine.robot.q - q).max() < 1e-5
    assert rig.state.hold_reason
