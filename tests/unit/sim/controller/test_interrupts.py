"""ON and ONI: a signal branches the program, after its motion or in the middle of it."""

import numpy as np
import pytest

from tests.fakes.as_bench import AsBench, program
from tests.unit.sim.controller.conftest import SQUARE, Trace

COUNT = ("WHILE n < 50 DO", "TWAIT 0.01", "n = n+1", "END")
SERVE = program("at = n", "served = served+1", name="serve")
ZEROS = ("n = 0", "at = -1", "served = 0")


def run(*lines: str, more: str = SERVE, sets: str = "SIGNAL 2001") -> AsBench:
    """Run a program; a PC program sets a signal after 0.2 s."""
    bench = AsBench(program(*ZEROS, "PCEXECUTE 5: later", *lines)
                    + program("TWAIT 0.2", sets, name="later") + more)  # fmt: skip
    bench.start()
    bench.advance(5.0, lambda: bench.task.state in ("idle", "stopped"))
    return bench


@pytest.mark.parametrize("word", ["ON", "ONI"])
@pytest.mark.parametrize(("signal", "sets"), [(2001, "SIGNAL 2001"), (-2002, "SIGNAL -2002")])
def test_an_edge_calls_the_program_once_and_the_rest_follows(
    word: str, signal: int, sets: str
) -> None:
    """Rising for a positive number, falling for a negative one; served once."""
    bench = run("SIGNAL 2002", f"{word} {signal} CALL serve", *COUNT, sets=sets)
    assert bench.codes == []
    assert bench.value("served") == 1
    assert 15 <= bench.value("at") <= 21
    assert bench.value("n") == 50


def test_a_state_is_no_edge_but_lvl_takes_it_and_err_refuses_it() -> None:
    """A signal that is there before: nothing, at once, E1070."""
    assert run("SIGNAL 2003", "ON 2003 CALL serve", *COUNT).value("served") == 0
    bench = run("SIGNAL 2003", "ON/LVL 2003 CALL serve", *COUNT)
    assert (bench.value("served"), bench.value("at")) == (1, 0)
    assert run("SIGNAL 2003", "ON/ERR 2003 CALL serve").codes == ["E1070"]
    assert run("ON/ERR 2001 CALL serve", *COUNT).value("served") == 1


def test_ignore_and_a_newer_interrupt_end_the_older_one() -> None:
    """For either edge of the signal; the priority must be 1 to 127."""
    assert run("ON 2001 CALL serve", "IGNORE 2001", *COUNT).value("served") == 0
    bench = run("ON 2001 CALL serve", "ON -2001 CALL serve", *COUNT)
    assert bench.value("served") == 0
    assert run("ON 2001 CALL serve,128").codes == ["E0106"]


def test_the_higher_priority_is_served_first_and_the_other_afterwards() -> None:
    """Two signals in one step."""
    more = program("order = order*10+1", name="one") + program("order = order*10+2", name="two")
    bench = run("order = 0", "ON 2001 CALL one", "ON 2002 CALL two,9", *COUNT, more=more,
                sets="SIGNAL 2001,2002")  # fmt: skip
    assert bench.value("order") == 21


def test_on_lets_the_motion_finish_and_oni_stops_it() -> None:
    """Then the subroutine runs, and the next step follows."""
    ends = []
    for word in ("ON", "ONI"):
        bench = AsBench(program(*ZEROS, *SQUARE, f"{word} 2001 CALL serve",
                                "LMOVE SHIFT(p BY 60,0,0)", "BREAK", "n = 1")
                        + program("d = DISTANCE(DEST,p)", name="serve"))  # fmt: skip
        trace = Trace(bench)
        bench.start().advance(0.3)
        bench.machine.hardware.signals.set(2001)
        bench.advance(3.0)
        assert bench.value("n") == 1
        ends.append((np.linalg.norm(trace.mm[-1] - trace.mm[0]), bench.value("d")))
    assert ends[0] == pytest.approx((60.0, 60.0), abs=0.1)
    assert 20.0 < ends[1][0] < 35.0


def test_a_pc_program_may_use_on_and_not_oni() -> None:
    """It does not wait for the arm."""
    pc = program("ON 2001 CALL serve", *COUNT, name="pc")
    bench = run("PCEXECUTE 1: pc", "TWAIT 1", more=SERVE + pc)
    assert bench.value("served") == 1
    pc = program("ONI 2001 CALL serve", name="pc")
    assert run("PCEXECUTE 1: pc", "TWAIT 1", more=SERVE + pc).codes == ["E1095"]
