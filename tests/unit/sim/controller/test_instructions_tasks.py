"""Parallel programs, errors and their handlers, the monitor behind MC, waiting and PROMPT."""

from collections import deque

import pytest

from tests.fakes.as_bench import FAST, AsBench, program


def test_motion_instructions_stop_a_pc_program_with_e1095() -> None:
    """Every one of them but BRAKE."""
    moves = ("LMOVE #[0,0,-90,0,-90,0]", "JMOVE HERE", "DRIVE 1,5", "HOME", "SPEED 10 ALWAYS",
             "TOOL NULL", "DELAY 1", "LDEPART 10", "DRAW 1,0,0", "MVWAIT 5")  # fmt: skip
    for move in moves:
        bench = AsBench(program("PCEXECUTE 1: other", "TWAIT 0.1")
                        + program(move, name="other")).start()  # fmt: skip
        bench.advance(0.2)
        assert bench.codes == ["E1095"], move
    bench = AsBench(program("PCEXECUTE 1: other", "TWAIT 0.1") + program("BRAKE", name="other"))
    assert bench.run().codes == []


def test_an_error_of_a_pc_program_stops_that_program_only() -> None:
    """The robot program continues; the error names program and step, and ERROR has its number."""
    other = program("TWAIT 0.1", "x = 1/0", name="other")
    bench = AsBench(program("PCEXECUTE 4: other", "TWAIT 0.3", "e = ERROR", "t = TASK(1004)",
                            "c = SYSDATA(ERROR.CODE)")
                    + other).start()  # fmt: skip
    bench.advance(1.0)
    assert bench.task.state == "idle"
    assert [bench.value(name) for name in "etc"] == [-30108, 0, -30108]
    stop = bench.machine.stops[0]
    assert (stop.error.code, stop.program, stop.step) == ("E0108", "other", 2)
    assert "other" in str(stop)
    assert "step 2" in str(stop)


def test_an_error_while_a_step_waits_belongs_to_that_step() -> None:
    """WAIT 1/c fails once c is 0: the message, CONTINUE and RETURNE take it for the WAIT's step."""
    other = program("TWAIT 0.1", "c = 0", name="other")
    handler = program("n = n+1", "RETURNE", name="handler")
    lines = ("c = -1", "n = 0", "a = 0", "PCEXECUTE 1: other", "WAIT 1/c > 0", "a = a+1")
    bench = AsBench(program(*lines) + other)
    assert bench.fail().code == "E0108"
    assert bench.stopped_at == ("main", 5)
    bench.machine.memory.write("c", -1.0)
    bench.pendant.error_reset()
    bench.pendant.run()
    bench.advance(0.2)
    assert (bench.value("a"), bench.task.state) == (0, "running")
    bench.machine.memory.write("c", 1.0)
    bench.advance(0.1)
    assert (bench.value("a"), bench.task.state) == (1, "idle")
    handled = AsBench(program("ONE handler", *lines) + other + handler).start()
    handled.advance(0.3)
    assert (handled.value("n"), handled.value("a"), handled.task.state) == (1, 1, "idle")


def test_an_error_in_the_handler_stops_the_program() -> None:
    """Handlers are not handled, and they must not move the arm."""
    for line, code in (("x = 1/0", "E0108"), ("LMOVE HERE", "P0111")):
        handler = program(line, "RETURNE", name="handler")
        bench = AsBench(program("ONE handler", "x = 1/0") + handler)
        assert bench.fail().code == code


def test_the_same_program_gives_the_same_run() -> None:
    """Everything on the virtual clock is repeatable, to the step."""
    source = program("HERE p", "FOR i = 1 TO 3", "LMOVE SHIFT(p BY 0,5*i,0)", "END", "BREAK",
                     "t = TIMER(0)", "DECOMPOSE x[0] = HERE")  # fmt: skip
    first, second = AsBench(source, FAST).run(), AsBench(source, FAST).run()
    assert first.machine.steps == second.machine.steps
    assert [first.value(n) for n in ("t", "x[0]", "x[1]", "x[2]")] == [
        second.value(n) for n in ("t", "x[0]", "x[1]", "x[2]")
    ]


# --- waiting, values out of range, PROMPT ---------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "code"),
    [
        ("TIMER 11 = 0", "E0106"), ("t = TIMER(11)", "E0106"), ("TWAIT -1", "E0106"),
        ("x = y", "E0102"), ("LMOVE q", "E0103"), ("$a = $b", "E0104"), ("JMOVE #j", "E0103"),
        ("SPEED 0", "E0106"), ("SPEED 101", "E0106"), ("SPEED 0.05 S", "E0106"),
        ("ACCEL 0", "E0106"), ("DECEL 100.5", "E0106"), ("ACCURACY -1", "E0106"),
        ("SPEED 10, 20 DEG/S", "E0111"), ("TCP_LISTEN r, 80", "E0106"),
        ("TCP_LISTEN 5, 49152", "P0118"), ("DRIVE 7, 1", "E0106"), ("LOCK 200", "E0106"),
        ("PCEXECUTE 1: missing", "E0105"), ("ONE missing", "E0105"),
        ("PCEXECUTE 6: main", "E0106"), ('SCALL "missing"', "E0105"), ("BITS 1,17 = 1", "E0106"),
        ("BITS32 1,33 = 1", "E0106"), ("UTIMER a = 0", "P0118"), ("UTIMER @a = -1", "E0106"),
        ('PROMPT "how many", a', "E4012"), ("PROMPT", "P0100"), ("IFPWPRINT", "P0100"),
        ("XMOVE HERE", "P0100"), ("MON_SPEED 0", "E0106"), ("x = IQARM(7)", "E0106"),
        ("x = TRQNM(0)", "E0106"), ("RETURNE", "P0111"),
        ("POWER OFF", "P0111"), ("SIGNAL 0", "E0106"), ("SIGNAL 961", "E0106"),
        ("SIGNAL 1001", "E0106"), ("SIGNAL 3000", "E0106"), ("SIGNAL -1500", "E0106"),
    ],
)  # fmt: skip
def test_impossible_values_stop_the_program_with_their_code(line: str, code: str) -> None:
    """The code names the mistake."""
    assert AsBench(program(line)).fail().code == code


def typed(line: str, *steps: str) -> AsBench:
    """Run steps that wait for a line of the keyboard, which comes after 0.1 s."""
    bench = AsBench(program(*steps))
    bench.machine.hardware.keyboard = deque()
    bench.start().advance(0.1)
    assert bench.task.state == "running"
    bench.pendant.type_line(line)
    bench.advance(0.1)
    return bench


@pytest.mark.parametrize(
    ("line", "values"),
    [("1 2", (1, 2)), ("1.5, -2E1,7", (1.5, -20)), ("^HFF", (255, 0)), ("", (0, 0))],
)
def test_prompt_reads_numbers_that_are_typed(line: str, values: tuple[float, float]) -> None:
    """Blanks or commas between them, 0 for those that are missing, the rest is ignored."""
    bench = typed(line, 'PROMPT 2: "how many", a, b[3]')
    assert bench.printed == ["how many>"]
    assert (bench.value("a"), bench.value("b[3]")) == values
    assert typed("abc", 'PROMPT "how many", a').codes == ["P0100"]
