"""Answers to open questions: how each of them changes what a program does."""

from pathlib import Path
from typing import Any

import pytest

from common.config.cell_sim import SimSection
from forcemesh.errors import ConfigError
from sim.controller.behaviour import Behaviour, behaviour_in, behaviour_like
from tests.fakes.as_bench import FAST, AsBench, program
from tests.fakes.as_trace import SQUARE, Trace

PORT = "49152"
SERVER = program(
    f"TCP_LISTEN r, {PORT}", f"TCP_ACCEPT s, {PORT}, 5", "TCP_RECV r, s, $t[1], n, 5", "after = 1",
    name="server",
)  # fmt: skip


def changed(**fields: Any) -> Behaviour:
    """Return a quick controller with other answers."""
    return Behaviour(**(FAST.model_dump() | fields))


def stream(step_mm: float, speed_mm_s: float, *, cp: str = "CP ON") -> str:
    """Return a program that goes ten steps aside and stops."""
    return program(cp, "HERE p", f"SPEED {speed_mm_s} MM/S ALWAYS", "ACCURACY 10 ALWAYS",
                   "FOR k = 1 TO 10", f"LMOVE SHIFT(p BY {step_mm}*k,0,0)", "END",
                   "BREAK")  # fmt: skip


def test_the_file_of_a_probe_gives_its_behaviour(tmp_path: Path) -> None:
    """Fields that it does not name have their defaults."""
    path = tmp_path / "probe.yaml"
    path.write_text(
        "probe: 1\ncontroller: F60\nresults: {error: {value: null, why: x}}\n"
        "behaviour: {least_segment_s: 0.03, motions_ahead: 3}\n"
    )
    assert behaviour_like(path) == Behaviour(least_segment_s=0.03, motions_ahead=3)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("behaviour: {motion_ahead: 3}\n", "did you mean motions_ahead?"),
        ("behaviour: {motions_ahead: 5}\n", "behaviour.motions_ahead: "),
        ("behaviour: {motions_ahead: 0}\n", "behaviour.motions_ahead: "),
        ("behaviour: {step_s: 0}\n", "behaviour.step_s: "),
        ("", "must hold a map of sections"),
    ],
)
def test_a_mistake_in_the_file_of_a_probe_is_named(tmp_path: Path, text: str, words: str) -> None:
    """With the file, the place and what is valid."""
    path = tmp_path / "probe.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError) as refused:
        behaviour_like(path)
    assert words in str(refused.value)
    assert str(path) in str(refused.value)


# --- segments -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("step_mm", "speed_mm_s", "fails"), [(10, 300, False), (6, 300, True), (1, 30, False)]
)
def test_a_segment_shorter_than_the_least_is_e1117(
    step_mm: float, speed_mm_s: float, fails: bool
) -> None:
    """33 ms pass and 20 ms do not, whatever their length."""
    bench = AsBench(stream(step_mm, speed_mm_s), changed(least_segment_s=0.03))
    if not fails:
        bench.run()
        return
    error = bench.fail()
    assert error.code == "E1117"
    assert "20.0 ms" in str(error)
    assert not bench.advance(1.0, lambda: bench.robot.queue.is_moving and bench.now_s > 9.0)


@pytest.mark.parametrize("ahead", [1, 2, 4])
def test_a_program_runs_on_until_the_queue_of_motions_is_full(ahead: int) -> None:
    """One active and `ahead` less one waiting; it waits at the step of the next one."""
    bench = AsBench(program(*SQUARE, "n = 0", *(f"LMOVE SHIFT(p BY {20 * k},0,0)\nn = {k}"
                            for k in range(1, 7)), "BREAK"),
                    changed(motions_ahead=ahead)).start()  # fmt: skip
    bench.advance(0.05)
    assert bench.value("n") == ahead
    assert bench.advance(5.0, lambda: bench.task.state == "idle")
    assert (bench.value("n"), bench.machine.stops) == (6, [])


# --- speeds ---------------------------------------------------------------------------------------


