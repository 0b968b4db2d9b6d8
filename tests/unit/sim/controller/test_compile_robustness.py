"""No instruction, with any arguments, makes the emulator fail except with an error of AS."""

from hypothesis import given, settings
from hypothesis import strategies as st

from sim.as_language import keywords
from sim.as_language.errors import AsError, AsSyntaxError
from tests.fakes.as_bench import AsBench, program

WORDS = st.sampled_from(sorted(keywords.EMULATED - {"SWITCH"}))
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


@settings(max_examples=200, deadline=None)
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
