"""Parallel programs, errors and their handlers, and the monitor behind MC."""

import pytest

from sim.as_language.errors import AsError
from sim.controller.behaviour import Behaviour
from tests.fakes.as_bench import FAST, AsBench, program

FOREVER = ("WHILE TRUE DO", "TWAIT 0.01", "END")


def test_pc_programs_run_their_cycles_and_task_returns_their_state() -> None:
    """Three cycles are three; TASK is 1 while it runs and 0 afterwards."""
    other = program("n = n+1", "TWAIT 0.1", name="other")
    bench = AsBench(program("n = 0", "PCEXECUTE 3: other,3", "a = TASK(1003)", "b = TASK(1)",
                            "TWAIT 1", "c = TASK(1003)") + other).run()  # fmt: skip
    assert [bench.value(name) for name in "nabc"] == [3, 1, 1, 0]


def test_pcabort_stops_at_once_and_pcend_at_the_end_of_the_cycle() -> None:
    """A program that loops for ever inside one cycle only obeys PCABORT."""
    other = program("n = n+1", "TWAIT 0.1", "m = m+1", name="other")
    for word, cycles, halves in (("PCABORT", 1, 0), ("PCEND", 1, 1)):
        bench = AsBench(program("n = 0", "m = 0", "PCEXECUTE 1: other,-1", "TWAIT 0.05",
                                f"{word} 1:", "TWAIT 1") + other).run()  # fmt: skip
        assert (bench.value("n"), bench.value("m")) == (cycles, halves)


def test_pcscan_makes_a_cycle_last_its_time() -> None:
    """A short program with PCSCAN 0.1 runs ten times a second."""
    other = program("PCSCAN 0.1", "n = n+1", name="other")
    bench = AsBench(program("n = 0", "PCEXECUTE 1: other,-1", "TWAIT 1.05") + other).run()
    assert bench.value("n") == 11


def test_a_pc_program_number_in_use_is_p1019_and_a_sixth_is_e0106() -> None:
    """Numbers are 1 to 5, one program each."""
    other, third = program(*FOREVER, name="other"), program(*FOREVER, name="third")
    start = ("PCEXECUTE 1: other", "PCEXECUTE 1: third")
    assert AsBench(program(*start) + other + third).fail().code == "P1019"
    assert AsBench(program("PCEXECUTE 6: other") + other).fail().code == "E0106"


def test_one_subroutine_in_two_tasks_is_p1014() -> None:
    """The second task to enter it stops; the first continues."""
    helper = program(*FOREVER, name="helper")
    other = program("CALL helper", name="other")
    bench = AsBench(program("PCEXECUTE 1: other", "TWAIT 0.1", "CALL helper") + other + helper)
    assert bench.fail().code == "P1014"
    assert bench.machine.tasks[1].state == "running"


def test_a_program_cannot_call_itself() -> None:
    """P1014: it is in use, by itself."""
    assert AsBench(program("CALL main")).fail().code == "P1014"


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
    bench = AsBench(program("PCEXECUTE 4: other", "TWAIT 0.3", "e = ERROR", "t = TASK(1004)")
                    + other).start()  # fmt: skip
    bench.advance(1.0)
    assert bench.task.state == "idle"
    assert (bench.value("e"), bench.value("t")) == (-30108, 0)
    stop = bench.machine.stops[0]
    assert (stop.error.code, stop.program, stop.step) == ("E0108", "other", 2)
    assert "other" in str(stop)
    assert "step 2" in str(stop)


def test_mc_starts_holds_continues_and_aborts_the_robot_program() -> None:
    """The monitor's commands, from a PC program."""
    count = program("WHILE TRUE DO", "TWAIT 0.01", "n = n+1", "END", name="count")
    boss = program("MC EXECUTE count", "TWAIT 0.5", "MC HOLD", "a = n", "TWAIT 0.5", "b = n",
                   "s = TASK(1)", "MC CONTINUE", "TWAIT 0.5", "c = n", "MC ABORT", "TWAIT 0.1",
                   "d = TASK(1)", "MC SPEED 35", "e = MSPEED", name="boss")  # fmt: skip
    bench = AsBench(count + boss)
    bench.machine.memory.write("n", 0.0)
    bench.machine.control.start_pc(1, "boss")
    bench.advance(2.0)
    assert bench.codes == []
    a, b, c = (bench.value(name) for name in "abc")
    assert a == b
    assert c > b > 30
    assert [bench.value(name) for name in "sde"] == [2, 0, 35]


def test_mc_is_refused_in_the_robot_program() -> None:
    """P0111."""
    assert AsBench(program("MC HOLD")).fail().code == "P0111"


def test_the_autonomous_start_of_the_manual_works() -> None:
    """WAIT SWITCH(POWER), then MC EXECUTE: the robot program starts when the motors go on."""
    main = program("x = 1")
    boss = program("WAIT SWITCH(POWER)", "MC EXECUTE main", name="boss")
    bench = AsBench(main + boss)
    bench.pendant.motor_power(on=False)
    bench.machine.control.start_pc(1, "boss")
    bench.advance(0.5)
    assert bench.value("x") is None
    bench.pendant.motor_power(on=True)
    bench.machine.control.held = bench.robot.queue.held = False
    bench.advance(0.5)
    assert bench.value("x") == 1