def test_seconds_of_a_joint_motion_may_be_ignored() -> None:
    """Then it goes at full speed; those of a linear one count."""
    joint = program("SPEED 3 S", "DRIVE 1,20", "SPEED 3 S", "JMOVE #[0,0,-90,0,-90,0]", "BREAK",
                    "t = TIMER(0)")  # fmt: skip
    linear = program("HERE p", "SPEED 3 S", "LMOVE SHIFT(p BY 40,0,0)", "BREAK", "t = TIMER(0)")
    kept = AsBench(joint).run().value("t")
    ignored = AsBench(joint, changed(joint_seconds_ignored=True)).run().value("t")
    assert kept > 3.0
    assert ignored < 1.5
    took_s = AsBench(linear, changed(joint_seconds_ignored=True)).run().value("t")
    assert took_s == pytest.approx(3.0, abs=0.2)


@pytest.mark.parametrize(("speed_mm_s", "reached_mm_s"), [(100, 100), (400, 200)])
def test_abs_speed_scales_only_the_fastest_speed(speed_mm_s: float, reached_mm_s: float) -> None:
    """At 10 % of 2 m/s the limit is 200 mm/s; a speed below it is not scaled."""
    lines = ("HERE p", f"SPEED {speed_mm_s} MM/S", "LMOVE SHIFT(p BY 150,0,0)", "BREAK")
    bench = AsBench(program(*lines), changed(abs_speed=True))
    bench.pendant.monitor_speed(10.0)
    trace = Trace(bench)
    bench.run()
    assert trace.speed_mm_s.max() == pytest.approx(reached_mm_s, rel=0.02)


def test_a_program_may_switch_abs_speed_off() -> None:
    """And on, where it is off at power-on."""
    for at_power_on, switched, reached_mm_s in ((True, "OFF", 10), (False, "ON", 100)):
        lines = (f"ABS.SPEED {switched}", "HERE p", "SPEED 100 MM/S", "LMOVE SHIFT(p BY 20,0,0)")
        bench = AsBench(program(*lines, "BREAK"), changed(abs_speed=at_power_on))
        bench.pendant.monitor_speed(10.0)
        trace = Trace(bench)
        bench.run()
        assert trace.speed_mm_s.max() == pytest.approx(reached_mm_s, rel=0.02)


def test_a_speed_in_mm_s_is_the_tcps_and_its_rotation_has_its_own() -> None:
    """A pure turn is not slowed by MM/S; with a way the way decides, unless the turn is longer."""

    def took_s(speed: str, motion: str) -> float:
        lines = ("HERE p", speed, motion, "BREAK", "t = TIMER(0)")
        return float(AsBench(program(*lines)).run().value("t"))

    assert took_s("SPEED 1 MM/S", "LMOVE p+RZ(10)") < 1.0
    assert took_s("SPEED 2 S", "LMOVE p+RZ(10)") == pytest.approx(2.0, abs=0.2)
    assert took_s("SPEED 10 MM/S", "LMOVE p+TRANS(0,0,-20)+RZ(5)") == pytest.approx(2.0, abs=0.2)


@pytest.mark.parametrize(("asked_mm_s", "reached_mm_s"), [(2.0, 2.0), (0.1, 1.2)])
def test_a_speed_below_the_least_is_the_least(asked_mm_s: float, reached_mm_s: float) -> None:
    """Percentages begin at 0.01: 1.2 mm/s of 12 m/s."""
    lines = ("HERE p", f"SPEED {asked_mm_s} MM/S", "LMOVE SHIFT(p BY 1,0,0)", "BREAK")
    bench = AsBench(program(*lines), changed(least_speed_m_s=0.0012))
    trace = Trace(bench)
    bench.run()
    assert trace.speed_mm_s.max() == pytest.approx(reached_mm_s, rel=0.05)


def test_an_acceleration_by_time_makes_a_small_motion_slow() -> None:
    """From rest to rest within s at a speed of s / t: twice the root of t times the ramp's time."""
    lines = ("HERE p", "SPEED 10 MM/S", "LMOVE SHIFT(p BY 0.3,0,0)", "BREAK", "t = TIMER(0)")
    at_once = AsBench(program(*lines)).run().value("t")
    by_time = AsBench(program(*lines), changed(accel_time_s=0.2)).run().value("t")
    assert by_time - at_once == pytest.approx(2.0 * (0.03 * 0.2) ** 0.5 - 0.045, abs=0.01)


def test_planning_takes_the_time_of_all_tasks() -> None:
    """Each motion costs a program of the PC as well."""
    main = program("PCEXECUTE 1: other", *SQUARE, "DRIVE 1,2", "DRIVE 1,2", "BREAK")
    other = program("k = 0", "again:", "k = k+1", "GOTO again", name="other")
    slowed = changed(step_s=1e-3, segment_planning_s=0.05)
    counts = [
        AsBench(main + other, behaviour).start() for behaviour in (changed(step_s=1e-3), slowed)
    ]
    for bench in counts:
        bench.advance(0.5)
    turns = counts[0].value("k") - counts[1].value("k")
    assert turns == pytest.approx(100 / 3, abs=5)  # of three steps each


