"""The emulator keeps up with real time: the cost of a step, and the start of the time."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from common.bus.memory_bus import MemoryTransport
from common.config.load import load_cell
from forcemesh.bus import Bus
from forcemesh.clock import ManualClock
from sim.controller.network import MemoryNetwork
from sim.controller.service import ControllerSensor
from tests.contract.rig import DEMO_CELL
from tests.fakes.as_bench import AsBench, program

MOST_CALLS = 50  # of functions, for one step
STEPS = (
    "x = y*2+1", "a[3] = x", "IF a[3] > 2 THEN", "$s = $MID($s,2)+$CHR(65)", "END", "CALL sub",
    "SIGNAL 2001", "n = VAL($ENCODE(/I6,TIMER(1)))",
)  # fmt: skip


class Count:
    """Counter of function calls, Python's own and C's."""

    def __init__(self) -> None:
        self.calls = 0

    def count(self, _frame: FrameType, event: str, _argument: object) -> None:
        """Count a call that the interpreter reports."""
        self.calls += event in {"call", "c_call"}


@contextmanager
def counting() -> Iterator[Count]:
    """Count calls; unlike time, they are the same on every machine."""
    count, before = Count(), sys.getprofile()
    sys.setprofile(count.count)
    try:
        yield count
    finally:
        sys.setprofile(before)


def test_no_common_kind_of_step_takes_many_calls() -> None:
    """A step is cheap because of how it is compiled, not because the machine is fast."""
    bench = AsBench(
        program("y = 1", '$s = "ab"', "WHILE TRUE DO", *STEPS, "END")
        + program("RETURN", name="sub")
    )
    bench.start().advance(0.01)
    steps = bench.machine.steps
    end_ns = bench.machine.now_ns + 900_000  # no tick of the arm in it
    with counting() as count:
        bench.machine.advance(end_ns)
    steps = bench.machine.steps - steps
    assert not bench.machine.stops
    assert steps > 30
    assert count.calls / steps < MOST_CALLS


def test_time_before_it_began_is_neither_made_up_for_nor_lost() -> None:
    """Loading takes as long as it takes; then every millisecond is one tick of the arm."""
    cell, clock = load_cell(DEMO_CELL), ManualClock()
    bus = Bus("sensor", cell.cell, MemoryTransport(), cell, clock)
    service = ControllerSensor(bus, cell, MemoryNetwork())
    clock.sleep_s(3.0)
    service.begin(clock.now_ns())
    service.step(clock.now_ns())
    assert service.arm.ticks == 0
    for _ in range(7):
        clock.sleep_s(0.001)
        service.step(clock.now_ns())
    assert service.arm.ticks == 7
    assert service.counters()["ms_lost"] == 0
    clock.sleep_s(0.060)
    service.step(clock.now_ns())
    assert service.arm.ticks == 57
    assert service.counters()["ms_lost"] == 10