@pytest.mark.parametrize(
    ("prepare", "code"),
    [
        (lambda p: p.motor_power(on=False), "P1000"),
        (lambda p: p.emergency_stop(), "P1000"),
        (lambda p: p.teach(), "P1001"),
        (lambda p: p.teach_lock(on=True), "P1002"),
    ],
)
def test_execute_and_run_need_power_repeat_and_no_teach_lock(prepare, code: str) -> None:
    """Each missing precondition has its own code; nothing starts."""
    bench = AsBench(program("x = 1"))
    prepare(bench.pendant)
    for act in (lambda: bench.pendant.execute("main"), bench.pendant.run):
        with pytest.raises(AsError) as error:
            act()
        assert error.value.code == code
    bench.advance(0.1)
    assert bench.value("x") is None


def test_execute_is_refused_while_a_program_runs_and_in_error() -> None:
    """P1009, and P1013 until ERESET."""
    bench = AsBench(program("TWAIT 0.1", "x = 1/0")).start()
    with pytest.raises(AsError, match="P1009"):
        bench.pendant.execute("main")
    bench.advance(0.2)
    with pytest.raises(AsError, match="P1013"):
        bench.pendant.execute("main")
    bench.pendant.error_reset()
    bench.pendant.execute("main")


def test_after_ereset_continue_repeats_the_step_that_failed() -> None:
    """The mistake has been put right meanwhile: the program continues."""
    bench = AsBench(program("a = 1", "b = 1/c", "d = 1"))
    bench.machine.memory.write("c", 0.0)
    assert bench.fail().code == "E0108"
    bench.machine.memory.write("c", 4.0)
    with pytest.raises(AsError, match="P1013"):
        bench.pendant.run()
    bench.pendant.error_reset()
    bench.pendant.run()
    bench.advance(0.1)
    assert (bench.value("b"), bench.value("d"), bench.task.state) == (0.25, 1, "idle")


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


def test_one_calls_its_handler_and_returne_goes_on_behind_the_error() -> None:
    """The handler reads the error's number; RETURNE skips the step that failed."""
    handler = program("e = ERROR", "n = n+1", "RETURNE", name="handler")
    bench = AsBench(program("n = 0", "ONE handler", "x = 1/0", "y = 2") + handler).start()
    bench.advance(0.2)
    assert bench.task.state == "idle"
    assert (bench.value("n"), bench.value("y"), bench.value("x")) == (1, 2, None)
    assert bench.value("e") == -30108
    assert bench.machine.control.error is None


def test_one_with_return_repeats_the_step() -> None:
    """RETURN goes back to the step that failed, which the handler has made possible."""
    handler = program("c = 2", "RETURN", name="handler")
    bench = AsBench(program("c = 0", "ONE handler", "x = 1/c") + handler).start()
    bench.advance(0.2)
    assert (bench.value("x"), bench.task.state) == (0.5, "idle")


def test_an_error_in_the_handler_stops_the_program() -> None:
    """Handlers are not handled, and they must not move the arm."""
    for line, code in (("x = 1/0", "E0108"), ("LMOVE HERE", "P0111")):
        handler = program(line, "RETURNE", name="handler")
        bench = AsBench(program("ONE handler", "x = 1/0") + handler)
        assert bench.fail().code == code
    assert AsBench(program("RETURNE")).fail().code == "P0111"


def test_an_instruction_without_emulation_gives_its_name_program_and_step() -> None:
    """E0111 when the step is reached, not before."""
    bench = AsBench(program("x = 1", "GUNON 1,50"))
    error = bench.fail()
    assert error.code == "E0111"
    assert "GUNON" in str(error)
    assert (bench.value("x"), bench.stopped_at) == (1, ("main", 2))


def test_a_stall_stops_all_programs_and_not_the_arm() -> None:
    """A planning stall of 1 s: no step is made, the motion continues."""
    source = program(
        "PCEXECUTE 1: other", "SPEED 20 MM/S ALWAYS", "HERE p", "LMOVE SHIFT(p BY 0,0,50)"
    ) + program("WHILE TRUE DO", "n = TIMER(0)", "TWAIT 0.01", "END", name="other")
    behaviour = Behaviour(step_s=2e-5, planning_stall_s=1.0, stall_at_motions=(1,))
    bench = AsBench(source, behaviour).start()
    bench.advance(0.1)
    counted, z = bench.value("n"), bench.task.machine.here().z
    bench.advance(0.8)
    assert bench.value("n") == counted
    assert bench.task.machine.here().z - z == pytest.approx(16.0, abs=0.5)
    bench.advance(0.2)
    assert bench.value("n") > counted


