"""Errors of steps that wait, and of impossible values."""

import pytest

from tests.fakes.as_bench import AsBench, program


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
