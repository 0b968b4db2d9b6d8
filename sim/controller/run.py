"""Run an AS file in real time: on its own, or as the controller of a cell.

`python -m sim.controller FILE.as [--port N] [--cell FILE] [--step-ms X] [--pessimistic]`
"""

import argparse
import sys
import threading
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from common.bus.cell_bus import open_bus
from common.config.cell import Cell
from common.config.load import load_cell
from common.runtime.priority import give_up_realtime_priority
from common.runtime.service import (
    HealthReporter,
    Runner,
    exit_on_error,
    refuse_unless_played_by,
    reporter_of,
    spare_the_loop,
    stop_on_signals,
)
from forcemesh.clock import Clock, MonotonicClock
from forcemesh.errors import ConfigError
from sim.controller.behaviour import Behaviour, behaviour_in, pessimistic
from sim.controller.errors import AsError
from sim.controller.machine import Machine
from sim.controller.network import SocketNetwork
from sim.controller.parser import load
from sim.controller.service import ControllerNetft, ControllerSensor, EmulatedController
from sim.controller.syntax import SourceFile
from sim.netft.feed import server_of
from sim.robot.arm import SimArm
from sim.robot.settings import TICK_S, SimSettings

LOOPBACK_ADDRESS = "127.0.0.1"
TICKS_BETWEEN_LOOKS = 20


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what running needs to a command line that already takes the file."""
    parser.add_argument("--program", metavar="NAME", help="program to EXECUTE (default: main,"
                        " else the one named like the file, else the first)")  # fmt: skip
    parser.add_argument("--port", type=int, metavar="N",
                        help="listen there, whatever port the program asks for")  # fmt: skip
    parser.add_argument("--address", default=LOOPBACK_ADDRESS, help="listen on this address only")
    parser.add_argument("--cell", metavar="FILE",
                        help="move this cell's simulated arm and publish its sensor")  # fmt: skip
    parser.add_argument("--step-ms", type=float, metavar="X",
                        help="processor time of one AS step (else the cell's, or 0.5)")  # fmt: skip
    parser.add_argument(
        "--speed",
        type=float,
        default=100.0,
        metavar="PERCENT",
        help="monitor speed (default %(default)s; a real one starts at 10)",
    )
    parser.add_argument("--pessimistic", action="store_true",
                        help="take the worse reading of every open question")  # fmt: skip


def run(arguments: argparse.Namespace) -> int:
    """Run the file of a parsed command line until it ends; return the exit code."""
    with exit_on_error("controller"):
        source = load(Path(arguments.file))
        behaviour = behaviour_of(arguments)
        run_it = run_in_cell if arguments.cell else run_alone
        return run_it(source, arguments, behaviour, stop_on_signals())


def behaviour_of(arguments: argparse.Namespace) -> Behaviour:
    """Return the cell's behaviour, or the usual one, with what was asked for put in.

    Raises ConfigError for an impossible step time.
    """
    sim = load_cell(arguments.cell).sim if arguments.cell else None
    usual = Behaviour() if sim is None else behaviour_in(sim)
    step_s = usual.step_s if arguments.step_ms is None else float(arguments.step_ms) * 1e-3
    try:
        return pessimistic(step_s) if arguments.pessimistic else replace(usual, step_s=step_s)
    except ValueError as error:
        raise ConfigError("command line", [str(error)]) from error


def run_alone(
    source: SourceFile, arguments: argparse.Namespace, behaviour: Behaviour, stop: threading.Event
) -> int:
    """Move an arm of one's own; end when no program runs any more."""
    clock: Clock = MonotonicClock()
    network = SocketNetwork(arguments.address, arguments.port)
    machine = Machine(
        SimArm(SimSettings(), seed=0),
        network,
        behaviour=behaviour,
        now_ns=clock.now_ns(),
        say=say,
    )
    with ExitStack() as exits:
        exits.callback(machine.tcp.close_all)
        start(machine, source, arguments)
        watch = Watch(machine, network)
        machine.scheduler.skip_to(clock.now_ns())
        while not stop.is_set() and watch.alive:
            machine.scheduler.catch_up(clock.now_ns())
            watch.look()
            clock.sleep_s(TICK_S)
    return 1 if machine.stops else 0


