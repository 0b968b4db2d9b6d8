"""Numeric functions of AS (reference manual, chapter 9). Angles in degrees."""

import math
from collections.abc import Sequence

from sim.as_language.errors import AsError
from sim.as_language.functions import Argument, function, number, table, whole
from sim.as_language.machine_api import MachineInterface
from sim.as_language.values import single, truth

JOINTS = range(1, 7)


def rounded(value: float) -> float:
    """Round half away from zero: ROUND(-5.662) is -6."""
    return math.copysign(math.floor(abs(value) + 0.5), value) + 0.0


def _sqrt(_: MachineInterface, a: Sequence[Argument]) -> float:
    value = number(a[0])
    if value < 0.0:
        raise AsError("E0106", f"SQRT({value:g}): the argument is negative")
    return single(math.sqrt(value))


def _degrees(value: float) -> float:
    return single(math.degrees(value))


def _sine(degrees: float, shift: float) -> float:
    """Return sin(degrees + shift), exact at the multiples of 90 degrees."""
    turned = math.fmod(degrees + shift, 360.0)
    exact = {0.0: 0.0, 90.0: 1.0, 180.0: 0.0, 270.0: -1.0, -90.0: -1.0, -180.0: 0.0, -270.0: 1.0}
    found = exact.get(turned)
    return single(math.sin(math.radians(turned))) if found is None else found


def _sig(machine: MachineInterface, a: Sequence[Argument]) -> float:
    """Return whether every signal is on; a negative number tests for off."""
    result = True
    for item in a:
        signal = whole(item)
        if signal == 0:
            raise AsError("E0106", "SIG(0): signal numbers start at 1, negative for off")
        result = (machine.signal(abs(signal)) == (signal > 0)) and result
    return truth(result)


def _bits(machine: MachineInterface, a: Sequence[Argument]) -> float:
    start, count = whole(a[0]), whole(a[1] if len(a) > 1 else 1)
    if not 1 <= count <= 16:
        raise AsError("E0106", f"BITS: 1 to 16 signals, not {count}")
    return float(sum(machine.signal(start + k) << k for k in range(count)))


def _bits32(machine: MachineInterface, a: Sequence[Argument]) -> float:
    start, count = whole(a[0]), whole(a[1] if len(a) > 1 else 1)
    if not 1 <= count <= 32:
        raise AsError("E0106", f"BITS32: 1 to 32 signals, not {count}")
    return single(float(sum(machine.signal(start + k) << k for k in range(count))))


def _joint(value: Argument) -> int:
    joint = whole(value)
    if joint not in JOINTS:
        raise AsError("E0106", f"joint {joint}: joints are 1 to 6")
    return joint


FUNCTIONS = table(
    function("ABS", "r", lambda _, a: abs(number(a[0]))),
    function("SQRT", "r", _sqrt),
    function("SIN", "r", lambda _, a: _sine(number(a[0]), 0.0)),
    function("COS", "r", lambda _, a: _sine(number(a[0]), 90.0)),
    function("ATAN2", "rr", lambda _, a: _degrees(math.atan2(number(a[0]), number(a[1])))),
    function("PI", "", lambda _, __: single(math.pi)),
    function("INT", "r", lambda _, a: float(math.trunc(number(a[0])))),
    function("ROUND", "r", lambda _, a: rounded(number(a[0]))),
    function("MAXVAL", "r", lambda _, a: max(map(number, a)), most=25),
    function("MINVAL", "r", lambda _, a: min(map(number, a)), most=25),
    function("RANDOM", "", lambda machine, _: single(machine.random())),
    function("SIG", "r", _sig, most=25),
    function("BITS", "r(r)", _bits),
    function("BITS32", "r(r)", _bits32),
    function("SWITCH", "w", lambda machine, a: truth(machine.switch(str(a[0])))),
    function("EXISTPGM", "w", lambda machine, a: truth(machine.has_program(str(a[0]).lower()))),
    function("TASK", "r", lambda machine, a: float(machine.task_state(whole(a[0])))),
    function("ERROR", "(r)", lambda machine, _: float(machine.error_number())),
    function("TIMER", "r", lambda machine, a: single(machine.timer_s(whole(a[0])))),
    function("MSPEED", "(r)", lambda machine, _: single(machine.monitor_speed_percent())),
    function("IQARM", "r", lambda machine, a: single(machine.motor_current_A(_joint(a[0])))),
    function("TRQNM", "r", lambda machine, a: single(machine.motor_torque_Nm(_joint(a[0])))),
)
