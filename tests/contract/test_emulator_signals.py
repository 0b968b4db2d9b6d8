"""Digital signals over a real socket: bus, gateway, TCP, the shipped program, and back."""

from collections.abc import Callable, Iterator

import pytest

from common.config.cell import CellConfig
from common.runtime.service import Runner
from forcemesh import topics
from forcemesh.bus import Bus
from forcemesh.clock import NS_PER_S, MonotonicClock
from forcemesh.messages import RobotSignals
from forcemesh.requests import Reply, SignalRequest
from forcemesh.topics import CLIENT
from services.gateway.link import Link, LinkSettings
from services.gateway.service import Gateway
from sim.as_language.parser import load
from sim.controller.network import SocketNetwork
from sim.controller.service import ControllerSensor
from tests.contract.rig import Rig, gateway_cell
from tests.contract.robots import GOOD, PROGRAM, Both
from tests.fakes.controller import PORT
from tests.fakes.signals import FOLLOWING

pytestmark = pytest.mark.realtime

LISTENS_WITHIN_S = 20.0


class OnSockets:
    """Gateway and emulated controller in one process, with a socket between them."""

    def __init__(self) -> None:
        """Switch on, start the program, connect."""
        cell = gateway_cell(PORT, **FOLLOWING, **{"rates.robot_hz": 40, "sim.gap_m": 0.1})
        self.rig = Rig(cell, MonotonicClock(), self._make)
        self.client = Bus(CLIENT, cell.cell, self.rig.transport, cell, self.rig.clock)
        self.rig.transport.advance = self._advance
        self.reader = self.client.reader(topics.ROBOT_SIGNALS)

    def _make(self, bus: Bus, cell: CellConfig) -> Both:
        network = SocketNetwork(port=0)
        self.controller = ControllerSensor(bus.playing("sensor"), cell, network, behaviour=GOOD)
        machine = self.controller.machine
        machine.load(load(PROGRAM))
        machine.pendant.monitor_speed(100.0)
        machine.pendant.execute("fm.main")
        self.controller.begin(bus.clock.now_ns())
        runner = Runner(self.controller, [], bus.clock)
        give_up_ns = bus.clock.now_ns() + LISTENS_WITHIN_S * NS_PER_S
        while PORT not in network.bound:
            assert bus.clock.now_ns() < give_up_ns, "the program does not listen"
            runner.step(bus.clock.now_ns())
        self.link = Link(LinkSettings("127.0.0.1", network.bound[PORT]))
        return Both(Gateway(bus, cell, self.link), runner.step)

    def _advance(self, timeout_s: float, answered: Callable[[], bool]) -> None:
        """Advance while a client waits for a reply."""
        self.rig.advance(timeout_s, answered)

    @property
    def state(self) -> RobotSignals:
        """Newest message of the topic."""
        message = self.reader.read(self.rig.clock.now_ns()).message
        return message or RobotSignals(valid=False)

    def ask(self, signal: str, *, on: bool) -> Reply:
        """Request an output as an operator."""
        return self.client.ask(topics.SIGNAL, SignalRequest(signal=signal, on=on))


@pytest.fixture
def cell() -> Iterator[OnSockets]:
    """A connected controller."""
    made = OnSockets()
    yield made
    made.controller.close()
    assert isinstance(made.rig.service, Both)
    made.rig.service.gateway.close()


def test_signals_go_to_the_controller_and_come_back(cell: OnSockets) -> None:
    """An output is set in the controller, its input follows, and after a cut it is still known."""
    rig, signals = cell.rig, cell.controller.machine.hardware.signals
    rig.until(lambda: rig.state.valid and cell.state.valid, 20.0)
    assert cell.ask("gripper_close", on=True).code == "signal_held"
    assert cell.ask("lamp", on=True).accepted
    rig.until(lambda: cell.state.on["lamp"] and cell.state.on["part"])
    assert [signals.holds(number) for number in (9, 10, 11)] == [False, True, False]
    cell.link.close("cut by the test", rig.clock.now_ns())
    rig.until(lambda: not cell.state.valid)
    assert cell.state.on == {}
    rig.until(lambda: cell.state.valid, 20.0)
    assert cell.state.on["lamp"]
    assert cell.ask("lamp", on=False).accepted
    rig.until(lambda: not cell.state.on["part"])
    assert not signals.holds(10)
