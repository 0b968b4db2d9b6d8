"""Switches: what each of them changes for a program."""

import numpy as np
import pytest

from tests.fakes.as_bench import AsBench, program
from tests.fakes.as_trace import SQUARE, Trace

STRAIGHT = "#[0,0,-90,0,-3,0]"  # JT5 within 5 degrees of zero
ASIDE = "LMOVE SHIFT(p BY 80,0,0)"


def travel_mm(trace: Trace) -> float:
    """Distance from start to end."""
    return float(np.linalg.norm(trace.mm[-1] - trace.mm[0]))


def test_the_factory_settings_are_those_of_the_manual() -> None:
    """ON: CONF_VARIABLE, CP, QTOOL, SINGULAR; OFF: the others that take effect."""
    on = AsBench(program("FOR i = 1 TO 1", "END", "a = SWITCH(CONF_VARIABLE)", "b = SWITCH(CP)",
                         "c = SWITCH(QTOOL)", "d = SWITCH(SINGULAR)")).run()  # fmt: skip
    assert [on.value(name) for name in "abcd"] == [-1, -1, -1, -1]
    off = AsBench(program("a = SWITCH(ABS.SPEED)", "b = SWITCH(CHG_INTERRUPT_DECEL)",
                          "c = SWITCH(CYCLE.STOP)", "d = SWITCH(SLOW_START)")).run()  # fmt: skip
    assert [off.value(name) for name in "abcd"] == [0, 0, 0, 0]


def test_several_switches_are_set_in_one_line_or_none() -> None:
    """A name that is no switch leaves the others as they are."""
    bench = AsBench(program("CP, QTOOL OFF", "a = SWITCH(CP)+SWITCH(QTOOL)")).run()
    assert bench.value("a") == 0
    bench = AsBench(program("CP, WIBBLE OFF"))
    assert bench.fail().code == "P0111"
    assert bench.machine.hardware.switches["cp"]


# --- SINGULAR -------------------------------------------------------------------------------------


@pytest.mark.parametrize("move", [f"LMOVE {STRAIGHT}", "LDEPART 20"])
def test_singular_refuses_a_straight_wrist_on_a_tcp_path(move: str) -> None:
    """E6007 at its end and from its start; OFF, and in joint motions, it is no error."""
    start = "#[0,0,-90,0,-20,0]" if "LMOVE" in move else STRAIGHT
    go = (f"JMOVE {start}", "BREAK", "SPEED 50 MM/S ALWAYS", move, "BREAK", "n = 1")
    assert AsBench(program(*go)).fail().code == "E6007"
    assert AsBench(program("SINGULAR OFF", *go)).run().value("n") == 1
    assert AsBench(program(f"JMOVE {STRAIGHT}", "BREAK", "n = 1")).run().value("n") == 1


def test_singular_has_no_effect_beyond_5_degrees() -> None:
    """JT5 at 6 degrees moves."""
    lines = ("JMOVE #[0,0,-90,0,-6,0]", "BREAK", "DRIVE 5,-1", "LDEPART 1", "BREAK", "n = 1")
    assert AsBench(program(*lines)).run().value("n") == 1


# --- CONF_VARIABLE --------------------------------------------------------------------------------


def test_conf_variable_off_refuses_a_target_in_another_configuration() -> None:
    """ON the arm goes to the same TCP pose in its own configuration."""
    flip = "#[0,0,-90,180,90,-180]"  # the pose of #[0,0,-90,0,-90,0]
    lines = ("JMOVE #[0,0,-90,0,-90,0]", "BREAK", "LDEPART 30", "BREAK", f"LMOVE {flip}", "BREAK",
             "n = DEXT(#DEST,4)")  # fmt: skip
    assert AsBench(program(*lines)).run().value("n") == pytest.approx(0.0, abs=1.0)
    assert AsBench(program("CONF_VARIABLE OFF", *lines)).fail().code == "E1184"


def test_conf_variable_off_lets_everything_else_move() -> None:
    """A target in the arm's own configuration, and one without a configuration."""
    lines = ("CONF_VARIABLE OFF", *SQUARE, "LMOVE #[2,0,-90,0,-90,0]", "LMOVE p", "BREAK", "n = 1")
    assert AsBench(program(*lines)).run().value("n") == 1


