"""Stops of the emulated arm: BRAKE, HOLD and ABORT."""

import numpy as np
import pytest

from tests.fakes.as_bench import AsBench, program
from tests.unit.sim.controller.conftest import SQUARE, Trace


def braked(source: str, at_s: float, **kwargs) -> tuple[AsBench, Trace]:
    """Run a program that a PC program brakes at a time."""
    brake = program(f"TWAIT {at_s}", "BRAKE", name="brake")
    bench = AsBench(source + brake, **kwargs)
    trace = Trace(bench)
    bench.machine.control.start_pc(1, "brake")
    bench.run()
    return bench, trace


def test_brake_from_a_pc_program_stops_within_v2_over_2a() -> None:
    """100 mm/s at 2.5 m/s^2 are 2 mm and 40 ms; the path is kept."""
    source = program(*SQUARE, "LMOVE SHIFT(p BY 100,0,0)", "BREAK", "t = TIMER(0)")
    _, trace = braked(source, 0.5)
    at = 501
    rest = trace.mm[-1] - trace.mm[at]
    assert rest[0] == pytest.approx(2.0, abs=0.15)
    assert np.abs(rest[1:]).max() < 1e-3
    assert trace.speed_mm_s[at + 42 :].max() < 1e-6


def test_hold_decelerates_and_run_finishes_the_motion() -> None:
    """HOLD keeps the rest of the motion; nothing moves until RUN."""
    bench = AsBench(program(*SQUARE, "LMOVE SHIFT(p BY 50,0,0)", "BREAK", "x = 1"))
    trace = Trace(bench)
    bench.start().advance(0.25)
    bench.pendant.hold()
    bench.advance(1.0)
    held = trace.mm[-1] - trace.mm[0]
    assert 20.0 < held[0] < 30.0
    assert trace.speed_mm_s[-900:].max() < 1e-9
    bench.pendant.run()
    assert bench.advance(2.0, lambda: bench.value("x") == 1)
    assert (trace.mm[-1] - trace.mm[0])[0] == pytest.approx(50.0, abs=1e-3)


def test_a_motion_that_is_braked_while_held_is_not_resumed_by_run() -> None:
    """A watchdog relies on it: BRAKE during HOLD drops the rest of the motion."""
    bench = AsBench(program(*SQUARE, "LMOVE SHIFT(p BY 50,0,0)", "BREAK", "TWAIT 100")
                    + program("BRAKE", name="brake"))  # fmt: skip
    trace = Trace(bench)
    bench.start().advance(0.25)
    bench.pendant.hold()
    bench.advance(0.5)
    bench.machine.control.start_pc(1, "brake")
    bench.advance(0.1)
    bench.pendant.run()
    bench.advance(1.0)
    assert trace.speed_mm_s[-1100:].max() < 1e-9


def test_abort_finishes_the_motion_and_ends_the_program() -> None:
    """TASK is 3 while the motion of an ended program continues."""
    bench = AsBench(program(*SQUARE, "LMOVE SHIFT(p BY 50,0,0)", "LMOVE p", "x = 1"))
    trace = Trace(bench)
    bench.start().advance(0.2)
    bench.pendant.abort()
    assert bench.task.machine.task_state(1) == 3
    bench.advance(1.0)
    assert bench.task.machine.task_state(1) == 0
    assert (trace.mm[-1] - trace.mm[0])[0] == pytest.approx(50.0, abs=1e-3)
    assert bench.value("x") is None
