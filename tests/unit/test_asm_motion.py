"""How the emulated arm moves: one motion ahead, blending, stopping, speeds, frames, reach."""

import math

import numpy as np
import pytest

from sim.controller.behaviour import pessimistic
from sim.controller.planner import reach_error
from tests.fakes.as_bench import AsBench, program

# JT1..JT6 -> X, Y, Z [mm]; where O, A, T are unique, those too [deg]. RS007L, null tool and base.
ACCEPTANCE = [
    ((0, 90, 0, 0, 0, 0), (0, 1008, 0), (90, 90, -90)),
    ((0, 0, -90, 0, -80, 0), (0, 488.545, 378.185), (90, 170, -90)),
    ((0, 0, -90, 0, -100, 0), (0, 461.455, 378.185), (-90, 170, 90)),
    ((10, 20, -30, 40, -50, 60), (64.163, 585.066, 730.048), (109.520, 92.084, -0.480)),
    ((-35, 25, -70, 15, -60, 120), (-415.050, 562.271, 302.572), (152.796, 151.272, 62.441)),
]
AT_A_POLE = [
    ((0, 0, 0, 0, 0, 0), (0, 0, 1008), (0, "O+T", 0)),
    ((0, 90, 90, 0, 0, 0), (0, 455, 553), (0, "O+T", 0)),
    ((0, 0, -90, 0, -90, 0), (0, 475, 377), (180, "O-T", 180)),
    ((90, 0, -90, 0, -90, 0), (475, 0, 377), (180, "O-T", 90)),
    ((0, 45, -90, 0, -45, 0), (0, 657.609, -92.142), (180, "O-T", 180)),
]
SQUARE = ("HERE p", "SPEED 100 MM/S ALWAYS")


class Trace:
    """What the arm did: commanded TCP each millisecond."""

    def __init__(self, bench: AsBench) -> None:
        self.points: list[np.ndarray] = []
        self._bench = bench
        self._look()
        bench.machine.after_tick.append(self._look)

    def _look(self) -> None:
        robot = self._bench.robot
        self.points.append(robot.pose_of(robot.queue.q_command).translation * 1e3)

    @property
    def mm(self) -> np.ndarray:
        """Where the command was [mm]. Shape (n, 3)."""
        return np.array(self.points)

    @property
    def speed_mm_s(self) -> np.ndarray:
        """How fast it was. Shape (n - 1,)."""
        return np.linalg.norm(np.diff(self.mm, axis=0), axis=1) * 1e3


def joints(values) -> str:
    """A joint literal."""
    return "#[" + ",".join(str(value) for value in values) + "]"


def here(bench: AsBench) -> np.ndarray:
    """HERE."""
    return np.array(bench.machine.here().numbers())


@pytest.mark.parametrize(("q", "xyz", "oat"), ACCEPTANCE)
def test_here_after_jmove_is_the_vendors_forward_kinematics(q, xyz, oat) -> None:
    """Facts 3.3, measured at the simulated encoders."""
    bench = AsBench(program(f"JMOVE {joints(q)}", "BREAK", "TWAIT 0.3"))
    bench.run()
    assert here(bench)[:3] == pytest.approx(xyz, abs=0.1)
    assert here(bench)[3:] == pytest.approx(oat, abs=0.02)


@pytest.mark.parametrize(("q", "xyz", "angle"), AT_A_POLE)
def test_at_a_pole_of_a_only_the_sum_or_the_difference_counts(q, xyz, angle) -> None:
    """A = 0: O+T, A = 180: O-T (facts 3.3); destination, so without the servos' rest."""
    bench = AsBench(program(f"JMOVE {joints(q)}", "BREAK", "d = DEXT(DEST,1)")).run()
    pose = bench.machine.destination()
    a, kind, expected = angle
    assert (pose.x, pose.y, pose.z) == pytest.approx(xyz, abs=2e-3)
    assert pose.a == pytest.approx(a, abs=1e-3)
    total = pose.o + pose.t if kind == "O+T" else pose.o - pose.t
    assert math.remainder(total - expected, 360.0) == pytest.approx(0.0, abs=1e-3)


