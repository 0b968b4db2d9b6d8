"""Control flow, subroutines and cycles of AS programs, executed on a virtual clock."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.controller.behaviour import Behaviour
from tests.fakes.as_bench import AsBench, program

SMALL = st.integers(-20, 20)


def ran(*lines: str) -> AsBench:
    """A program of these steps, executed."""
    return AsBench(program(*lines)).run()


@settings(max_examples=40)
@given(SMALL, SMALL, SMALL.filter(bool))
def test_for_runs_as_often_as_a_counting_loop_and_keeps_the_first_value_beyond(
    start: int, stop: int, step: int
) -> None:
    """Zero trips are possible; the variable ends on the first value that is not in the loop."""
    bench = ran("n = 0", f"FOR i = {start} TO {stop} STEP {step}", "n = n+1", "END")
    beyond = stop + 1 if step > 0 else stop - 1
    inside = range(start, beyond, step)
    assert bench.value("n") == len(inside)
    assert bench.value("i") == start + step * len(inside)


def test_for_computes_its_end_and_step_once() -> None:
    """Changing them in the body changes nothing."""
    bench = ran("e = 3", "s = 1", "n = 0", "FOR i = 1 TO e STEP s", "e = 99", "s = 7", "n = n+1",
                "END")  # fmt: skip
    assert bench.value("n") == 3


def test_nested_for_loops_start_anew_each_time() -> None:
    """The inner loop computes its bounds again for every round of the outer one."""
    bench = ran("n = 0", "FOR i = 1 TO 4", "FOR j = 1 TO i", "n = n+1", "END", "END")
    assert bench.value("n") == 10


def test_goto_may_leave_a_loop_and_the_loop_may_be_entered_again() -> None:
    """A loop that was left in the middle counts from its start the next time."""
    bench = ran("k = 0", "n = 0", "again:", "FOR i = 1 TO 5", "n = n+1", "GOTO out IF i == 3",
                "END", "out:", "k = k+1", "GOTO again IF k < 2")  # fmt: skip
    assert bench.value("n") == 6


@pytest.mark.parametrize(("x", "branch"), [(1, 10), (2, 20), (3, 20), (9, 99)])
def test_case_takes_the_first_equal_branch_and_no_other(x: int, branch: int) -> None:
    """No fall-through; ANY is for everything else."""
    bench = ran(f"CASE {x} OF", "VALUE 1:", "r = 10", "VALUE 2,3:", "r = 20", "VALUE 2:",
                "r = 30", "ANY :", "r = 99", "END")  # fmt: skip
    assert bench.value("r") == branch


def test_case_without_any_runs_nothing() -> None:
    """No equal value and no ANY: on behind END."""
    assert ran("r = 0", "CASE 5 OF", "VALUE 1:", "r = 1", "END", "q = 2").value("r") == 0


def test_while_tests_first_and_do_until_tests_last() -> None:
    """A false WHILE runs never, a true UNTIL runs once."""
    bench = ran("w = 0", "WHILE w > 0 DO", "w = w+1", "END", "d = 0", "DO", "d = d+1", "UNTIL TRUE")
    assert (bench.value("w"), bench.value("d")) == (0, 1)


@given(st.booleans(), st.booleans())
def test_if_and_else_exclude_each_other_also_nested(a: bool, b: bool) -> None:
    """Exactly the branch of the conditions runs."""
    bench = ran(f"IF {int(a)} THEN", f"IF {int(b)} THEN", "r = 1", "ELSE", "r = 2", "END", "ELSE",
                "r = 3", "END")  # fmt: skip
    assert bench.value("r") == (3 if not a else 1 if b else 2)


def test_parameters_are_passed_by_reference_and_locals_are_the_calls_own() -> None:
    """A value stored into a parameter is the caller's; the locals are new at each call."""
    sub = ".PROGRAM add(.a, .sum)\n.b = .a\n.sum = .sum + .b\n.END\n"
    bench = AsBench(program("t = 1", ".b = 7", "CALL add(5, t)", "CALL add(.b, t)", "u = .b") + sub)
    bench.run()
    assert (bench.value("t"), bench.value("u")) == (13, 7)


def test_calls_nest_to_20_levels_and_no_deeper() -> None:
    """20 levels work, the 21st is E0112."""

    def chain(depth: int) -> str:
        subs = "".join(
            f".PROGRAM s{k}()\n{f'CALL s{k + 1}' if k < depth else f'n = {depth}'}\n.END\n"
            for k in range(1, depth + 1)
        )
        return program("CALL s1") + subs

    assert AsBench(chain(20)).run().value("n") == 20
    assert AsBench(chain(21)).fail().code == "E0112"


