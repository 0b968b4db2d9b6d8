"""AS steps per second that the emulated controller executes on one core, and its processor load.

Loops without waiting measure the cost of each kind of step; the shipped program that of the demo.
The arm's physics are timed separately: "steps/s" excludes them, "one core" includes them.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from rich.table import Table

from bench.tables import on_screen
from common.config.load import load_cell
from controller.packet import ZERO_VEC, Packet, VecInt, encode
from controller.packet_table import (
    ID_LAST,
    Bank,
    CentreParam,
    Com,
    FeedbackSwitch,
    GainKind,
    greeting,
    next_id,
)
from forcemesh.clock import NS_PER_S
from sim.as_language.parser import load, parse
from sim.controller.behaviour import Behaviour
from sim.controller.machine import Machine
from sim.controller.network import MemoryNetwork
from sim.robot.arm import SimArm
from sim.robot.settings import SimSettings

ROOT = Path(__file__).resolve().parent.parent
PROGRAM = ROOT / "controller" / "forcemesh.as"
CELL = ROOT / "cells" / "demo-tcp.yaml"
PORT = 49152
FREE = SimSettings(gap_m=0.1, delay_s=0.0)  # room below the tool
BUSY = Behaviour(step_s=5e-6)  # 200 steps between two ticks of the arm
BUSY_S, SHIPPED_S = 0.25, 5.0  # virtual
REPEATS = 5
TICK_NS = 1_000_000
SCALES: VecInt = (50, 500, 250, 100, 1000, 10)  # per mm, degree, degree of a joint, N, N m, mm/s
ARM = 1  # fm.num of the shipped program
LIMITS: dict[Bank, VecInt] = {
    Bank.FEEDBACK: (
        50,
        1000,
        500,
        10_000,
        5_000,
        250,
    ),  # 1 mm, 2 deg, 50 mm/s, 200 mm, 50 N, 250 ms
    Bank.MOTION: (
        75_000,
        10_000,
        1_000,
        5_000,
        2_500,
        0,
    ),  # 150 deg, 10 N m, 20 mm, 10 deg, 250 mm/s
    Bank.LOWER_CORNER: (-50_000, 0, -10_000, 0, 0, 0),
    Bank.UPPER_CORNER: (50_000, 60_000, 60_000, 0, 0, 0),
    Bank.SEGMENT: (30, 12, 0, 0, 0, 0),  # 30 ms, 1.2 mm/s
    Bank.JOINT_SPEED: (92_500, 77_500, 102_500, 137_500, 137_500, 250_000),
}
GAINS_I: VecInt = (250, 250, 250, 250, 250, 250)  # 0.05 mm/(N s), 0.05 deg/(N m s)
SAMPLE = f" {Com.POSE:06d} ".encode("ascii")
STEPS_S = (1e-4, 1.25e-4, 2.5e-4, 5e-4)
HEARTBEAT_TICKS, WRENCH_TICKS = 100, 16  # as in the demo's cell

LOOPS = {
    "arithmetic": """
        x = 0
        again:
        x = x+1
        y = (x*2+1)/3-ABS(x)
        IF (x < 1000000) AND (y <> 0.5) GOTO again""",
    "array elements": """
        i = 0
        again:
        i = (i+1) MOD 100
        a[i] = i*0.5
        b[1,i] = a[i]
        GOTO again""",
    "FOR, CALL": """
        again:
        FOR i = 1 TO 6
        a[i] = i
        END
        CALL sub(i)
        GOTO again""",
    "$ENCODE, $RIGHT, +": """
        x = -123.5
        again:
        $s = $LEFT("-",ABS(x<0))+$RIGHT($ENCODE(/I7,1E6+ROUND(ABS(x)*50)),6-ABS(x<0))+" "
        $t[3] = $s+"000101 "
        GOTO again""",
    "VAL, $MID, INSTR": """
        $s = "000004 000000 000123 -00456 "
        again:
        x = VAL($MID($s,15,6))
        y = INSTR(15,$s," ")+INSTR(22,$s," ")
        GOTO again""",
    "HERE, DECOMPOSE": """
        again:
        HERE p
        DECOMPOSE x[1] = p
        HERE #j
        DECOMPOSE j[1] = #j
        GOTO again""",
    "POINT, TRANS, +, -": """
        POINT a = TRANS(1,2,3,40,50,60)
        again:
        POINT p = TRANS(10,20,30,10,20,30)
        POINT c = a+p
        POINT d = -a
        GOTO again""",
}


class TimedMachine(Machine):
    """Controller that measures the processor time of its arm."""

    tick_s = 0.0

    def _tick(self) -> None:
        began_s = time.process_time()
        super()._tick()
        self.tick_s += time.process_time() - began_s


@dataclass(frozen=True, slots=True)
class Cost:
    """Processor time of one core for an interval of virtual time."""

    steps: int
    steps_s: float  # processor time outside of the arm
    all_s: float
    virtual_s: float

    @property
    def steps_per_s(self) -> float:
        """AS steps per second of processor time, the arm left out."""
        return self.steps / self.steps_s


class Client:
    """Client in place of the gateway: sends hello, then periodic heartbeats or wrenches."""

    def __init__(self, machine: Machine, network: MemoryNetwork) -> None:
        """Connect as soon as the program listens."""
        self._machine = machine
        while PORT not in network.listeners:
            self.live(1)
        self._stream = network.dial(PORT)
        self._id = ID_LAST
        self._ticks = 0
        self.samples = 0
        self.put(Com.HELLO, greeting(ARM), SCALES)
        self.live(500)
        self._receive()

    def put(self, com: Com, param: int = 0, vec: VecInt = ZERO_VEC) -> None:
        """Send a packet with the next ID."""
        self._id = next_id(self._id)
        self._stream.send(encode(Packet(self._id, com, param, vec)))

    def live(self, ticks: int, each: Callable[[], None] = lambda: None) -> None:
        """Advance the controller, and call a function every millisecond."""
        for _ in range(ticks):
            self._machine.advance(self._machine.now_ns + TICK_NS)
            each()

    def beat(self) -> None:
        """Keep the connection alive, and read the reports."""
        self._ticks += 1
        self._receive()
        if self._ticks % HEARTBEAT_TICKS == 0:
            self.put(Com.HEARTBEAT)

    def push(self) -> None:
        """Send alternating forces up and down, and read the reports."""
        self._ticks += 1
        self._receive()
        if self._ticks % WRENCH_TICKS == 0:
            up = 1 if self._ticks // 1000 % 2 else -1
            self.put(Com.WRENCH, 0, (0, 0, 500 * up, 0, 0, 100 * up))

    def _receive(self) -> None:
        data = self._stream.receive(65_536)
        self.samples += (data or b"").count(SAMPLE)

    def start_feedback(self) -> None:
        """Set limits, TCP and gains, start both kinds of force feedback."""
        for bank, vec in LIMITS.items():
            self.put(Com.LIMITS, bank, vec)
        self.put(Com.TCP, CentreParam.TCP)
        self.put(Com.GAINS, GainKind.INTEGRAL, GAINS_I)
        self.put(Com.FEEDBACK, FeedbackSwitch.POSITION)
        self.put(Com.FEEDBACK, FeedbackSwitch.ORIENTATION)
        self.live(1000, self.push)


def loop_cost(body: str) -> Cost:
    """Run a loop that never waits."""
    machine = TimedMachine(SimArm(FREE, seed=0), MemoryNetwork(), behaviour=BUSY)
    machine.load(parse(f".PROGRAM main()\n{body}\n.END\n.PROGRAM sub(.a)\n.b = .a\n.END\n"))
    machine.pendant.execute("main")
    machine.advance(machine.now_ns + 10 * TICK_NS)
    return min((_cost(machine, BUSY_S) for _ in range(REPEATS)), key=lambda cost: cost.steps_s)


def shipped(step_s: float, *, feedback: bool) -> tuple[TimedMachine, Client]:
    """Start the shipped program, connect a client, optionally start force feedback."""
    network = MemoryNetwork()
    machine = TimedMachine(SimArm(FREE, seed=0), network, behaviour=Behaviour(step_s=step_s))
    machine.load(load(PROGRAM))
    machine.pendant.monitor_speed(100.0)
    machine.pendant.execute("fm.main")
    client = Client(machine, network)
    if feedback:
        client.start_feedback()
    return machine, client


def shipped_cost(*, feedback: bool) -> Cost:
    """Run the shipped program at the step time of the demo's cell."""
    sim = load_cell(CELL).sim
    step_s = Behaviour().step_s if sim is None else sim.as_step_s
    machine, client = shipped(step_s, feedback=feedback)
    each = client.push if feedback else client.beat
    cost = _cost(machine, SHIPPED_S, lambda duration_s: client.live(round(duration_s * 1e3), each))
    running = machine.memory.read("fm.mode")
    if running != (3.0 if feedback else 0.0) or machine.stops:
        raise RuntimeError(f"the program does not do what is measured: mode {running}")
    return cost