def test_a_whole_linear_move_at_tool_down_keeps_tool_down() -> None:
    """A = 180 all the way, though O and T are not defined; aside, and a turn about z."""
    bench = AsBench(program(*SQUARE, "LMOVE SHIFT(p BY 60,0,0)", "LMOVE p+RZ(20)", "BREAK",
                            "TWAIT 0.2"))  # fmt: skip
    tilts = []
    bench.machine.after_tick.append(
        lambda: tilts.append(bench.robot.pose_of(bench.robot.queue.q_command).rotation[2, 2])
    )
    start = bench.machine.here()
    bench.run()
    assert max(tilts) < -1.0 + 1e-9
    end = bench.machine.here()
    assert (end.x, end.y) == pytest.approx((start.x, start.y), abs=0.05)
    turned = (end.o - end.t) - (start.o - start.t)
    assert math.remainder(turned + 20.0, 360.0) == pytest.approx(0.0, abs=0.02)


def test_a_move_through_the_pole_goes_straight_and_turns_evenly() -> None:
    """From A = 170 on one side to 170 on the other: O jumps by 180 degrees, the arm does not."""
    bench = AsBench(program("HERE p", "SPEED 50 MM/S ALWAYS", "LMOVE p+RX(10)", "BREAK",
                            "LMOVE p+RX(-10)", "BREAK"))  # fmt: skip
    trace, last = Trace(bench), None
    steps: list[float] = []

    def look() -> None:
        nonlocal last
        q = bench.robot.queue.q_command
        if last is not None:
            steps.append(float(np.abs(q - last).max()))
        last = q

    bench.machine.after_tick.append(look)
    bench.run()
    assert np.ptp(trace.mm, axis=0).max() < 1e-4
    assert max(steps) < math.radians(0.05)


def test_a_linear_motion_is_straight_and_has_the_programs_speed() -> None:
    """80 mm aside at 100 mm/s: never faster, on the line within a micrometre."""
    bench = AsBench(program(*SQUARE, "LMOVE SHIFT(p BY 80,0,0)", "BREAK"))
    trace = Trace(bench)
    bench.run()
    way = trace.mm - trace.mm[0]
    assert np.abs(way[:, 1:]).max() < 1e-3
    assert way[-1, 0] == pytest.approx(80.0, abs=1e-3)
    assert trace.speed_mm_s.max() == pytest.approx(100.0, rel=0.01)
    assert np.diff(trace.speed_mm_s).max() < 2.0 + 1e-6  # 2 m/s^2 is 2 mm/s each ms


@pytest.mark.parametrize("percent", [10, 50, 100])
def test_the_monitor_speed_multiplies_every_program_speed(percent: int) -> None:
    """Linear and joint motions alike; also MC SPEED while a motion is under way."""
    for move in ("LMOVE SHIFT(p BY 30,0,0)", "DRIVE 1,10,20"):
        bench = AsBench(program("HERE p", "SPEED 60 MM/S", move, "BREAK"))
        bench.pendant.monitor_speed(percent)
        trace, rates = Trace(bench), []
        bench.run()
        rates = trace.speed_mm_s.max()
        reference = AsBench(program("HERE p", "SPEED 60 MM/S", move, "BREAK"))
        full = Trace(reference)
        reference.run()
        assert rates == pytest.approx(full.speed_mm_s.max() * percent / 100, rel=0.03)


def test_speed_without_always_is_for_the_next_motion_only() -> None:
    """The second motion goes with the speed set ALWAYS."""
    bench = AsBench(program("HERE p", "SPEED 40 MM/S ALWAYS", "SPEED 80 MM/S",
                            "LMOVE SHIFT(p BY 20,0,0)", "BREAK", "a = TIMER(0)",
                            "LMOVE p", "BREAK"))  # fmt: skip
    trace = Trace(bench)
    bench.run()
    half = int(bench.value("a") * 1000)
    assert trace.speed_mm_s[:half].max() == pytest.approx(80.0, rel=0.02)
    assert trace.speed_mm_s[half:].max() == pytest.approx(40.0, rel=0.02)


def test_speed_in_seconds_is_the_time_of_the_motion() -> None:
    """SPEED 2 S: two seconds and the ramps."""
    bench = AsBench(program("HERE p", "SPEED 2 S", "LMOVE SHIFT(p BY 40,0,0)", "BREAK",
                            "t = TIMER(0)")).run()  # fmt: skip
    assert bench.value("t") == pytest.approx(2.05, abs=0.06)


