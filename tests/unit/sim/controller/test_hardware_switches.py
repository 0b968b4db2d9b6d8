"""Switches: what each of them changes for a program."""

import numpy as np
import pytest

from tests.fakes.as_bench import FAST, AsBench, program
from tests.unit.sim.controller.conftest import SQUARE, Trace

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
                          "c = SWITCH(CYCLE.STOP)", "d = SWITCH(SLOW_START)",
                          "e = SWITCH(PREFETCH.SIGINS)")).run()  # fmt: skip
    assert [off.value(name) for name in "abcde"] == [0, 0, 0, 0, 0]


# --- SINGULAR -------------------------------------------------------------------------------------


@pytest.mark.parametrize("move", [f"LMOVE {STRAIGHT}", "LDEPART 20"])
def test_singular_refuses_a_straight_wrist_on_a_tcp_path(move: str) -> None:
    """E6007 at its end and from its start; OFF, and in joint motions, it is no error."""
    start = "#[0,0,-90,0,-20,0]" if "LMOVE" in move else STRAIGHT
    go = (f"JMOVE {start}", "BREAK", "SPEED 50 MM/S ALWAYS", move, "BREAK", "n = 1")
    assert AsBench(program(*go)).fail().code == "E6007"
    assert AsBench(program("SINGULAR OFF", *go)).run().value("n") == 1
    assert AsBench(program(f"JMOVE {STRAIGHT}", "BREAK", "n = 1")).run().value("n") == 1


# --- SLOW_START -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("speed", "slow_mm_s"),
    [("SPEED 500 MM/S ALWAYS", 200.0), ("SPEED 2 ALWAYS", 40.0), ("SPEED 0.1 S ALWAYS", 200.0)],
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


# --- PREFETCH.SIGINS ------------------------------------------------------------------------------

WITH_SIGNALS = ("SWAIT -1", "SIGNAL 1", "TWAIT 0", "PULSE 1,0.1", "DLYSIG 1,0.1", "RUNMASK 1",
                "RESET", "BITS 1,4=5", "BITS32 1,4=5")  # fmt: skip


@pytest.mark.parametrize("step", [*WITH_SIGNALS, "SOUT 1 = -1", "WAIT TRUE", "OPENS 1", "n = 1"])
def test_prefetch_sigins_off_delays_signals_and_twait_until_the_axes_coincide(step: str) -> None:
    """50 mm at 100 mm/s: half a second, less 1 mm. ON, and for other steps, it costs no time."""
    for switch, is_early in (("OFF", step not in WITH_SIGNALS), ("ON", True)):
        bench = AsBench(program(f"PREFETCH.SIGINS {switch}", *SQUARE, ASIDE.replace("80", "50"),
                                step, "t = TIMER(0)", "BREAK", "u = TIMER(0)")).run()  # fmt: skip
        assert bench.value("t") == pytest.approx(0.01 if is_early else 0.53, abs=0.02)
        assert bench.value("u") == pytest.approx(0.55, abs=0.02)


def test_a_signal_waits_for_every_motion_before_it() -> None:
    """Also for those that the controller has taken ahead, and for a pause."""
    behaviour = FAST.model_copy(update={"motions_ahead": 4})
    bench = AsBench(program(*SQUARE, ASIDE, "LMOVE p", "DELAY 0.3", "SIGNAL 1", "t = TIMER(0)"),
                    behaviour).run()  # fmt: skip
    assert bench.value("t") == pytest.approx(1.97, abs=0.1)


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
