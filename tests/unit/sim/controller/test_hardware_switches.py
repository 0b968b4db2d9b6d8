"""Switches: what each of them changes for a program."""

import pytest

from tests.fakes.as_bench import FAST, AsBench, program
from tests.unit.sim.controller.conftest import SQUARE

STRAIGHT = "#[0,0,-90,0,-3,0]"  # JT5 within 5 degrees of zero
ASIDE = "LMOVE SHIFT(p BY 80,0,0)"


def test_the_factory_settings_are_those_of_the_manual() -> None:
    """ON: CONF_VARIABLE, CP, QTOOL, SINGULAR; OFF: the others that take effect."""
    on = AsBench(program("FOR i = 1 TO 1", "END", "a = SWITCH(CONF_VARIABLE)", "b = SWITCH(CP)",
                         "c = SWITCH(QTOOL)", "d = SWITCH(SINGULAR)")).run()  # fmt: skip
    assert [on.value(name) for name in "abcd"] == [-1, -1, -1, -1]
    off = AsBench(program("a = SWITCH(ABS.SPEED)", "b = SWITCH(CHG_INTERRUPT_DECEL)",
                          "c = SWITCH(CYCLE.STOP)", "d = SWITCH(SLOW_START)",
                          "e = SWITCH(PREFETCH.SIGINS)")).run()  # fmt: skip
    assert [off.value(name) for name in "abcde"] == [0, 0, 0, 0, 0]


@pytest.mark.parametrize("move", [f"LMOVE {STRAIGHT}", "LDEPART 20"])
def test_singular_refuses_a_straight_wrist_on_a_tcp_path(move: str) -> None:
    """E6007 at its end and from its start; OFF, and in joint motions, it is no error."""
    start = "#[0,0,-90,0,-20,0]" if "LMOVE" in move else STRAIGHT
    go = (f"JMOVE {start}", "BREAK", "SPEED 50 MM/S ALWAYS", move, "BREAK", "n = 1")
    assert AsBench(program(*go)).fail().code == "E6007"
    assert AsBench(program("SINGULAR OFF", *go)).run().value("n") == 1
    assert AsBench(program(f"JMOVE {STRAIGHT}", "BREAK", "n = 1")).run().value("n") == 1


WITH_SIGNALS = ("SWAIT -1", "SIGNAL 1", "TWAIT 0", "PULSE 1,0.1", "DLYSIG 1,0.1", "RUNMASK 1",
                "RESET", "BITS 1,4=5", "BITS32 1,4=5")  # fmt: skip


@pytest.mark.parametrize("step", [*WITH_SIGNALS, "SOUT 1 = -1", "WAIT TRUE", "OPENS 1", "n = 1"])
def test_prefetch_sigins_off_delays_signals_and_twait_until_the_axes_coincide(step: str) -> None:
    """50 mm at 100 mm/s: half a second, less 1 mm. ON, and for other steps, it costs no time."""
    for switch, is_early in (("OFF", step not in WITH_SIGNALS), ("ON", True)):
        bench = AsBench(program(f"PREFETCH.SIGINS {switch}", *SQUARE, "LMOVE SHIFT(p BY 50,0,0)",
                                step, "t = TIMER(0)", "BREAK", "u = TIMER(0)")).run()  # fmt: skip
        assert bench.value("t") == pytest.approx(0.01 if is_early else 0.53, abs=0.02)
        assert bench.value("u") == pytest.approx(0.55, abs=0.02)


def test_a_signal_waits_for_every_motion_before_it() -> None:
    """Also for those that the controller has taken ahead, and for a pause."""
    behaviour = FAST.model_copy(update={"motions_ahead": 4})
    bench = AsBench(program(*SQUARE, ASIDE, "LMOVE p", "DELAY 0.3", "SIGNAL 1", "t = TIMER(0)"),
                    behaviour).run()  # fmt: skip
    assert bench.value("t") == pytest.approx(1.97, abs=0.1)


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