def corner(cp: str, accuracy_mm: float) -> tuple[AsBench, Trace]:
    """Go 40 mm aside and 40 mm across."""
    bench = AsBench(program(cp, *SQUARE, f"ACCURACY {accuracy_mm} ALWAYS",
                            "LMOVE SHIFT(p BY 40,0,0)", "LMOVE SHIFT(p BY 40,40,0)",
                            "BREAK"))  # fmt: skip
    trace = Trace(bench)
    bench.run()
    return bench, trace


def test_cp_on_cuts_the_corner_within_accuracy_and_does_not_stop() -> None:
    """The path misses the corner by less than ACCURACY, and a larger one misses it by more."""
    misses = []
    for accuracy_mm in (1.0, 5.0, 20.0):
        _, trace = corner("CP ON", accuracy_mm)
        way = trace.mm - trace.mm[0]
        miss = np.linalg.norm(way - [40.0, 0.0, 0.0], axis=1).min()
        middle = slice(np.argmax(way[:, 0] > 20), np.argmax(way[:, 1] > 20))
        assert 0.0 < miss <= accuracy_mm
        assert trace.speed_mm_s[middle].min() > 10.0
        misses.append(miss)
    assert misses[0] < misses[1]
    assert misses[2] == pytest.approx(misses[1], rel=0.2)  # it slows down over 2.5 mm at most


def test_cp_off_stops_in_every_point() -> None:
    """The corner is reached exactly, and the speed goes down to nothing there."""
    _, trace = corner("CP OFF", 20.0)
    miss = np.linalg.norm(trace.mm - trace.mm[0] - [40.0, 0.0, 0.0], axis=1)
    assert miss.min() < 1e-3
    at = int(miss.argmin())
    assert trace.speed_mm_s[at - 2 : at + 2].min() < 2.0


def test_the_program_runs_one_motion_ahead() -> None:
    """Steps behind LMOVE run while it moves; the next LMOVE waits until it is handed over."""
    bench = AsBench(program(*SQUARE, "LMOVE SHIFT(p BY 50,0,0)", "a = TIMER(0)",
                            "LMOVE SHIFT(p BY 100,0,0)", "b = TIMER(0)", "BREAK",
                            "c = TIMER(0)")).run()  # fmt: skip
    assert bench.value("a") < 0.02
    assert bench.value("b") == pytest.approx(0.5, abs=0.06)
    assert bench.value("c") == pytest.approx(1.07, abs=0.08)


def test_a_stream_of_short_moves_is_faster_with_cp_and_accuracy() -> None:
    """Ten moves of 2 mm: with CP ON they flow, with CP OFF each one stops."""
    times = {}
    for cp in ("CP ON", "CP OFF"):
        bench = AsBench(
            program(
                cp,
                *SQUARE,
                "ACCURACY 5 ALWAYS",
                "FOR i = 1 TO 10",
                "LMOVE SHIFT(p BY 2*i,0,0)",
                "END",
                "BREAK",
                "t = TIMER(0)",
            )
        )
        times[cp] = bench.run().value("t")
    assert times["CP ON"] < 0.6 * times["CP OFF"]


def braked(source: str, at_s: float, **kwargs) -> tuple[AsBench, Trace]:
    """Run a program that a PC program brakes at a time."""
    brake = program(f"TWAIT {at_s}", "BRAKE", name="brake")
    bench = AsBench(source + brake, **kwargs)
    trace = Trace(bench)
    bench.machine.start_pc(1001, "brake")
    bench.run()
    return bench, trace


def test_brake_from_a_pc_program_stops_within_v2_over_2a() -> None:
    """100 mm/s at 2.5 m/s^2 are 2 mm and 40 ms; the path is kept."""
    source = program(*SQUARE, "LMOVE SHIFT(p BY 100,0,0)", "BREAK", "t = TIMER(0)")
    _, trace = braked(source, 0.5)
    at = 501
    rest = trace.mm[-1] - trace.mm[at]
    assert rest[0] == pytest.approx(2.0, abs=0.15)
    assert np.abs(rest[1:]).max() < 1e-3
    assert trace.speed_mm_s[at + 42 :].max() < 1e-6