def test_a_simulated_cell_chooses_its_controller() -> None:
    """Least segment and motions ahead are the cell's, with either reading of the manual."""
    kind = behaviour_in(SimSection(as_least_segment_s=0.016, as_motions_ahead=2,
                                   as_dear_step_factor=2.0))  # fmt: skip
    worse = behaviour_in(SimSection(as_pessimistic=True))
    assert (kind.least_segment_s, kind.motions_ahead, kind.abs_speed) == (0.016, 2, False)
    assert (kind.dear_step_factor, worse.dear_step_factor) == (2.0, 4.0)
    assert (worse.least_segment_s, worse.motions_ahead, worse.abs_speed) == (0.03, 3, True)


# --- cost of a step -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("step", "dear"),
    [("x = SIN(1)", True), ("IF COS(x) > 2 THEN\nEND", True), ("$s = $ENCODE(/I6,x)", True),
     ("x = VAL($s)", True), ("POINT q = p", True), ("POINT q = p+TRANS(1)", True),
     ("HERE q", True), ("x = DX(HERE)", True), ("PRINT x", True), ("TCP_CLOSE r,1", True),
     ("CALL sub(ATAN2(x,1))", True),
     ("x = x*2+1", False), ("IF x > 2 THEN\nEND", False),
     ('$s = $s+"a"', False), ("$s = $MID($s,2)", False),
     ("x = ABS(SIG(1))", False), ("CALL sub(x)", False), ("SIGNAL 1", False)],
)  # fmt: skip
def test_a_dear_step_costs_its_factor_and_every_other_step_one(step: str, dear: bool) -> None:
    """Also within an expression; the time is the same in each run of the step."""
    times = []
    for factor in (1.0, 11.0):
        lines = ("x = 1", '$s = "1"', "HERE p", "FOR k = 1 TO 40", step, "END", "t = TIMER(0)")
        bench = AsBench(program(*lines) + program("RETURN", name="sub").replace("()", "(.a)"),
                        changed(step_s=1e-4, dear_step_factor=factor)).run()  # fmt: skip
        times.append(bench.value("t"))
    first_s = 1e-3  # HERE, before the loop
    assert times[1] - times[0] == pytest.approx(first_s + 40 * 1e-3 * dear, abs=1e-5)


# --- errors ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("stands", [False, True])
def test_a_broken_connection_may_be_a_standing_error(stands: bool) -> None:
    """Then it ends the program, and SWITCH(ERROR) is on until ERESET."""
    main = program("PCEXECUTE 1: server", "WHILE TASK(1001) DO", "TWAIT 0.01", "END",
                   "e = ERROR", "w = SWITCH(ERROR)")  # fmt: skip
    bench = AsBench(main + SERVER, changed(tcp_error_stands=stands)).start()
    bench.advance(0.1)
    end = bench.network.dial(int(PORT))
    bench.advance(0.1)
    end.reset()
    assert bench.advance(1.0, lambda: bench.task.state == "idle")
    assert bench.codes == (["E4025"] if stands else [])
    assert bench.value("r") == -34025
    assert (bench.value("e"), bench.value("w")) == ((-34025, -1) if stands else (0, 0))
    assert bench.value("after") == (None if stands else 1)


@pytest.mark.parametrize("stops", [False, True])
def test_an_error_of_a_pc_program_may_stop_the_robot_program(stops: bool) -> None:
    """The arm brakes, and the program can be continued after ERESET."""
    main = program("PCEXECUTE 1: other", *SQUARE, "LMOVE SHIFT(p BY 80,0,0)", "BREAK", "after = 1")
    other = program("TWAIT 0.2", "x = 1/0", name="other")
    bench = AsBench(main + other, changed(pc_error_stops_robot=stops)).start()
    bench.advance(0.3)
    assert bench.task.state == ("stopped" if stops else "running")
    bench.advance(0.5)
    assert bench.robot.queue.is_moving is not stops
    if stops:
        bench.pendant.error_reset()
        bench.pendant.run()
    assert bench.advance(3.0, lambda: bench.task.state == "idle")
    assert bench.value("after") == 1
