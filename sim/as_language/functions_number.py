"""Numeric functions of AS (reference manual, chapter 9). Angles in degrees."""

import math
from collections.abc import Callable

from sim.as_language.errors import AsError
from sim.as_language.functions import function
from sim.as_language.machine_api import MachineInterface
from sim.as_language.values import single, truth

JOINTS = range(1, 7)
# sin is exact at the multiples of 90 degrees.
EXACT_SINES = {
    0.0: 0.0, 90.0: 1.0, 180.0: 0.0, 270.0: -1.0, -90.0: -1.0, -180.0: 0.0, -270.0: 1.0,
}  # fmt: skip


def rounded(value: float) -> float:
    """Round half away from zero: ROUND(-5.662) is -6."""
    return math.copysign(math.floor(abs(value) + 0.5), value) + 0.0


def square_root(value: float) -> float:
    """SQRT(x)."""
    if value < 0.0:
        raise AsError("E0106", f"SQRT({value:g}): the argument is negative")
    return single(math.sqrt(value))


def sine(degrees: float) -> float:
    """SIN(x)."""
    turned = math.fmod(degrees, 360.0)
    found = EXACT_SINES.get(turned)
    return single(math.sin(math.radians(turned))) if found is None else found


def are_on(machine: MachineInterface, signal: float, *others: float) -> float:
    """SIG(s1,s2,..): whether every signal is on; a negative number tests for off."""
    result = True
    for number in map(int, (signal, *others)):
        if number == 0:
            raise AsError("E0106", "SIG(0): signal numbers start at 1, negative for off")
        result = (machine.signal(abs(number)) == (number > 0)) and result
    return truth(result)


def bits(name: str, most: int) -> Callable[[MachineInterface, float, float], float]:
    """Return BITS(s,n) or BITS32(s,n): the number that up to `most` signals show."""

    def compute(machine: MachineInterface, start: float, count: float = 1.0) -> float:
        if not 1 <= int(count) <= most:
            raise AsError("E0106", f"{name}: 1 to {most} signals, not {int(count)}")
        shown = (machine.signal(int(start) + k) << k for k in range(int(count)))
        return single(float(sum(shown)))

    return compute


def _joint(value: float) -> int:
    joint = int(value)
    if joint not in JOINTS:
        raise AsError("E0106", f"joint {joint}: joints are 1 to 6")
    return joint


FUNCTIONS = {
    "ABS": function("r", abs),
    "SQRT": function("r", square_root),
    "SIN": function("r", sine),
    "COS": function("r", lambda degrees: sine(degrees + 90.0)),
    "ATAN2": function("rr", lambda y, x: single(math.degrees(math.atan2(y, x)))),
    "PI": function("", lambda: single(math.pi)),
    "INT": function("r", lambda value: float(math.trunc(value))),
    "ROUND": function("r", rounded),
    "MAXVAL": function("r*", lambda first, *others: max((first, *others))),
    "MINVAL": function("r*", lambda first, *others: min((first, *others))),
    "RANDOM": function("m", lambda machine: single(machine.random())),
    "SIG": function("mr*", are_on),
    "BITS": function("mrr", bits("BITS", 16)),
    "BITS32": function("mrr", bits("BITS32", 32)),
    "SWITCH": function("mw", lambda machine, name: truth(machine.switch(name))),
    "EXISTPGM": function("mw", lambda machine, name: truth(machine.has_program(name.lower()))),
    "TASK": function("mr", lambda machine, number: float(machine.task_state(int(number)))),
    "ERROR": function("mr", lambda machine, _=0.0: float(machine.error_number())),
    "TIMER": function("mr", lambda machine, number: single(machine.timer_s(int(number)))),
    "MSPEED": function("mr", lambda machine, _=0.0: single(machine.monitor_speed_percent())),
    "IQARM": function("mr", lambda machine, n: single(machine.motor_current_A(_joint(n)))),
    "TRQNM": function("mr", lambda machine, n: single(machine.motor_torque_Nm(_joint(n)))),
}