def test_brake_drops_the_motion_ahead_and_the_pessimistic_controller_starts_it() -> None:
    """The open question of the facts, both readings."""
    source = program(*SQUARE, "LMOVE SHIFT(p BY 100,0,0)", "LMOVE SHIFT(p BY 0,50,0)", "n = 1",
                     "BREAK")  # fmt: skip
    kind, _ = braked(source, 0.5)
    hard, _ = braked(source, 0.5, behaviour=pessimistic(2e-5))
    start = AsBench(source).machine.here()
    assert kind.machine.here().y == pytest.approx(start.y, abs=0.1)
    assert hard.machine.here().y == pytest.approx(start.y + 50.0, abs=0.1)
    assert kind.value("n") == 1


def test_brake_in_the_robot_program_waits_for_the_stop() -> None:
    """The next step sees an arm that stands, short of the target."""
    bench = AsBench(
        program(
            *SQUARE,
            "LMOVE SHIFT(p BY 100,0,0)",
            "TWAIT 0.3",
            "BRAKE",
            "a = DX(HERE)-DX(p)",
            "TWAIT 0.2",
            "b = DX(HERE)-DX(p)",
        )
    ).run()
    assert 25.0 < bench.value("a") < 35.0
    assert bench.value("b") == pytest.approx(bench.value("a"), abs=0.02)


def test_hold_decelerates_and_run_finishes_the_motion() -> None:
    """HOLD keeps the rest of the way; nothing moves until RUN."""
    bench = AsBench(program(*SQUARE, "LMOVE SHIFT(p BY 50,0,0)", "BREAK", "x = 1"))
    trace = Trace(bench)
    bench.start().advance(0.25)
    bench.pendant.hold()
    bench.advance(1.0)
    held = trace.mm[-1] - trace.mm[0]
    assert 20.0 < held[0] < 30.0
    assert trace.speed_mm_s[-900:].max() < 1e-9
    bench.pendant.run()
    assert bench.advance(2.0, lambda: bench.value("x") == 1)
    assert (trace.mm[-1] - trace.mm[0])[0] == pytest.approx(50.0, abs=1e-3)


def test_a_motion_that_is_braked_while_held_is_not_resumed_by_run() -> None:
    """What a watchdog relies on: BRAKE during HOLD drops the rest of the way."""
    bench = AsBench(program(*SQUARE, "LMOVE SHIFT(p BY 50,0,0)", "BREAK", "TWAIT 100")
                    + program("BRAKE", name="brake"))  # fmt: skip
    trace = Trace(bench)
    bench.start().advance(0.25)
    bench.pendant.hold()
    bench.advance(0.5)
    bench.machine.start_pc(1001, "brake")
    bench.advance(0.1)
    bench.pendant.run()
    bench.advance(1.0)
    assert trace.speed_mm_s[-1100:].max() < 1e-9


def test_abort_finishes_the_motion_and_ends_the_program() -> None:
    """TASK is 3 while the motion of an ended program goes on."""
    bench = AsBench(program(*SQUARE, "LMOVE SHIFT(p BY 50,0,0)", "LMOVE p", "x = 1"))
    trace = Trace(bench)
    bench.start().advance(0.2)
    bench.pendant.abort()
    assert bench.machine.task_state(1) == 3
    bench.advance(1.0)
    assert bench.machine.task_state(1) == 0
    assert (trace.mm[-1] - trace.mm[0])[0] == pytest.approx(50.0, abs=1e-3)
    assert bench.value("x") is None


def test_an_emergency_stop_brakes_and_nothing_moves_until_power_and_run() -> None:
    """Power on alone moves nothing either; after RUN the program goes on with its next motion."""
    bench = AsBench(program(*SQUARE, "LMOVE SHIFT(p BY 100,0,0)", "BREAK", "LMOVE p", "BREAK"))
    trace = Trace(bench)
    bench.start().advance(0.5)
    bench.pendant.emergency_stop()
    bench.advance(0.1)
    assert trace.speed_mm_s[-40:].max() < 1e-6
    bench.pendant.motor_power(on=True)
    assert not bench.robot.motor_power
    bench.pendant.release_emergency_stop()
    bench.pendant.motor_power(on=True)
    bench.advance(0.5)
    assert trace.speed_mm_s[-400:].max() < 1e-6
    bench.pendant.run()
    assert bench.advance(3.0, lambda: bench.task.state == "idle")
    assert np.linalg.norm(trace.mm[-1] - trace.mm[0]) < 0.1