def test_the_same_program_gives_the_same_run() -> None:
    """Everything on the virtual clock is repeatable, to the step."""
    source = program("HERE p", "FOR i = 1 TO 3", "LMOVE SHIFT(p BY 0,5*i,0)", "END", "BREAK",
                     "t = TIMER(0)", "DECOMPOSE x[0] = HERE")  # fmt: skip
    first, second = AsBench(source, FAST).run(), AsBench(source, FAST).run()
    assert first.machine.steps == second.machine.steps
    assert [first.value(n) for n in ("t", "x[0]", "x[1]", "x[2]")] == [
        second.value(n) for n in ("t", "x[0]", "x[1]", "x[2]")
    ]


def test_whichtask_names_the_task_that_is_in_a_program() -> None:
    """A held program, too: who executes its slot anew would replace it; an ended one is free."""
    other = program("PAUSE", name="a_name_with_over_15_characters")
    bench = AsBench(program('$name = "a_name_with_over_15_characters"', "a = WHICHTASK($name)",
                            "PCEXECUTE 4: a_name_with_over_15_characters", "TWAIT 0.1",
                            "s = TASK(1004)", "b = WHICHTASK($name)", "PCABORT 4:",
                            "c = WHICHTASK($name)") + other).run()  # fmt: skip
    assert [bench.value(name) for name in "abcs"] == [-1, 1004, -1, 2]


def boss_of(*lines: str, main: str = program("x = 1")) -> AsBench:
    """A PC program with these steps, run for a second beside a robot program."""
    bench = AsBench(main + program(*lines, name="boss"))
    bench.machine.control.start_pc(1, "boss")
    bench.advance(1.0)
    return bench


def test_mc_ereset_and_mc_continue_resume_where_an_error_stopped_the_robot_program() -> None:
    """Before ERESET nothing starts (P1013); after it the failed step is executed again."""
    main = program("n = 0", "n = n+1", "y = 1/d", "z = n")
    bench = boss_of("d = 0", "MC EXECUTE main", "WAIT TASK(1) == 2", "e = ERROR", "ONE note",
                    "MC CONTINUE", "MC EXECUTE main", "MC ERESET", "f = ERROR", "d = 4",
                    "MC CONTINUE", "WAIT TASK(1) == 0",
                    main=main + program("g = ERROR", "RETURNE", name="note"))  # fmt: skip
    assert bench.codes == ["E0108", "P1013", "P1013"]
    assert [bench.value(name) for name in "efgyz"] == [-30108, 0, -11013, 0.25, 1]


def test_mc_ereset_resets_an_error_that_a_pc_program_left() -> None:
    """The robot program continues all the time, unless such an error stops it."""
    count = program("WHILE TRUE DO", "TWAIT 0.01", "n = n+1", "END")
    for stops in (False, True):
        bench = AsBench(count + program("x = 1/0", name="bad")
                        + program("WAIT SWITCH(ERROR)", "a = TASK(1)", "MC ERESET",
                                  "IF a == 2 THEN", "MC CONTINUE", "END", "TWAIT 0.1", "b = n",
                                  "TWAIT 0.1", "c = TASK(1)", name="boss"),
                        Behaviour(step_s=2e-5, pc_error_stops_robot=stops))  # fmt: skip
        bench.machine.memory.write("n", 0.0)
        bench.start()
        bench.machine.control.start_pc(1, "boss")
        bench.machine.control.start_pc(2, "bad")
        bench.advance(0.5)
        assert bench.codes == ["E0108"]
        assert [bench.value(name) for name in "ac"] == [2 if stops else 1, 1]
        assert bench.value("n") > bench.value("b") > 0


def test_mc_continue_without_a_program_to_continue_is_p1011() -> None:
    """An ended program must be executed anew."""
    assert boss_of("MC CONTINUE").codes == ["P1011"]


def test_mc_prime_prepares_a_program_that_mc_continue_starts() -> None:
    """Nothing is executed before; the cycles are those of PRIME."""
    bench = boss_of("n = 0", "MC PRIME main,3", "TWAIT 0.1", "a = n", "MC CONTINUE",
                    "WAIT TASK(1) == 0", main=program("n = n+1"))  # fmt: skip
    assert bench.codes == []
    assert [bench.value(name) for name in "an"] == [0, 3]


def test_mc_zpower_switches_the_motors_and_off_holds_the_program() -> None:
    """An emergency stop that is pressed keeps them off."""
    bench = boss_of("MC ZPOWER OFF", "a = SWITCH(POWER)", "b = SWITCH(RUN)", "MC ZPOWER ON",
                    "c = SWITCH(POWER)")  # fmt: skip
    assert [bench.value(name) for name in "abc"] == [0, 0, -1]
    bench.pendant.emergency_stop()
    bench.machine.control.start_pc(1, "boss")
    bench.advance(0.5)
    assert bench.value("c") == 0


def test_a_monitor_command_may_name_robot_1_and_no_other() -> None:
    """P0104."""
    assert boss_of("MC SPEED 1: 35", "a = MSPEED").value("a") == 35
    assert boss_of("MC SPEED 2: 35").codes == ["P0104"]
