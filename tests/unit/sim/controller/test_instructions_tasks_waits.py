"""Waiting, timers, signals, switches, PRINT, and values out of range."""

from collections import deque

import pytest

from sim.controller.behaviour import pessimistic
from tests.fakes.as_bench import AsBench, program

FOREVER = ("WHILE TRUE DO", "TWAIT 0.01", "END")


def test_twait_lasts_as_long_as_asked_to_the_millisecond() -> None:
    """TIMER reads the same as TWAIT waited."""
    bench = AsBench(program("TIMER 1 = 0", "TWAIT 0.25", "t = TIMER(1)")).run()
    assert bench.value("t") == pytest.approx(0.25, abs=0.0015)


def test_timers_run_from_their_set_value() -> None:
    """TIMER 2 = 5 reads 5 and a bit; TIMER(0) is the time since power-on; TIMER(3) = 0 too."""
    bench = AsBench(program("TIMER 2 = 5", "TIMER(3) = 0", "TWAIT 1", "a = TIMER(2)",
                            "b = TIMER(0)", "c = TIMER(3)")).run()  # fmt: skip
    assert bench.value("a") == pytest.approx(6.0, abs=0.005)
    assert bench.value("b") == pytest.approx(1.0, abs=0.005)
    assert bench.value("c") == pytest.approx(1.0, abs=0.005)


def test_a_coarse_timer_moves_in_steps_of_16_ms() -> None:
    """The pessimistic controller's TIMER is a multiple of 16 ms, never ahead of the time."""
    lines = ("FOR i = 1 TO 50", "TWAIT 0.001", "t[i] = TIMER(0)", "u[i] = t[i]/0.016", "END")
    bench = AsBench(program(*lines), pessimistic(2e-5)).run()
    units = [bench.value(f"u[{k}]") for k in range(1, 51)]
    assert all(abs(unit - round(unit)) < 1e-4 for unit in units)
    assert len({round(unit) for unit in units}) > 2
    assert bench.value("t[50]") <= bench.now_s


def test_wait_goes_on_when_another_program_makes_the_condition_true() -> None:
    """Globals are shared; the wait ends within a tick."""
    other = program("TWAIT 0.3", "n = 101", name="other")
    bench = AsBench(program("n = 0", "TIMER 1 = 0", "PCEXECUTE 2: other", "WAIT n > 100",
                            "t = TIMER(1)") + other).run()  # fmt: skip
    assert bench.value("t") == pytest.approx(0.3, abs=0.003)


def test_signals_are_shared_by_programs_and_swait_reads_them() -> None:
    """SWAIT waits for all of its signals; a negative number waits for OFF."""
    other = program("TWAIT 0.1", "SIGNAL 2001", "TWAIT 0.1", "SIGNAL -2002", name="other")
    bench = AsBench(program("SIGNAL 2002, 17", "TIMER 1 = 0", "PCEXECUTE other",
                            "SWAIT 2001, -2002, 17", "t = TIMER(1)", "a = SIG(2001)",
                            "b = SIG(2002)") + other).run()  # fmt: skip
    assert bench.value("t") == pytest.approx(0.2, abs=0.003)
    assert (bench.value("a"), bench.value("b")) == (-1, 0)


@pytest.mark.parametrize("signal", ["0", "961", "1001", "3000", "-1500"])
def test_signals_that_do_not_exist_or_are_inputs_cannot_be_set(signal: str) -> None:
    """E0106: outputs are 1 to 960, internal ones 2001 to 2960."""
    assert AsBench(program(f"SIGNAL {signal}")).fail().code == "E0106"


def test_pulse_ends_by_itself_and_the_program_does_not_wait() -> None:
    """On for its time, then off."""
    bench = AsBench(program("PULSE 5, 0.1", "a = SIG(5)", "TWAIT 0.15", "b = SIG(5)")).run()
    assert (bench.value("a"), bench.value("b")) == (-1, 0)