def test_return_leaves_a_subroutine_and_ends_the_main_program() -> None:
    """Steps behind RETURN are not executed."""
    sub = ".PROGRAM s()\nx = 1\nRETURN\nx = 2\n.END\n"
    bench = AsBench(program("CALL s", "y = 1", "RETURN", "y = 2") + sub).run()
    assert (bench.value("x"), bench.value("y")) == (1, 1)


def test_scall_calls_by_name_and_reports_instead_of_stopping() -> None:
    """An unknown name is a code in the result; without a result it stops the program."""
    sub = ".PROGRAM s()\nx = 1\n.END\n"
    bench = AsBench(program('SCALL "s", r', 'SCALL "none", q') + sub).run()
    assert (bench.value("x"), bench.value("r"), bench.value("q")) == (1, 0, -30105)
    assert AsBench(program('SCALL "none"')).fail().code == "E0105"


def test_the_main_program_runs_as_many_cycles_as_asked() -> None:
    """EXECUTE main,3 runs three times; a negative number runs for ever."""
    bench = AsBench(program("n = n+1"))
    bench.machine.memory.write("n", 0.0)
    bench.start(cycles=3).advance(0.1)
    assert (bench.value("n"), bench.task.state) == (3, "idle")
    bench.start(cycles=-1).advance(0.1)
    assert bench.value("n") > 100
    assert bench.task.state == "running"


def test_stop_begins_the_next_cycle_and_halt_ends_all() -> None:
    """STOP restarts the main program when cycles remain, HALT does not."""
    for word, rounds in (("STOP", 3), ("HALT", 1)):
        sub = f".PROGRAM s()\n{word}\n.END\n"
        bench = AsBench(program("n = n+1", "CALL s", "n = 100") + sub)
        bench.machine.memory.write("n", 0.0)
        bench.start(cycles=3).advance(0.2)
        assert (bench.value("n"), bench.task.state) == (rounds, "idle")


def test_pause_holds_the_program_and_continue_goes_on_behind_it() -> None:
    """Steps behind PAUSE run only after CONTINUE."""
    bench = AsBench(program("x = 1", "PAUSE", "x = 2")).start()
    bench.advance(0.5)
    assert (bench.value("x"), bench.task.state) == (1, "held")
    bench.pendant.run()
    bench.advance(0.1)
    assert (bench.value("x"), bench.task.state) == (2, "idle")


@pytest.mark.parametrize("step_ms", [0.1, 0.5, 2.0])
def test_every_step_costs_the_processor_the_same_time(step_ms: float) -> None:
    """A loop of two steps makes 1 s / (2 steps) rounds."""
    bench = AsBench(program("n = 0", "WHILE TRUE DO", "n = n+1", "END"),
                    Behaviour(step_s=step_ms * 1e-3)).start()  # fmt: skip
    bench.advance(1.0)
    assert bench.value("n") == pytest.approx(1000.0 / step_ms / 3, rel=0.01)


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


def test_a_program_that_the_file_does_not_hold_is_e0105() -> None:
    """CALL of an unknown program stops at that step."""
    bench = AsBench(program("x = 1", "CALL missing"))
    assert bench.fail().code == "E0105"
    assert bench.stopped_at == ("main", 2)


def test_goto_to_a_missing_label_is_e0101() -> None:
    """The error comes when the step is executed, with its number."""
    bench = AsBench(program("x = 1", "", "GOTO nowhere"))
    assert bench.fail().code == "E0101"
    assert bench.stopped_at == ("main", 2)


def test_point_defines_the_rightmost_of_a_compound_location() -> None:
    """Relative to the rest, as HERE does; a component of it, too. An undefined rest is E0103."""
    bench = ran("POINT a = TRANS(100,0,0,90)", "POINT c = TRANS(10,20,30,40,50,60)",
                "POINT a+b = c", "POINT d = a+b", "x = DISTANCE(c,d)", "POINT/Z a+b = TRANS(0,0,7)",
                "z = DZ(b)", "y = DX(b)")  # fmt: skip
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


def test_joint_values_are_a_goal_of_lappro_and_a_configuration_of_point() -> None:
    """20 mm before a place 50 mm below is 30 mm below."""
    bench = ran("HERE p", "POINT #q = SHIFT(p BY 0,0,-50)", "POINT #r = p,#q",
                "e = DISTANCE(#r,p)", "LAPPRO #q,20", "BREAK", "d = DISTANCE(DEST,p)")  # fmt: skip
    assert bench.value("d") == pytest.approx(30.0, abs=0.01)
    assert bench.value("e") == pytest.approx(0.0, abs=0.01)