def test_the_end_of_the_program_is_not_the_end_of_its_motion() -> None:
    """The arm arrives after the last step."""
    bench = AsBench(program(*SQUARE, "LMOVE SHIFT(p BY 30,0,0)")).start()
    bench.advance(0.05)
    assert bench.machine.task_state(1) == 3
    bench.advance(1.0)
    assert bench.machine.task_state(1) == 0


@pytest.mark.parametrize(
    ("lines", "moved"),
    [
        (("DRAW 10,20,-5,0,0,0,50 MM/S",), (10, 20, -5)),
        (("TDRAW 10,20,-5,0,0,0,50 MM/S",), (10, -20, 5)),
        (("LDEPART 15",), (0, 0, 15)),
        (("LAPPRO p,25",), (0, 0, 25)),
        (("JAPPRO p,25",), (0, 0, 25)),
        (("LAPPRO SHIFT(p BY 5,0,0),25", "LMOVE SHIFT(p BY 5,0,0)"), (5, 0, 0)),
        (("LMOVE SHIFT(p BY 5,0,0)", "LDEPART 10", "LDEPART 10"), (5, 0, 20)),
        (("JMOVE SHIFT(p BY -7,8,9)",), (-7, 8, 9)),
        (("HMOVE SHIFT(p BY -7,8,9)",), (-7, 8, 9)),
        (("LMOVE #PPOINT(0,0,-90,0,-90,0)",), (0, 0, 0)),
        (("LMOVE SHIFT(p BY 0,5,0)", "HOME"), (0, 0, 0)),
        (("BASE TRANS(100,0,0)", "LMOVE p"), (100, 0, 0)),
        (("TOOL TRANS(0,0,20)", "LMOVE p"), (0, 0, 20)),
        (("BASE TRANS(0,0,0,90)", "DRAW 10,0,0", "BREAK", "BASE NULL"), (0, 10, 0)),
        (("TOOL TRANS(0,0,100)", "LMOVE HERE+RX(10)"), (0, None, None)),
    ],
)  # fmt: skip
def test_every_motion_instruction_goes_where_it_says(lines, moved) -> None:
    """Displacement of the flange in the robot's base, with the tool down."""
    bench = AsBench(program("HERE p", "SPEED 50 MM/S ALWAYS", *lines, "BREAK", "TWAIT 0.1"))
    start = bench.robot.kinematics.flange_pose(bench.robot.q).translation
    bench.run()
    end = bench.robot.kinematics.flange_pose(bench.robot.q).translation
    for value, expected in zip((end - start) * 1e3, moved, strict=True):
        if expected is not None:
            assert value == pytest.approx(expected, abs=0.05)


def test_a_turn_about_the_tools_point_leaves_that_point_where_it_is() -> None:
    """TOOL 150 mm out: 15 degrees about its x axis move the flange, not the tool."""
    bench = AsBench(program("TOOL TRANS(0,0,150)", "SPEED 50 MM/S ALWAYS", "LMOVE HERE+RX(15)",
                            "BREAK"))  # fmt: skip
    trace = Trace(bench)
    bench.start().advance(0.05)
    begin = len(trace.points)
    assert bench.advance(5.0, lambda: bench.task.state == "idle")
    assert np.ptp(trace.mm[begin:], axis=0).max() < 1e-3


def test_drive_turns_one_joint_by_its_angle() -> None:
    """The others stand."""
    bench = AsBench(program("DRIVE 3,12.5", "DRIVE 6,-30", "BREAK", "TWAIT 0.2",
                            "POINT #a = #HERE", "DECOMPOSE j[1] = #a")).run()  # fmt: skip
    assert [bench.value(f"j[{k}]") for k in range(1, 7)] == pytest.approx(
        [0, 0, -77.5, 0, -90, -30], abs=0.01
    )


