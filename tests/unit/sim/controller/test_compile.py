"""Shares of the processor, compound locations, and any instruction with any arguments."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.as_language.errors import AsError, AsSyntaxError
from sim.as_language.keywords import EMULATED
from sim.controller.compile import INSTRUCTIONS
from tests.fakes.as_bench import AsBench, program


def test_tasks_share_the_processor_evenly_and_waiting_costs_nothing() -> None:
    """Three counting programs get a third each, next to two that wait."""
    count = "\n".join("{0} = 0,WHILE TRUE DO,{0} = {0}+1,END".replace(",", "\n").format("n{}")
                      for _ in range(1))  # fmt: skip
    subs = "".join(f".PROGRAM c{k}()\n{count.format(*[k] * 3)}\n.END\n" for k in (1, 2))
    waits = ".PROGRAM w1()\nWAIT n0 < 0\n.END\n.PROGRAM w2()\nTWAIT 100\n.END\n"
    start = [f"PCEXECUTE {k}: {name}" for k, name in enumerate(("c1", "c2", "w1", "w2"), start=1)]
    bench = AsBench(program("n0 = 0", *start, "WHILE TRUE DO", "n0 = n0+1", "END") + subs + waits)
    bench.start().advance(1.0)
    counts = [bench.value(f"n{k}") for k in range(3)]
    assert max(counts) - min(counts) <= 5
    assert sum(counts) == pytest.approx(1.0 / 2e-5 / 3, rel=0.01)


def test_point_defines_the_rightmost_of_a_compound_location() -> None:
    """Relative to the rest, as HERE does; a component of it, too. An undefined rest is E0103."""
    lines = (
        "POINT a = TRANS(100,0,0,90)", "POINT c = TRANS(10,20,30,40,50,60)", "POINT a+b = c",
        "POINT d = a+b", "x = DISTANCE(c,d)", "POINT/Z a+b = TRANS(0,0,7)", "z = DZ(b)",
        "y = DX(b)",
    )  # fmt: skip
    bench = AsBench(program(*lines)).run()
    assert bench.value("x") == pytest.approx(0.0, abs=1e-3)
    assert bench.value("z") == pytest.approx(7.0, abs=1e-4)
    assert bench.value("y") == pytest.approx(20.0, abs=1e-4)
    assert AsBench(program("POINT q+b = NULL")).fail().code == "E0103"


@pytest.mark.parametrize(
    ("lines", "code"),
    [(("HERE p", "POINT/EXT q = p"), "E0111"), (("MVWAIT 1 S",), "E0111"),
     (("SPEED 5 DEG/S",), "E0111"), (("x = SWITCH(WIBBLE)",), "P0116"),
     (("x = TASK(7)",), "E0106"), (("GOTO 5", "FOR i = 1 TO 2", "5 x = 1", "END"), "P0141")],
)  # fmt: skip
def test_a_step_that_cannot_be_executed_stops_with_its_code(
    lines: tuple[str, ...], code: str
) -> None:
    """Options of a controller, names that do not exist, and a loop that GOTO has entered."""
    assert AsBench(program(*lines)).fail().code == code


# --- the tables of the compiler, and anything at all ----------------------------------------------


def test_the_instructions_that_are_executed_are_those_that_the_language_lists() -> None:
    """The check of a file reports all others."""
    assert set(INSTRUCTIONS) == EMULATED


WORDS = st.sampled_from(sorted(EMULATED - {"SWITCH"}))
MODES = st.sampled_from(["", "", "/ERR", "/LVL"])
SPELLED = """
    1 -1 0 2 1001 2001 -2001 x a[1] $s "txt" p #j HERE #HERE NULL @n .l main 9999 1E9 0.5
    TRANS(1,2,3) undefined ON #[0,0,-90,0,-90,0] RX(5) other $t[1] ip[1]
"""
PHRASES = ["", "1 MM/S", "x AND 2001", "SHIFT(HERE BY 5,0,0)", "CALL other", "GOTO 10", "TILL 2001"]
ARGUMENTS = st.sampled_from([*SPELLED.split(), *PHRASES])
BETWEEN = st.sampled_from([",", ",", "=", " "])
DEFINED = (
    "x = 1", "a[1] = 2", '$s = "x"', '$t[1] = "a"', "HERE p", "HERE #j", "@n = 3", ".l = 1",
    "ip[1] = 127", "ip[2] = 0", "ip[3] = 0", "ip[4] = 1",
)  # fmt: skip


@st.composite
def instructions(draw: st.DrawFn) -> str:
    """A line with an instruction, its mode, the number before a colon, and arguments."""
    given_ones = draw(st.lists(ARGUMENTS, max_size=6))
    before = draw(st.sampled_from(["", "", "1: ", "2: "]))
    return f"{draw(WORDS)}{draw(MODES)} {before}{draw(BETWEEN).join(given_ones)}"


@settings(max_examples=80, deadline=None)
@given(instructions(), instructions())
def test_a_program_runs_or_stops_with_an_error_of_as(first: str, second: str) -> None:
    """Also when a signal comes, the pendant holds, and the program continues."""
    try:
        bench = AsBench(program(*DEFINED, first, second, "10 x = 2") + program(name="other"))
    except AsSyntaxError:
        return
    bench.start().advance(0.02)
    bench.machine.hardware.signals.set(2001)
    bench.advance(0.02)
    bench.pendant.hold()
    try:
        bench.pendant.run()
    except AsError:
        assert bench.machine.control.error is not None or not bench.robot.motor_power
    bench.advance(0.02)
    assert all(stop.error.code for stop in bench.machine.stops)
