"""Goals of the emulated arm: frames, relative motions, reach, arcs."""

import math

import numpy as np
import pytest

from tests.fakes.as_bench import AsBench, program
from tests.unit.sim.controller.conftest import SQUARE, Trace


@pytest.mark.parametrize(
    ("lines", "moved"),
    [
        (("DRAW 10,20,-5,0,0,0,50 MM/S",), (10, 20, -5)),
        (("TDRAW 10,20,-5,0,0,0,50 MM/S",), (10, -20, 5)),
        (("LDEPART 15",), (0, 0, 15)),
        (("LAPPRO p,25",), (0, 0, 25)),
        (("JAPPRO p,25",), (0, 0, 25)),
        (("LAPPRO SHIFT(p BY 5,0,0),25", "LMOVE SHIFT(p BY 5,0,0)"), (5, 0, 0)),
        (("LMOVE SHIFT(p BY 5,0,0)", "LDEPART 10", "LDEPART 10"), (5, 0, 20)),
        (("JMOVE SHIFT(p BY -7,8,9)",), (-7, 8, 9)),
        (("HMOVE SHIFT(p BY -7,8,9)",), (-7, 8, 9)),
        (("LMOVE #PPOINT(0,0,-90,0,-90,0)",), (0, 0, 0)),
        (("LMOVE SHIFT(p BY 0,5,0)", "HOME"), (0, 0, 0)),
        (("BASE TRANS(100,0,0)", "LMOVE p"), (100, 0, 0)),
        (("TOOL TRANS(0,0,20)", "LMOVE p"), (0, 0, 20)),
        (("TOOL TRANS(0,0,20)", "JMOVE p"), (0, 0, 20)),
        (("BASE TRANS(0,0,0,90)", "DRAW 10,0,0", "BREAK", "BASE NULL"), (0, 10, 0)),
        (("TOOL TRANS(0,0,100)", "LMOVE HERE+RX(10)"), (0, None, None)),
        (("TOOL TRANS(0,0,100)", "LMOVE HERE+RX(10)", "ALIGN"), (0, 0, 0)),
    ],
)  # fmt: skip
def test_every_motion_instruction_goes_to_its_target(lines, moved) -> None:
    """Displacement of the flange in the robot's base, with the tool down."""
    bench = AsBench(program("HERE p", "SPEED 50 MM/S ALWAYS", *lines, "BREAK", "TWAIT 0.1"))
    start = bench.robot.kinematics.flange_pose(bench.robot.q).translation
    bench.run()
    end = bench.robot.kinematics.flange_pose(bench.robot.q).translation
    for value, expected in zip((end - start) * 1e3, moved, strict=True):
        if expected is not None:
            assert value == pytest.approx(expected, abs=0.05)


@pytest.mark.parametrize(
    ("line", "code"),
    [
        ("LMOVE TRANS(0,2000,300,0,180,0)", "E6007"),
        ("JMOVE TRANS(0,2000,300,0,180,0)", "E6007"),
        ("JMOVE #[0,136,0,0,0,0]", "E6007"),
        ("DRIVE 1,181", "E6007"),
        ("POINT #j = TRANS(0,0,5000)", "E6007"),
        ("LMOVE #[0,0,90,0,90,0]", "E6007"),
    ],
)
def test_targets_that_cannot_be_reached_stop_before_anything_moves(line: str, code: str) -> None:
    """E6007: too far, or a joint beyond its limit, at the end or on the path."""
    bench = AsBench(program(line))
    trace = Trace(bench)
    assert bench.fail().code == code
    bench.advance(0.5)
    assert np.ptp(trace.mm, axis=0).max() < 1e-6


@pytest.mark.parametrize("side", [1, -1])
def test_three_points_give_an_arc_and_two_arcs_a_circle(side: int) -> None:
    """Radius 30 mm, the whole turn once, at the program's speed."""
    a, b, c = (f"SHIFT(p BY {x},{y * side},0)" for x, y in ((30, 30), (60, 0), (30, -30)))
    bench = AsBench(program(*SQUARE, f"C1MOVE {a}", f"C2MOVE {b}", f"C1MOVE {c}", "C2MOVE p"))
    trace = Trace(bench)
    bench.run()
    off = (trace.mm - trace.mm[0] - [30.0, 0.0, 0.0])[:, :2]
    assert np.abs(np.linalg.norm(off, axis=1) - 30.0).max() < 0.2
    angle = np.unwrap(np.arctan2(off[:, 1], off[:, 0]))
    assert (angle[-1] - angle[0]) == pytest.approx(-side * 2.0 * math.pi, abs=1e-3)
    assert trace.speed_mm_s.max() == pytest.approx(100.0, rel=0.02)