def run_in_cell(
    source: SourceFile, arguments: argparse.Namespace, behaviour: Behaviour, stop: threading.Event
) -> int:
    """Be the controller of a cell, with the sensor on its arm; end on a signal."""
    cell = load_cell(arguments.cell)
    network = SocketNetwork(arguments.address, arguments.port or gateway_port(cell))
    with ExitStack() as exits:
        service, reporters, clock = _with_its_sensor(cell, network, behaviour, exits)
        exits.callback(give_up_realtime_priority)
        exits.callback(service.close)
        service.machine.say = say
        start(service.machine, source, arguments)
        watch = Watch(service.machine, network)
        service.machine.after_tick.append(watch.ticked)
        runner = Runner(service, reporters, clock)
        spare_the_loop()
        service.begin(clock.now_ns())
        runner.run(stop)
    return 1 if service.machine.stops else 0


def _with_its_sensor(
    cell: Cell, network: SocketNetwork, behaviour: Behaviour, exits: ExitStack
) -> tuple[EmulatedController, list[HealthReporter], Clock]:
    """Return the controller, the health that it reports, and its clock.

    A sensor that talks RDT is not on the bus: its driver plays that role, and says how it is.
    """
    if cell.sim is not None and cell.sim.netft:
        clock, server = MonotonicClock(), server_of(cell)
        say(f"RDT at {cell.sensor.address}:{server.port}, page and faults at {server.page_port}")
        return ControllerNetft(server, clock, cell, network, behaviour=behaviour), [], clock
    refuse_unless_played_by(cell, "sensor", "sim")
    bus = exits.enter_context(open_bus(cell, "sensor"))
    service = ControllerSensor(bus, cell, network, behaviour=behaviour)
    return service, [reporter_of(bus, cell)], bus.clock


def gateway_port(cell: Cell) -> int | None:
    """Return the port where the cell's gateway expects the controller."""
    return None if cell.gateway is None else cell.gateway.port


def start(machine: Machine, source: SourceFile, arguments: argparse.Namespace) -> None:
    """Load the file, set the monitor speed, EXECUTE the program."""
    try:
        machine.load(source)
        machine.pendant.monitor_speed(arguments.speed)
        name = arguments.program or default_program(source)
        machine.pendant.execute(name.lower())
    except AsError as error:
        raise ConfigError(source.name, [str(error)]) from error
    say(f"robot program {name} of {source.name} runs")


def default_program(source: SourceFile) -> str:
    """Return the program to start: main, the one named like the file, or the first one.

    Raises ConfigError if the file has none.
    """
    if not source.programs:
        raise ConfigError(source.name, ["there is no program in this file"])
    for name in ("main", Path(source.name).stem.lower()):
        if name in source.programs:
            return name
    return next(iter(source.programs))


class Watch:
    """Says when something changes: ports, sockets, programs that start or end."""

    def __init__(self, machine: Machine, network: SocketNetwork) -> None:
        """Begin with what is so now."""
        self._machine, self._network = machine, network
        self._seen: dict[str, str] = {}
        self._ticks = 0
        self.alive = True

    def ticked(self) -> None:
        """Look now and then: at each tick it would cost a quarter of what the arm does."""
        self._ticks += 1
        if self._ticks % TICKS_BETWEEN_LOOKS == 0:
            self.look()

    def look(self) -> None:
        """Say what has changed since the last look."""
        machine = self._machine
        for task in machine.tasks:
            name = "robot program" if task.is_robot else f"PC program {task.number - 1000}"
            self._note(name, f"{task.state} ({task.main})" if task.main else "")
        for port in machine.tcp.listening:
            self._note(f"port {port}", f"listening on {self._network.bound.get(port, port)}")
        self._note("sockets", ", ".join(str(n) for n in machine.tcp.sockets))
        self.alive = any(task.state != "idle" for task in machine.tasks) and not machine.stops

    def _note(self, what: str, state: str) -> None:
        if self._seen.get(what, "") != state:
            self._seen[what] = state
            say(f"{what}: {state or 'none'}")


def say(line: str) -> None:
    """Print a line at once."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()
