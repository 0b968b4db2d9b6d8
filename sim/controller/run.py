"""Real-time execution of an AS file: standalone, or as the controller of a cell.

`python -m sim.controller FILE.as [--port N] [--cell FILE] [--step-ms X] [--pessimistic]`
"""

import argparse
from contextlib import ExitStack
from functools import partial
from pathlib import Path

from common.bus.cell_bus import open_bus
from common.config.cell import CellConfig
from common.config.load import load_cell
from common.runtime.realtime import give_up_realtime_priority, prepare_realtime
from common.runtime.service import (
    HealthReporter,
    Runner,
    exit_on_error,
    refuse_other_implementation,
)
from common.runtime.stop import StopSignal, stop_on_signals
from forcemesh.clock import Clock, MonotonicClock
from forcemesh.errors import ConfigError
from forcemesh.yaml_file import validated
from sim.as_language.errors import AsError
from sim.as_language.parser import load
from sim.as_language.syntax import SourceFile
from sim.controller.behaviour import Behaviour, behaviour_in, behaviour_like, pessimistic
from sim.controller.machine import Machine
from sim.controller.network import SocketNetwork
from sim.controller.service import ControllerNetft, ControllerSensor, EmulatedController
from sim.netft.feed import server_of
from sim.robot.arm import SimArm
from sim.robot.settings import TICK_S, SimSettings

TICKS_BETWEEN_CHECKS = 20
print_line = partial(print, flush=True)


def run(arguments: argparse.Namespace) -> int:
    """Run the file of a parsed command line until it ends; return the exit code."""
    with exit_on_error("controller"):
        source = load(arguments.file)
        behaviour = behaviour_of(arguments)
        run_it = run_in_cell if arguments.cell else run_alone
        return run_it(source, arguments, behaviour, stop_on_signals())


def behaviour_of(arguments: argparse.Namespace) -> Behaviour:
    """Return the behaviour of a probe, of the cell, or the default, with the options applied.

    Raises ConfigError for a step time out of range, and for mistakes in the file of the probe.
    """
    sim = load_cell(arguments.cell).sim if arguments.cell else None
    usual = Behaviour() if sim is None else behaviour_in(sim)
    if arguments.like is not None:
        usual = behaviour_like(arguments.like)
    step_s = usual.step_s if arguments.step_ms is None else float(arguments.step_ms) * 1e-3
    usual = pessimistic() if arguments.pessimistic else usual
    return validated(Behaviour, usual.model_dump() | {"step_s": step_s}, "command line")


def run_alone(
    source: SourceFile, arguments: argparse.Namespace, behaviour: Behaviour, stop: StopSignal
) -> int:
    """Run with a private arm; end when no program runs."""
    clock: Clock = MonotonicClock()
    network = SocketNetwork(arguments.address, arguments.port)
    machine = Machine(
        SimArm(SimSettings(delay_s=0.0), seed=0),
        network,
        behaviour=behaviour,
        now_ns=clock.now_ns(),
        print_line=print_line,
    )
    with ExitStack() as exits:
        exits.callback(machine.hardware.close_sockets)
        start(machine, source, arguments)
        watch = ChangeLogger(machine, network)
        machine.skip_to(clock.now_ns())
        while not stop.is_set() and watch.alive:
            machine.catch_up(clock.now_ns())
            watch.follow()
            clock.sleep_s(TICK_S)
    return 0 if machine.control.error is None else 1


def run_in_cell(
    source: SourceFile, arguments: argparse.Namespace, behaviour: Behaviour, stop: StopSignal
) -> int:
    """Run as the controller of a cell, with the sensor on its arm; end on a signal."""
    cell = load_cell(arguments.cell)
    port = arguments.port or (None if cell.gateway is None else cell.gateway.port)
    network = SocketNetwork(arguments.address, port)
    with ExitStack() as exits:
        service, reporters, clock = _with_its_sensor(cell, network, behaviour, exits)
        exits.callback(give_up_realtime_priority)
        exits.callback(service.close)
        service.machine.hardware.print_line = print_line
        start(service.machine, source, arguments)
        watch = ChangeLogger(service.machine, network)
        service.machine.after_tick.append(watch.ticked)
        runner = Runner(service, reporters, clock)
        prepare_realtime()
        service.begin(clock.now_ns())
        runner.run(stop)
    return 1 if service.machine.stops else 0


def _with_its_sensor(
    cell: CellConfig, network: SocketNetwork, behaviour: Behaviour, exits: ExitStack
) -> tuple[EmulatedController, list[HealthReporter], Clock]:
    """Return the controller, its health reporters, and its clock.

    An RDT sensor is not on the bus: its driver implements that role and reports its health.
    """
    if cell.sim is not None and cell.sim.netft:
        clock, server = MonotonicClock(), server_of(cell)
        print_line(
            f"RDT at {cell.sensor.address}:{server.port}, page and faults at {server.page_port}"
        )
        return ControllerNetft(server, clock, cell, network, behaviour=behaviour), [], clock
    refuse_other_implementation(cell, "sensor", "sim")
    bus = exits.enter_context(open_bus(cell, "sensor"))
    service = ControllerSensor(bus, cell, network, behaviour=behaviour)
    return service, [HealthReporter(bus, cell)], bus.clock


def start(machine: Machine, source: SourceFile, arguments: argparse.Namespace) -> None:
    """Load the file, set the monitor speed, EXECUTE the program."""
    try:
        machine.load(source)
        machine.pendant.monitor_speed(arguments.speed)
        name = arguments.program or default_program(source)
        machine.pendant.execute(name.lower())
    except AsError as error:
        raise ConfigError(source.name, [str(error)]) from error
    print_line(f"robot program {name} of {source.name} runs")


def default_program(source: SourceFile) -> str:
    """Return the program to start: main, the one named as the file, or the first one.

    Raises ConfigError if the file has none.
    """
    if not source.programs:
        raise ConfigError(source.name, ["there is no program in this file"])
    usual = ("main", Path(source.name).stem.lower(), *source.programs)
    return next(name for name in usual if name in source.programs)


class ChangeLogger:
    """Logs changes: ports, sockets, programs that start or end."""

    def __init__(self, machine: Machine, network: SocketNetwork) -> None:
        """Start with an empty state."""
        self._machine, self._network = machine, network
        self._last_state: dict[str, str] = {}
        self._ticks = 0
        self.alive = True

    def ticked(self) -> None:
        """Check every TICKS_BETWEEN_CHECKS ticks: each tick would cost 25 % of the arm's time."""
        self._ticks += 1
        if self._ticks % TICKS_BETWEEN_CHECKS == 0:
            self.follow()

    def follow(self) -> None:
        """Log the changes since the last check."""
        machine = self._machine
        for task in machine.tasks:
            self._note(
                task.name.removeprefix("the "), f"{task.state} ({task.main})" if task.main else ""
            )
        for port in machine.tcp.listening:
            self._note(f"port {port}", f"listening on {self._network.bound.get(port, port)}")
        self._note("sockets", ", ".join(str(n) for n in machine.tcp.sockets))
        # A program that an error has stopped is continued by another program or not at all.
        self.alive = any(task.state not in ("idle", "stopped") for task in machine.tasks)

    def _note(self, what: str, state: str) -> None:
        if self._last_state.get(what, "") != state:
            self._last_state[what] = state
            print_line(f"{what}: {state or 'none'}")
