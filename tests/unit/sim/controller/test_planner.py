"""Goals of the emulated arm: kinematics, frames, relative motions, reach."""

import math

import numpy as np
import pytest

from tests.fakes.as_bench import AsBench, program
from tests.fakes.as_trace import SQUARE, Trace

# JT1..JT6 -> X, Y, Z [mm]; where O, A, T are unique, those too [deg]. RS007L, null tool and base.
ACCEPTANCE = [
    ((0, 90, 0, 0, 0, 0), (0, 1008, 0), (90, 90, -90)),
    ((0, 0, -90, 0, -80, 0), (0, 488.545, 378.185), (90, 170, -90)),
    ((0, 0, -90, 0, -100, 0), (0, 461.455, 378.185), (-90, 170, 90)),
    ((10, 20, -30, 40, -50, 60), (64.163, 585.066, 730.048), (109.520, 92.084, -0.480)),
    ((-35, 25, -70, 15, -60, 120), (-415.050, 562.271, 302.572), (152.796, 151.272, 62.441)),
]
AT_A_POLE = [
    ((0, 0, 0, 0, 0, 0), (0, 0, 1008), (0, "O+T", 0)),
    ((0, 90, 90, 0, 0, 0), (0, 455, 553), (0, "O+T", 0)),
    ((0, 0, -90, 0, -90, 0), (0, 475, 377), (180, "O-T", 180)),
    ((90, 0, -90, 0, -90, 0), (475, 0, 377), (180, "O-T", 90)),
    ((0, 45, -90, 0, -45, 0), (0, 657.609, -92.142), (180, "O-T", 180)),
]


def joints(values) -> str:
    """A joint literal."""
    return "#[" + ",".join(str(value) for value in values) + "]"


def here(bench: AsBench) -> np.ndarray:
    """HERE."""
    return np.array(bench.task.machine.here().numbers())


@pytest.mark.parametrize(("q", "xyz", "oat"), ACCEPTANCE)
def test_here_after_jmove_is_the_vendors_forward_kinematics(q, xyz, oat) -> None:
    """Facts 3.3, measured at the simulated encoders."""
    bench = AsBench(program(f"JMOVE {joints(q)}", "BREAK", "TWAIT 0.3"))
    bench.run()
    assert here(bench)[:3] == pytest.approx(xyz, abs=0.1)
    assert here(bench)[3:] == pytest.approx(oat, abs=0.02)


@pytest.mark.parametrize(("q", "xyz", "angle"), AT_A_POLE)
def test_at_a_pole_of_a_only_the_sum_or_the_difference_counts(q, xyz, angle) -> None:
    """A = 0: O+T, A = 180: O-T (facts 3.3); destination, so without the servos' rest."""
    bench = AsBench(program(f"JMOVE {joints(q)}", "BREAK", "d = DEXT(DEST,1)")).run()
    pose = bench.task.machine.destination()
    a, kind, expected = angle
    assert (pose.x, pose.y, pose.z) == pytest.approx(xyz, abs=2e-3)
    assert pose.a == pytest.approx(a, abs=1e-3)
    total = pose.o + pose.t if kind == "O+T" else pose.o - pose.t
    assert math.remainder(total - expected, 360.0) == pytest.approx(0.0, abs=1e-3)


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


def test_a_turn_about_the_tools_point_leaves_that_point_where_it_is() -> None:
    """TOOL 150 mm out: 15 degrees about its x axis move the flange, not the tool."""
    bench = AsBench(program("TOOL TRANS(0,0,150)", "SPEED 50 MM/S ALWAYS", "LMOVE HERE+RX(15)",
                            "BREAK"))  # fmt: skip
    trace = Trace(bench)
    bench.start().advance(0.05)
    begin = len(trace.points)
    assert bench.advance(5.0, lambda: bench.task.state == "idle")
    assert np.ptp(trace.mm[begin:], axis=0).max() < 1e-3


def test_here_is_relative_to_a_frame_when_asked() -> None:
    """HERE a+b defines b, so that a+b is where the arm is."""
    bench = AsBench(program("POINT a = TRANS(10,20,30,40,50,60)", "HERE a+b",
                            "d = DISTANCE(a+b, HERE)")).run()  # fmt: skip
    assert bench.value("d") == pytest.approx(0.0, abs=1e-3)


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


def test_a_motion_ahead_that_cannot_be_reached_fails_at_its_own_step() -> None:
    """The present motion is braked; the message names the step of the bad one."""
    bench = AsBench(program(*SQUARE, "LMOVE SHIFT(p BY 50,0,0)", "LMOVE SHIFT(p BY 0,2000,0)"))
    assert bench.fail().code == "E6007"
    assert bench.stopped_at == ("main", 4)