def test_bits_writes_a_number_to_signals_and_reads_it_back() -> None:
    """BITS 10,4 = 11 is 1011 on signals 10 to 13."""
    bench = AsBench(program("BITS 10,4 = 11", "a = BITS(10,4)", "b = SIG(12)")).run()
    assert (bench.value("a"), bench.value("b")) == (11, 0)


def test_switches_are_set_by_programs_and_status_switches_are_not() -> None:
    """CP can be switched; POWER only reports."""
    bench = AsBench(program("CP OFF", "a = SWITCH(CP)", "CP ON", "b = SWITCH(CP)",
                            "c = SWITCH(POWER)", "d = SWITCH(REPEAT)")).run()  # fmt: skip
    assert [bench.value(name) for name in "abcd"] == [0, -1, -1, -1]
    assert AsBench(program("POWER OFF")).fail().code == "P0111"


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
        ("$s = $SPACE(200) + $SPACE(56)", "E0110"),
    ],
)  # fmt: skip
def test_impossible_values_stop_the_program_with_their_code(line: str, code: str) -> None:
    """The code names the mistake."""
    assert AsBench(program(line)).fail().code == code


def test_print_goes_to_every_listener_and_s_keeps_the_line_open() -> None:
    """Lines come whole."""
    bench = AsBench(program('TYPE /S, "a"', 'PRINT 2: "b"', 'TYPE "c"')).run()
    assert bench.printed == ["ab", "c"]


def test_user_timers_run_in_integer_variables() -> None:
    """Globals, locals and elements alike, from the value that the instruction gives."""
    bench = AsBench(program("UTIMER @a = 0", "UTIMER .@b[2] = 10", "TWAIT 0.5", "x = UTIMER(@a)",
                            "y = UTIMER(.@b[2])", "UTIMER @a = 3",
                            "z = UTIMER(@a)")).run()  # fmt: skip
    assert [bench.value(name) for name in "xyz"] == pytest.approx([0.5, 10.5, 3.0], abs=0.002)


@pytest.mark.parametrize(("line", "code"), [("UTIMER a = 0", "P0118"), ("UTIMER @a = -1", "E0106")])
def test_a_user_timer_is_an_integer_variable_and_no_negative_time(line: str, code: str) -> None:
    """A real cannot hold it."""
    assert AsBench(program(line)).fail().code == code


def test_time_ms_is_the_time_with_milliseconds() -> None:
    """Since power-on, as $TIME."""
    bench = AsBench(program("TWAIT 1.25", "$t = $TIME_MS")).run()
    assert bench.value("$t") == "00:00:01.250"


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


def test_prompt_reads_a_whole_line_into_a_string() -> None:
    """Blanks and commas included."""
    assert typed("ab, c 1", 'PROMPT "name", $s').value("$s") == "ab, c 1"


def test_prompt_refuses_letters_for_a_number_and_a_missing_keyboard() -> None:
    """P0100 and E4012 stop the program."""
    assert typed("abc", 'PROMPT "how many", a').codes == ["P0100"]
    assert AsBench(program('PROMPT "how many", a')).fail().code == "E4012"


def test_text_for_a_window_of_the_panel_is_reported() -> None:
    """Its number and strings; row, column and colours are read and have no effect."""
    bench = AsBench(program('IFPWPRINT 1 = "ready"', 'IFPWOVERWRITE 2,1,,7,10 = "part "+"A", "ok"'))
    assert bench.run().printed == ["panel, window 1: ready", "panel, window 2: part A | ok"]


@pytest.mark.parametrize("line", ["PROMPT", "IFPWPRINT", "XMOVE HERE", "UDP_RECVFROM r"])
def test_an_argument_that_is_left_out_is_p0100(line: str) -> None:
    """Also before arguments of any number."""
    assert AsBench(program(line)).fail().code in ("P0100", "P0118")
