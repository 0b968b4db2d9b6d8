"""SYSDATA and $SYSDATA: what a program reads about the controller, its motion and its errors."""

import pytest

from tests.fakes.as_bench import AsBench, program


def read(*lines: str, of: str) -> float:
    """The value of a keyword after these steps."""
    value: float = AsBench(program(*lines, f"x = SYSDATA({of})")).run().value("x")
    return value


@pytest.mark.parametrize(
    ("of", "value"),
    [("NUMROBOT", 1), ("ZROB.MGFNO", 1), ("CONT.NO", 1), ("ZROB.NOWAXIS", 6), ("zrob.nowaxis,1", 6),
     ("SIG.DO", 960), ("SIG.DI", 960), ("SIG.INT", 960), ("LANGUAGE", 2), ("MEM.FREE", 100),
     ("ERROR.CODE", 0), ("ERROR.AXIS", 0)],
)  # fmt: skip
def test_the_controller_has_one_arm_of_six_joints_and_speaks_english(of: str, value: float) -> None:
    """Constants of the emulator; the robot's number may be given."""
    assert read(of=of) == value


def test_the_last_motion_is_read_while_it_runs_and_afterwards() -> None:
    """Its step, speed in % and mm/s, ramps; the monitor speed only while the arm moves."""
    bench = AsBench(program("SPEED 500 MM/S ALWAYS", "ACCEL 40 ALWAYS", "DECEL 60 ALWAYS",
                            "LMOVE SHIFT(HERE BY 20,0,0)", "m = SYSDATA(M.SPEED)", "BREAK",
                            "n = SYSDATA(M.SPEED)", "s = SYSDATA(MSTEP)", "p = SYSDATA(P.SPEED)",
                            "q = SYSDATA(P.SPEED.M)", "a = SYSDATA(P.ACCEL)",
                            "d = SYSDATA(P.DECEL)"))  # fmt: skip
    bench.pendant.monitor_speed(50.0)
    bench.run()
    assert [bench.value(name) for name in "mns"] == [50, -1, 4]
    assert [bench.value(name) for name in "pqad"] == pytest.approx([25, 500, 40, 60])


def test_the_motor_current_is_that_of_iqarm() -> None:
    """Command and feedback alike."""
    bench = AsBench(program("TWAIT 0.1", "a = IQARM(2)", "b = SYSDATA(MTR.CURR,1,2)",
                            "c = SYSDATA(MTR.CURR.CMD,,2)"))  # fmt: skip
    force_Nm = bench.robot.arm.data.actuator_force
    bench.machine.after_tick.append(lambda: force_Nm.__setitem__(1, 12.5))
    bench.run()
    assert [bench.value(name) for name in "abc"] == [12.5, 12.5, 12.5]


@pytest.mark.parametrize(
    ("line", "code"),
    [("x = SYSDATA(WIBBLE)", "P0116"), ("x = SYSDATA(MTR.RPM)", "P0116"),
     ("$x = $SYSDATA(WIBBLE)", "P0116"), ("x = SYSDATA()", "P0116"),
     ("x = SYSDATA(M.SPEED,2)", "P0104"), ("x = SYSDATA(MTR.CURR,1,7)", "E0106"),
     ("x = SYSDATA(STEP,2000)", "E0106")],
)  # fmt: skip
def test_what_is_not_there_is_an_error_of_as(line: str, code: str) -> None:
    """An unknown keyword, a second robot, a seventh joint, a task that does not exist."""
    assert AsBench(program(line)).fail().code == code