# --- SLOW_START -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("speed", "slow_mm_s"),
    [("SPEED 500 MM/S ALWAYS", 200.0), ("SPEED 90 ALWAYS", 200.0), ("SPEED 50 MM/S ALWAYS", 50.0),
     ("SPEED 2 ALWAYS", 40.0), ("SPEED 0.1 S ALWAYS", 200.0)],
)  # fmt: skip
def test_slow_start_limits_the_first_motion_to_the_slow_repeat_speed(
    speed: str, slow_mm_s: float
) -> None:
    """10 % of full speed, 200 mm/s; a slower program speed stays; OFF nothing changes."""
    fastest = []
    for switch in ("ON", "OFF"):
        bench = AsBench(program(f"SLOW_START {switch}", "HERE p", speed, ASIDE, "BREAK",
                                "t = TIMER(0)", "LMOVE p", "BREAK"))  # fmt: skip
        trace = Trace(bench)
        bench.run()
        half = int(bench.value("t") * 1000)
        fastest.append((trace.speed_mm_s[:half].max(), trace.speed_mm_s[half:].max()))
    (first, second), (usual, _) = fastest
    assert first == pytest.approx(min(slow_mm_s, usual), rel=0.03)
    assert second == pytest.approx(usual, rel=0.03)


def test_slow_start_limits_the_first_motion_after_a_restart() -> None:
    """HOLD and RUN between two motions."""
    bench = AsBench(program("SLOW_START ON", "HERE p", "SPEED 300 MM/S ALWAYS", ASIDE, "BREAK",
                            "PAUSE", "LMOVE p", "BREAK", "LMOVE SHIFT(p BY 0,80,0)",
                            "BREAK"))  # fmt: skip
    trace = Trace(bench)
    bench.start()
    assert bench.advance(5.0, lambda: bench.task.state == "held")
    before = len(trace.points)
    bench.pendant.run()
    assert bench.advance(5.0, lambda: bench.task.state == "idle")
    speeds = trace.speed_mm_s[before:]
    middle = len(speeds) // 2
    assert speeds[:middle].max() == pytest.approx(200.0, rel=0.03)
    assert speeds[middle:].max() == pytest.approx(300.0, rel=0.03)


# --- CHG_INTERRUPT_DECEL --------------------------------------------------------------------------


def braking_mm(switch: str, decel: int, by: str) -> float:
    """How far the arm goes after BRAKE of a PC program, or the signal of XMOVE."""
    move = ASIDE if by == "BRAKE" else "XMOVE SHIFT(p BY 80,0,0) TILL 2001"
    bench = AsBench(program(f"CHG_INTERRUPT_DECEL {switch}", *SQUARE, f"DECEL {decel} ALWAYS", move,
                            "TWAIT 1") + program(by, name="stop"))  # fmt: skip
    trace = Trace(bench)
    bench.start().advance(0.4)
    at_mm = travel_mm(trace)
    bench.machine.control.start_pc(1, "stop")
    bench.advance(1.0)
    return travel_mm(trace) - at_mm


@pytest.mark.parametrize("by", ["BRAKE", "SIGNAL 2001"])
def test_chg_interrupt_decel_lets_decel_weaken_an_interruption(by: str) -> None:
    """OFF: 2.5 m/s^2, 2 mm from 100 mm/s, whatever DECEL says. ON: 10 % of 2 m/s^2, 25 mm."""
    assert braking_mm("OFF", 10, by) == pytest.approx(2.0, abs=0.3)
    assert braking_mm("ON", 100, by) == pytest.approx(2.5, abs=0.3)
    assert braking_mm("ON", 10, by) == pytest.approx(25.0, abs=1.5)


# --- CYCLE.STOP, QTOOL ----------------------------------------------------------------------------


@pytest.mark.parametrize("switch", ["ON", "OFF"])
def test_cycle_stop_keeps_the_program_held_after_an_external_hold(switch: str) -> None:
    """OFF it resumes when the input goes off; ON it waits for cycle start."""
    bench = AsBench(program(f"CYCLE.STOP {switch}", "n = 0", "WHILE TRUE DO", "TWAIT 0.01",
                            "n = n+1", "END")).start()  # fmt: skip
    bench.advance(0.2)
    bench.pendant.external_hold(on=True)
    held = bench.value("n")
    bench.advance(0.2)
    assert bench.value("n") == held
    bench.pendant.external_hold(on=False)
    bench.advance(0.2)
    assert (bench.value("n") == held) == (switch == "ON")
    bench.pendant.run()
    bench.advance(0.2)
    assert bench.value("n") > held


@pytest.mark.parametrize("switch", ["ON", "OFF"])
def test_qtool_lets_the_tool_button_replace_tool(switch: str) -> None:
    """By the registered tool, which is none; OFF the TOOL of the program stays."""
    bench = AsBench(program(f"QTOOL {switch}", "TOOL TRANS(0,0,50)", "POINT a = TOOL", "PAUSE",
                            "POINT b = TOOL")).start()  # fmt: skip
    assert bench.advance(1.0, lambda: bench.task.state == "held")
    bench.pendant.teach()
    bench.pendant.tool_button()
    bench.pendant.repeat()
    bench.pendant.run()
    bench.advance(1.0)
    assert bench.value("a").z == 50
    assert bench.value("b").z == (0 if switch == "ON" else 50)