def _cost(
    machine: TimedMachine, virtual_s: float, live: Callable[[float], None] | None = None
) -> Cost:
    steps, tick_s, began_s = machine.steps, machine.tick_s, time.process_time()
    if live is None:
        machine.advance(machine.now_ns + round(virtual_s * NS_PER_S))
    else:
        live(virtual_s)
    all_s = time.process_time() - began_s
    steps_s = all_s - (machine.tick_s - tick_s)
    return Cost(machine.steps - steps, steps_s, all_s, virtual_s)


def table() -> Table:
    """Return steps per second for every loop, and the load of the shipped program."""
    rows = [[name, f"{loop_cost(body).steps_per_s:.0f}", "", ""] for name, body in LOOPS.items()]
    for name, feedback in (("forcemesh.as, idle", False), ("forcemesh.as, force feedback", True)):
        cost = shipped_cost(feedback=feedback)
        made, share = cost.steps / cost.virtual_s, 100 * cost.all_s / cost.virtual_s
        rows.append([name, f"{cost.steps_per_s:.0f}", f"{made:.0f}", f"{share:.1f} %"])
    head = ("program", "steps/s", "made", "one core")
    return on_screen("AS emulator: steps/s of one core", head, rows)


def pace_table() -> Table:
    """Return report and loop rates of the shipped program by step time, in virtual time."""
    rows = []
    for step_s in STEPS_S:
        (idle, _), (running, turns) = pace(step_s, feedback=False), pace(step_s, feedback=True)
        rows.append([f"{step_s * 1e3:g} ms", *(f"{rate:.0f}" for rate in (idle, running, turns))])
    head = ("step time", "samples, idle", "samples, force feedback", "turns of its loop")
    return on_screen("forcemesh.as: a second of virtual time", head, rows)


def pace(step_s: float, *, feedback: bool) -> tuple[float, float]:
    """Return samples and loop cycles of the robot program per virtual second."""
    machine, client = shipped(step_s, feedback=feedback)
    samples, turns = client.samples, _turns(machine)
    client.live(round(SHIPPED_S * 1e3), client.push if feedback else client.beat)
    return (client.samples - samples) / SHIPPED_S, (_turns(machine) - turns) / SHIPPED_S


def _turns(machine: Machine) -> float:
    turns = machine.memory.read("fm.loops")
    return turns if isinstance(turns, float) else 0.0