def test_point_computes_joints_and_back() -> None:
    """POINT #j = p solves the inverse kinematics, POINT p = #j the forward one."""
    bench = AsBench(program("POINT p = TRANS(100,500,300,20,170,30)", "POINT #j = p",
                            "POINT q = #j", "DECOMPOSE x[1] = q",
                            "POINT/OAT r = p", "POINT/X r = q", "y = DX(r)")).run()  # fmt: skip
    numbers = [bench.value(f"x[{k}]") for k in range(1, 7)]
    assert numbers == pytest.approx([100, 500, 300, 20, 170, 30], abs=1e-3)
    assert bench.value("y") == pytest.approx(100, abs=1e-3)


def test_here_is_relative_to_a_frame_when_asked() -> None:
    """HERE a+b defines b, so that a+b is where the arm is."""
    bench = AsBench(program("POINT a = TRANS(10,20,30,40,50,60)", "HERE a+b",
                            "d = DISTANCE(a+b, HERE)")).run()  # fmt: skip
    assert bench.value("d") == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize(
    ("line", "code"),
    [
        ("LMOVE TRANS(0,2000,300,0,180,0)", "E6007"),
        ("JMOVE TRANS(0,2000,300,0,180,0)", "E6007"),
        ("JMOVE #[0,136,0,0,0,0]", "E6007"),
        ("DRIVE 1,181", "E6007"),
        ("POINT #j = TRANS(0,0,5000)", "E6007"),
        ("LMOVE #[0,0,90,0,90,0]", "E6007"),
    ],
)
def test_targets_that_cannot_be_reached_stop_before_anything_moves(line: str, code: str) -> None:
    """E6007: too far, or a joint beyond its limit, at the end or on the way."""
    bench = AsBench(program(line))
    trace = Trace(bench)
    assert bench.fail().code == code
    bench.advance(0.5)
    assert np.ptp(trace.mm, axis=0).max() < 1e-6


def test_reasons_of_the_kinematics_have_the_manuals_codes() -> None:
    """Out of range, a singular pose in the way, another posture needed."""
    reasons = (
        "joint 3 would be at 160 deg, its limits are -157 .. 157 deg",
        "out of reach: far",
        "not reachable from here: a singular pose is in the way",
        "joint 4 would jump",
    )
    codes = [reach_error(reason).code for reason in reasons]
    assert codes == ["E6007", "E6007", "E6016", "E6008"]


def test_a_motion_ahead_that_cannot_be_reached_fails_at_its_own_step() -> None:
    """The motion under way is braked; the message names the step of the bad one."""
    bench = AsBench(program(*SQUARE, "LMOVE SHIFT(p BY 50,0,0)", "LMOVE SHIFT(p BY 0,2000,0)"))
    assert bench.fail().code == "E6007"
    assert bench.stopped_at == ("main", 4)


def test_delay_and_stable_keep_the_arm_standing_between_motions() -> None:
    """DELAY 0.5 between two motions: they do not blend, and half a second passes."""
    bench = AsBench(program(*SQUARE, "LMOVE SHIFT(p BY 10,0,0)", "DELAY 0.5",
                            "LMOVE SHIFT(p BY 20,0,0)", "BREAK"))  # fmt: skip
    trace = Trace(bench)
    bench.run()
    still = np.convolve(trace.speed_mm_s < 1e-9, np.ones(490), "valid").max()
    assert still >= 489


def test_mvwait_waits_until_so_much_is_left() -> None:
    """MVWAIT 20 of a 50 mm way."""
    bench = AsBench(program(*SQUARE, "LMOVE SHIFT(p BY 50,0,0)", "MVWAIT 20",
                            "a = DX(HERE)-DX(p)", "BREAK")).run()  # fmt: skip
    assert 26.0 < bench.value("a") < 31.0


def test_motors_off_refuse_a_motion() -> None:
    """P1000 when a running program meets a dead robot is impossible: power off holds it."""
    bench = AsBench(program(*SQUARE, "LMOVE SHIFT(p BY 50,0,0)", "BREAK")).start()
    bench.advance(0.1)
    bench.pendant.motor_power(on=False)
    bench.advance(0.5)
    assert bench.task.state == "held"
