"""Arcs by three points, XMOVE, ALIGN, the monitor speed of a program, and clamps."""

import math
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.as_language.errors import AsError
from sim.controller.planner import circle_center_m
from tests.fakes.as_bench import AsBench, program
from tests.unit.sim.controller.conftest import SQUARE, Trace

POINT = st.tuples(*[st.floats(-2.0, 2.0)] * 3).map(np.array)


def at(x: float, y: float, z: float = 0.0) -> str:
    """A location relative to the start of the arm."""
    return f"SHIFT(p BY {x},{y},{z})"


def traced(*lines: str) -> tuple[AsBench, Trace]:
    """A program that starts at p, executed; its path is traced."""
    bench = AsBench(program(*SQUARE, *lines, "BREAK"))
    trace = Trace(bench)
    bench.run()
    return bench, trace


def codes(*lines: str) -> list[str]:
    """The errors of a program that starts at p."""
    return [AsBench(program(*SQUARE, *lines)).fail().code]


# --- arcs -----------------------------------------------------------------------------------------


@given(POINT, POINT, POINT)
def test_the_center_is_as_far_from_each_of_three_points_and_in_their_plane(a, b, c) -> None:
    """Or they are on a line."""
    u, v = b - a, c - a
    lengths = float(np.linalg.norm(u) * np.linalg.norm(v))
    if np.linalg.norm(np.cross(u, v)) < 1.001e-4 * max(lengths, 1e-3):
        with suppress(AsError):
            circle_center_m(a, b, c)
        return
    center = circle_center_m(a, b, c)
    radii = [float(np.linalg.norm(center - point)) for point in (a, b, c)]
    assert radii == pytest.approx([radii[0]] * 3, rel=1e-6)
    normal = np.cross(b - a, c - a)
    assert float(normal @ (center - a)) == pytest.approx(
        0.0, abs=1e-6 * radii[0] * float(np.linalg.norm(normal))
    )


@pytest.mark.parametrize("side", [1, -1])
def test_three_points_give_an_arc_and_two_arcs_a_circle(side: int) -> None:
    """Radius 30 mm within a micrometre, the whole turn once, at the program's speed."""
    y = 30 * side
    _, trace = traced(f"C1MOVE {at(30, y)}", f"C2MOVE {at(60, 0)}", f"C1MOVE {at(30, -y)}",
                      "C2MOVE p")  # fmt: skip
    off = (trace.mm - trace.mm[0] - [30.0, 0.0, 0.0])[:, :2]
    assert np.abs(np.linalg.norm(off, axis=1) - 30.0).max() < 0.2
    angle = np.unwrap(np.arctan2(off[:, 1], off[:, 0]))
    assert (angle[-1] - angle[0]) == pytest.approx(-side * 2.0 * math.pi, abs=1e-3)
    assert trace.speed_mm_s.max() == pytest.approx(100.0, rel=0.02)


def test_a_motion_after_c1move_alone_is_e1097_and_c2move_alone_e1098() -> None:
    """The pair belongs together; the next program starts without a point."""
    for motion in (f"LMOVE {at(40, 0)}", f"XMOVE {at(40, 0)} TILL 2001", "ALIGN", "DELAY 1"):
        assert codes(f"C1MOVE {at(20, 20)}", motion) == ["E1097"]
    assert codes(f"C2MOVE {at(20, 20)}") == ["E1098"]
    bench = AsBench(program(*SQUARE, f"C1MOVE {at(20, 20)}")
                    + program(f"LMOVE {at(5, 0)}", "BREAK", name="next_one"))  # fmt: skip
    bench.run()
    bench.run("next_one")


# --- XMOVE ----------------------------------------------------------------------------------------

LATER = program("TWAIT 0.4", "SIGNAL s", name="later")


def xmove(
    mode: str, signal: int, *, before: bool, sets: int | None = None
) -> tuple[AsBench, Trace]:
    """Go 80 mm aside until a signal that another program sets after 0.4 s."""
    bench = AsBench(program(*SQUARE, f"s = {signal if sets is None else sets}",
                            "PCEXECUTE 1: later", f"XMOVE{mode} {at(80, 0)} TILL {signal}",
                            "t = TIMER(0)", "n = 1") + LATER)  # fmt: skip
    bench.machine.hardware.signals.set(abs(signal) if before == (signal > 0) else -abs(signal))
    trace = Trace(bench)
    bench.start()
    bench.advance(3.0, lambda: bench.task.state in ("idle", "stopped"))
    return bench, trace


@pytest.mark.parametrize("signal", [2001, -2001])
def test_xmove_stops_at_the_edge_of_its_signal_and_the_next_step_follows(signal: int) -> None:
    """Rising for a positive number, falling for a negative one; without an edge p is reached."""
    bench, trace = xmove("", signal, before=False)
    assert bench.codes == []
    assert 30.0 < (trace.mm[-1] - trace.mm[0])[0] < 45.0
    assert bench.value("t") == pytest.approx(0.45, abs=0.06)
    bench, trace = xmove("", signal, before=True)
    assert (trace.mm[-1] - trace.mm[0])[0] == pytest.approx(80.0, abs=1e-3)
    bench, trace = xmove("", signal, before=False, sets=2002)
    assert (trace.mm[-1] - trace.mm[0])[0] == pytest.approx(80.0, abs=1e-3)
    assert bench.value("n") == 1


# --- clamps ---------------------------------------------------------------------------------------


def clamped(*lines: str) -> tuple[AsBench, list[tuple[str, float]]]:
    """Run a program; return the reports of its clamps and how far the arm was [mm]."""
    bench = AsBench(program(*SQUARE, *lines, "TWAIT 0.1"))
    trace, reports = Trace(bench), []

    def note(line: str) -> None:
        reports.append((line, float((trace.mm[-1] - trace.mm[0])[0])))

    bench.machine.hardware.print_line = note
    bench.run()
    return bench, reports


def test_the_clamp_of_a_motion_acts_at_its_end() -> None:
    """Positive closes, negative opens; a motion that is braked leaves it as it is."""
    _, reports = clamped("CP OFF", f"LMOVE {at(20, 0)},1", f"JMOVE {at(40, 0)},-2",
                      f"C1MOVE {at(50, 10)}", f"C2MOVE {at(60, 0)},3", "BREAK")  # fmt: skip
    assert [line for line, _ in reports] == ["clamp 1: closed", "clamp 2: open", "clamp 3: closed"]
    assert [mm for _, mm in reports] == pytest.approx([20.0, 40.0, 60.0], abs=2.0)
    early = "PREFETCH.SIGINS ON"  # TWAIT does not wait for the motion
    assert clamped(early, f"LMOVE {at(20, 0)},1", "TWAIT 0.1", "BRAKE")[1] == []


def test_accuracy_0_stops_in_every_point() -> None:
    """As public programs ask for; a negative one is E0106."""
    _, trace = traced("ACCURACY 0 ALWAYS", f"LMOVE {at(20, 0)}", f"LMOVE {at(20, 20)}")
    corner = np.linalg.norm(trace.mm - trace.mm[0] - [20.0, 0.0, 0.0], axis=1)
    assert corner.min() < 1e-3
    assert trace.speed_mm_s[int(corner.argmin()) - 1] < 5.0
    assert codes("ACCURACY -1") == ["E0106"]
