"""SOUT, RUNMASK, DLYSIG and BITS32; interrupts have a file of their own."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.fakes.as_bench import AsBench, program


@given(st.booleans(), st.booleans(), st.booleans())
def test_sout_is_the_logic_of_the_signals_whose_numbers_it_names(a: bool, b: bool, c: bool) -> None:
    """AND, OR, XOR, NOT, parentheses, a comparison, and a signal alone."""
    bench = AsBench(program("SOUT 1 = 1001 AND (NOT 1002 OR 2003)", "SOUT 2 = NOT 1001",
                            "x = 3", "SOUT 3 = 1001 XOR x == 3", "SOUT -4 = SIG(1002)",
                            "SOUT 2005 = -1001", "s = 1002", "SOUT 6 = s"))  # fmt: skip
    signals = bench.machine.hardware.signals
    for number, state in ((1001, a), (1002, b), (2003, c)):
        signals.set(number if state else -number)
    bench.run()
    expected = {1: a and (not b or c), 2: not a, 3: not a, 4: b, 2005: not a, 6: b}
    assert {number: signals.holds(number) for number in expected} == expected


@pytest.mark.parametrize("stop", ["hold", "abort", "error"])
def test_masked_signals_are_off_while_the_program_does_not_run(stop: str) -> None:
    """Others keep their state; when the program continues they are on again."""
    bench = AsBench(program("RUNMASK 5,2", "RUNMASK 2001", "RUNMASK 2002", "RUNMASK -2002",
                            "SIGNAL 5,-6,7,2001,2002", "TWAIT 0.2", "x = 1/d",
                            "TWAIT 0.2")).start()  # fmt: skip
    signals = bench.machine.hardware.signals

    def lit() -> set[int]:
        return {number for number in (5, 6, 7, 2001, 2002) if signals.holds(number)}

    bench.machine.memory.write("d", 0.0 if stop == "error" else 1.0)
    bench.advance(0.1)
    assert lit() == {5, 7, 2001, 2002}
    if stop == "error":
        bench.advance(0.2)
    else:
        getattr(bench.pendant, stop)()
    bench.advance(0.1)
    assert lit() == {7, 2002}
    if stop != "hold":
        return
    bench.pendant.run()
    bench.advance(0.05)
    assert lit() == {5, 7, 2001, 2002}
    bench.advance(1.0)
    assert lit() == {7, 2002}


def test_dlysig_switches_later_and_does_not_wait() -> None:
    """On and off."""
    bench = AsBench(program("SIGNAL 8", "DLYSIG 7,0.2", "DLYSIG -8,0.1", "t = TIMER(0)",
                            "SWAIT -8", "u = TIMER(0)", "SWAIT 7",
                            "v = TIMER(0)")).run()  # fmt: skip
    times = [bench.value(name) for name in "tuv"]
    assert times == pytest.approx([0.0, 0.1, 0.2], abs=0.003)
