"""Motion of the emulated arm: straight, one motion ahead, blending, at the program's speed."""

import math

import numpy as np
import pytest

from tests.fakes.as_bench import AsBench, program
from tests.unit.sim.controller.conftest import SQUARE, Trace


def test_a_whole_linear_move_at_tool_down_keeps_tool_down() -> None:
    """A = 180 throughout, though O and T are not defined; aside, and a turn about z."""
    bench = AsBench(program(*SQUARE, "LMOVE SHIFT(p BY 60,0,0)", "LMOVE p+RZ(20)", "BREAK",
                            "TWAIT 0.2"))  # fmt: skip
    tilts = []
    bench.machine.after_tick.append(
        lambda: tilts.append(bench.robot.pose_of(bench.robot.queue.q_command).rotation[2, 2])
    )
    start = bench.task.machine.here()
    bench.run()
    assert max(tilts) < -1.0 + 1e-9
    end = bench.task.machine.here()
    assert (end.x, end.y) == pytest.approx((start.x, start.y), abs=0.05)
    turned = (end.o - end.t) - (start.o - start.t)
    assert math.remainder(turned + 20.0, 360.0) == pytest.approx(0.0, abs=0.02)


def test_a_linear_motion_is_straight_and_has_the_programs_speed() -> None:
    """80 mm aside at 100 mm/s: never faster, on the line within a micrometre."""
    bench = AsBench(program(*SQUARE, "LMOVE SHIFT(p BY 80,0,0)", "BREAK"))
    trace = Trace(bench)
    bench.run()
    travel = trace.mm - trace.mm[0]
    assert np.abs(travel[:, 1:]).max() < 1e-3
    assert travel[-1, 0] == pytest.approx(80.0, abs=1e-3)
    assert trace.speed_mm_s.max() == pytest.approx(100.0, rel=0.01)
    assert np.diff(trace.speed_mm_s).max() < 2.0 + 1e-6  # 2 m/s^2 is 2 mm/s each ms


def corner(cp: str, accuracy_mm: float) -> tuple[AsBench, Trace]:
    """Go 40 mm aside and 40 mm across."""
    bench = AsBench(program(cp, *SQUARE, f"ACCURACY {accuracy_mm} ALWAYS",
                            "LMOVE SHIFT(p BY 40,0,0)", "LMOVE SHIFT(p BY 40,40,0)",
                            "BREAK"))  # fmt: skip
    trace = Trace(bench)
    bench.run()
    return bench, trace


def test_cp_on_cuts_the_corner_within_accuracy_and_does_not_stop() -> None:
    """The path misses the corner by less than ACCURACY, and a larger one misses it by more."""
    misses = []
    for accuracy_mm in (1.0, 5.0, 20.0):
        _, trace = corner("CP ON", accuracy_mm)
        travel = trace.mm - trace.mm[0]
        miss = np.linalg.norm(travel - [40.0, 0.0, 0.0], axis=1).min()
        middle = slice(np.argmax(travel[:, 0] > 20), np.argmax(travel[:, 1] > 20))
        assert 0.0 < miss <= accuracy_mm
        assert trace.speed_mm_s[middle].min() > 10.0
        misses.append(miss)
    assert misses[0] < misses[1]
    assert misses[2] == pytest.approx(misses[1], rel=0.2)  # it slows down over 2.5 mm at most


def test_the_program_runs_one_motion_ahead() -> None:
    """Steps behind LMOVE run while it moves; the next LMOVE waits until it is handed over."""
    bench = AsBench(program(*SQUARE, "LMOVE SHIFT(p BY 50,0,0)", "a = TIMER(0)",
                            "LMOVE SHIFT(p BY 100,0,0)", "b = TIMER(0)", "BREAK",
                            "c = TIMER(0)")).run()  # fmt: skip
    assert bench.value("a") < 0.02
    assert bench.value("b") == pytest.approx(0.5, abs=0.06)
    assert bench.value("c") == pytest.approx(1.07, abs=0.08)
