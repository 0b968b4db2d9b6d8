"""Functions of AS (reference manual, chapter 9): types of the arguments, and the computation.

Angles in degrees, lengths in millimetres; choices where the manual is ambiguous: as-emulator.md.

The parameters of the Python function are the arguments of the AS function; their defaults apply to
omitted ones. Types are letters, one per argument: r number, s string, t transformation, j joint
values, p either of the two, w word, x number or string; r* any number of numbers. A leading m: the
machine is passed first.
"""

import inspect
import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from controller.error_codes import code_of
from sim.as_language.errors import AsError, error_text
from sim.as_language.machine_api import EvaluationContext, MachineInterface, Read, ReadOf
from sim.as_language.values import (
    Joints,
    Pose,
    Transformation,
    Value,
    joints,
    se3_of,
    single,
    text,
    transformation,
    transformation_of,
    truth,
)

Argument = Value | None

TYPES: dict[str, tuple[tuple[type, ...], str]] = {
    "r": ((float, int), "a number"),
    "s": ((str,), "a string"),
    "t": ((Transformation,), "a transformation"),
    "j": ((Joints,), "joint values"),
    "p": ((Transformation, Joints), "a pose"),
    "w": ((str,), "a name"),
    "x": ((float, int, str), "a number or a string"),
}
MOST = 25  # arguments of a function that takes any number of them


class AsFunction:
    """One function: argument types, defaults of the optional ones, computation."""

    def __init__(self, types: str, compute: Callable[..., Value], most: int = MOST) -> None:
        """Read the defaults; `most` limits the arguments of one that takes any number of them."""
        self.compute, self.of_machine = compute, types.startswith("m")
        parameters = list(inspect.signature(compute).parameters.values())[self.of_machine :]
        self.defaults = tuple(p.default for p in parameters if p.kind is not p.VAR_POSITIONAL)
        self.required = sum(default is inspect.Parameter.empty for default in self.defaults)
        self.types = types.removeprefix("m").removesuffix("*")
        self.most = most if types.endswith("*") else len(self.types)

    def check_count(self, name: str, count: int) -> None:
        """Reject a wrong number of arguments (P0101, P0116)."""
        if count > self.most:
            raise AsError("P0101", f"{name} takes at most {self.most}, found {count}")
        if count < self.required:
            raise AsError("P0116", f"{name} takes at least {self.required}, found {count}")

    def checked(self, name: str, arguments: Sequence[Argument]) -> list[Any]:
        """Return the arguments with defaults, numbers as floats. Raises AsError P0116."""
        result: list[Any] = []
        for number, argument in enumerate(arguments):
            kinds, plain = TYPES[self.types[min(number, len(self.types) - 1)]]
            if argument is None:
                if number < self.required:
                    raise AsError("P0116", f"{name} needs argument {number + 1}, {plain}")
                result.append(self.defaults[number] if number < len(self.defaults) else 0.0)
            elif not isinstance(argument, kinds):
                raise AsError("P0116", f"argument {number + 1} of {name} must be {plain}")
            else:
                result.append(float(argument) if isinstance(argument, int) else argument)
        return result

    def call(self, name: str, readers: Sequence[ReadOf[Argument]]) -> Read:
        """Compile a call. Types that passed the check once always pass."""
        passed: set[tuple[type, ...]] = set()
        compute, of_machine = self.compute, self.of_machine

        def run(context: EvaluationContext) -> Value:
            arguments: Sequence[Any] = [read(context) for read in readers]
            types = tuple(map(type, arguments))
            if types not in passed:
                arguments = self.checked(name, arguments)
                if types == tuple(map(type, arguments)):
                    passed.add(types)
            return compute(context.machine, *arguments) if of_machine else compute(*arguments)

        if len(readers) != 1 or of_machine:
            return run
        (only,) = readers
        passed_one: set[type] = set()

        def run_one(context: EvaluationContext) -> Value:
            """Do the same for one argument, in less time."""
            argument = only(context)
            if argument.__class__ in passed_one:
                return compute(argument)
            (checked,) = self.checked(name, (argument,))
            if checked is argument:
                passed_one.add(argument.__class__)
            return compute(checked)

        return run_one


# --- numbers --------------------------------------------------------------------------------------

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


def system_data(
    machine: MachineInterface, keyword: str, first: float = 1.0, second: float = 1.0
) -> float:
    """SYSDATA(keyword,opt1,opt2)."""
    return single(machine.system_number(keyword.lower(), int(first), int(second)))


def _joint(value: float) -> int:
    joint = int(value)
    if joint not in JOINTS:
        raise AsError("E0106", f"joint {joint}: joints are 1 to 6")
    return joint


NUMBER_FUNCTIONS = {
    "ABS": AsFunction("r", abs),
    "SQRT": AsFunction("r", square_root),
    "SIN": AsFunction("r", sine),
    "COS": AsFunction("r", lambda degrees: sine(degrees + 90.0)),
    "ATAN2": AsFunction("rr", lambda y, x: single(math.degrees(math.atan2(y, x)))),
    "PI": AsFunction("", lambda: single(math.pi)),
    "INT": AsFunction("r", lambda value: float(math.trunc(value))),
    "ROUND": AsFunction("r", rounded),
    "MAXVAL": AsFunction("r*", lambda first, *others: max((first, *others))),
    "MINVAL": AsFunction("r*", lambda first, *others: min((first, *others))),
    "RANDOM": AsFunction("m", lambda machine: single(machine.random())),
    "SIG": AsFunction("mr*", are_on),
    "BITS": AsFunction("mrr", bits("BITS", 16)),
    "BITS32": AsFunction("mrr", bits("BITS32", 32)),
    "SWITCH": AsFunction("mw", lambda machine, name: truth(machine.switch(name))),
    "EXISTPGM": AsFunction("mw", lambda machine, name: truth(machine.has_program(name.lower()))),
    "WHICHTASK": AsFunction("ms", lambda machine, name: float(machine.task_of(name.lower()))),
    "TASK": AsFunction("mr", lambda machine, number: float(machine.task_state(int(number)))),
    "ERROR": AsFunction("mr", lambda machine, _=0.0: float(machine.error_number())),
    "TIMER": AsFunction("mr", lambda machine, number: single(machine.timer_s(int(number)))),
    "UTIMER": AsFunction("mr", lambda machine, zero: single(machine.user_timer_s(zero))),
    "SYSDATA": AsFunction("mwrr", system_data),
    "MSPEED": AsFunction("mr", lambda machine, _=0.0: single(machine.monitor_speed_percent())),
    "IQARM": AsFunction("mr", lambda machine, n: single(machine.motor_current_A(_joint(n)))),
    "TRQNM": AsFunction("mr", lambda machine, n: single(machine.motor_torque_Nm(_joint(n)))),
}


# --- poses ----------------------------------------------------------------------------------------

PARALLEL_AXES = 1e-9


def _place(machine: MachineInterface, pose: Pose) -> Transformation:
    return machine.transformation_of(pose) if isinstance(pose, Joints) else pose


def shift(
    place: Transformation, dx: float = 0.0, dy: float = 0.0, dz: float = 0.0
) -> Transformation:
    """SHIFT(p BY x,y,z): along the base axes; the orientation is unchanged."""
    return transformation(place.x + dx, place.y + dy, place.z + dz, place.o, place.a, place.t)


def _about(axis: str, degrees: float) -> Transformation:
    return transformation_of(pin.SE3(pin.utils.rotate(axis, math.radians(degrees)), np.zeros(3)))


def frame(
    x_from: Transformation, x_to: Transformation, y_side: Transformation, origin: Transformation
) -> Transformation:
    """Return the frame whose X axis points from the first to the second point.

    The third lies on the +Y side of the XY plane, the fourth is the origin.
    """
    a, b, c = (np.array(place.numbers()[:3]) for place in (x_from, x_to, y_side))
    x_axis = b - a
    z_axis = np.cross(x_axis, c - a)
    if np.linalg.norm(x_axis) < PARALLEL_AXES or np.linalg.norm(z_axis) < PARALLEL_AXES:
        raise AsError("E0106", "FRAME: the first three points are collinear")
    x_axis /= np.linalg.norm(x_axis)
    z_axis /= np.linalg.norm(z_axis)
    R = np.column_stack([x_axis, np.cross(z_axis, x_axis), z_axis])
    return transformation_of(pin.SE3(R, se3_of(origin).translation))


def component(pose: Pose, number: float) -> float:
    """DEXT(p,n): one of the six numbers."""
    if not 1 <= int(number) <= 6:
        raise AsError("E0106", f"DEXT: components are 1 to 6, not {int(number)}")
    return pose.numbers()[int(number) - 1]


def distance(machine: MachineInterface, first: Pose, second: Pose) -> float:
    """DISTANCE(p,q)."""
    return single(math.dist(_place(machine, first)[:3], _place(machine, second)[:3]))


def in_range(machine: MachineInterface, pose: Pose, near: Joints | None = None) -> float:
    """INRANGE(p,#j)."""
    return float(machine.in_range(pose, near))


POSE_FUNCTIONS = {
    "HERE": AsFunction("m", lambda machine: machine.here()),
    "#HERE": AsFunction("m", lambda machine: machine.here_joints()),
    "DEST": AsFunction("m", lambda machine: machine.destination()),
    "#DEST": AsFunction("m", lambda machine: machine.destination_joints()),
    "#HOME": AsFunction("mr", lambda machine, number=1.0: machine.home_joints(int(number))),
    "BASE": AsFunction("m", lambda machine: machine.base()),
    "TOOL": AsFunction("m", lambda machine: machine.tool()),
    "NULL": AsFunction("", Transformation),
    "TRANS": AsFunction("r*", transformation, most=6),
    "#PPOINT": AsFunction("r*", joints, most=6),
    "SHIFT": AsFunction("trrr", shift),
    "RX": AsFunction("r", lambda degrees: _about("x", degrees)),
    "RY": AsFunction("r", lambda degrees: _about("y", degrees)),
    "RZ": AsFunction("r", lambda degrees: _about("z", degrees)),
    "FRAME": AsFunction("tttt", frame),
    "DX": AsFunction("mp", lambda machine, pose: _place(machine, pose).x),
    "DY": AsFunction("mp", lambda machine, pose: _place(machine, pose).y),
    "DZ": AsFunction("mp", lambda machine, pose: _place(machine, pose).z),
    "DEXT": AsFunction("pr", component),
    "DISTANCE": AsFunction("mpp", distance),
    "INRANGE": AsFunction("mpj", in_range),
}


# --- strings --------------------------------------------------------------------------------------

DECIMAL = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([Ee][+-]?\d+)?", re.ASCII)
DIGITS = {1: re.compile(r"[01]+"), 2: re.compile(r"[0-9A-Fa-f]+")}
BASES = {1: 2, 2: 16}


def right(characters: str, count: float) -> str:
    """$RIGHT($s,n): the last characters; all of them if there are fewer."""
    return characters[-int(count) :] if int(count) > 0 else ""


def middle(characters: str, start: float = 1.0, count: float | None = None) -> str:
    """$MID($s,start,n): from the 1-based start; "" if it lies outside of the string."""
    first = int(start) - 1
    if first < 0:
        return ""
    return characters[first:] if count is None else characters[first : first + max(int(count), 0)]


def value_of(characters: str, code: float = 0.0) -> float:
    """VAL($s,code): the number at the start: 0 decimal, 1 binary, 2 hexadecimal; 0 if none."""
    rest, base = characters.lstrip(" "), int(code)
    prefix = rest[:2].upper()
    if prefix in {"^B", "^H"}:
        base, rest = (1 if prefix == "^B" else 2), rest[2:]
    if base in BASES:
        found = DIGITS[base].match(rest)
        return single(float(int(found[0], BASES[base]))) if found else 0.0
    if base != 0:
        raise AsError("P0116", f"VAL: the code is 0, 1 or 2, not {base}")
    found = DECIMAL.match(rest)
    return single(float(found[0])) if found else 0.0


def decode(characters: str, separator: str, mode: float) -> tuple[str, str]:
    """Return the result of $DECODE and the text left in the variable.

    Mode up to 0: the text before the separator (all text without one). Mode above 0: all
    consecutive separators at the start.
    """
    low, mark = characters.lower(), separator.lower()
    if mode > 0.0:
        end = 0
        while mark and low.startswith(mark, end):
            end += len(mark)
    else:
        found = low.find(mark) if mark else -1
        end = len(characters) if found < 0 else found
    return characters[:end], characters[end:]


def code_at(characters: str, place: float = 1.0) -> float:
    """ASC($s,n): the code of a character, -1 behind the end."""
    at = max(int(place), 1)
    return float(ord(characters[at - 1])) if at <= len(characters) else -1.0


def character(code: float) -> str:
    """$CHR(n)."""
    if not 0 <= int(code) <= 255:
        raise AsError("E0106", f"$CHR({int(code)}): codes are 0 to 255")
    return chr(int(code))


def instr(first: float | str, second: str, third: str | None = None) -> float:
    """INSTR(start,string,wanted) and INSTR(string,wanted).

    The 1-based position of the wanted string, 0 if not found; case-insensitive.
    """
    if isinstance(first, str) and third is None:
        start, characters, part = 1, first, second
    elif not isinstance(first, str) and third is not None:
        start, characters, part = max(int(first), 1), second, third
    else:
        raise AsError("P0116", "INSTR takes (start,string,wanted) or (string,wanted)")
    if start > len(characters):
        return 0.0
    if not part:
        return float(start)
    return float(characters.lower().find(part.lower(), start - 1) + 1)


def error_of(number: float) -> str:
    """$ERROR(n): code and text of an error number."""
    code = code_of(int(number))
    return f"({code}){error_text(code)}" if code else ""


TEXT_FUNCTIONS = {
    "LEN": AsFunction("s", lambda characters: float(len(characters))),
    "ASC": AsFunction("sr", code_at),
    "$CHR": AsFunction("r", character),
    "$SPACE": AsFunction("r", lambda count: text(" " * min(max(int(count), 0), 256))),
    "$LEFT": AsFunction("sr", lambda characters, count: characters[: max(int(count), 0)]),
    "$RIGHT": AsFunction("sr", right),
    "$MID": AsFunction("srr", middle),
    "INSTR": AsFunction("xss", instr),
    "VAL": AsFunction("sr", value_of),
    "$ERROR": AsFunction("r", error_of),
    "$ERRORS": AsFunction("s", lambda code: error_text(code.strip().upper())),
    "$DATE": AsFunction("mr", lambda machine, _=0.0: machine.date()),
    "$TIME": AsFunction("mr", lambda machine, _=0.0: machine.time()),
    "$TIME_MS": AsFunction("mr", lambda machine, _=0.0: machine.time_ms()),
    "$SYSDATA": AsFunction("mwr", lambda machine, word, _=1.0: machine.system_text(word.lower())),
}

FUNCTIONS: Mapping[str, AsFunction] = {
    **TEXT_FUNCTIONS,
    **NUMBER_FUNCTIONS,
    **POSE_FUNCTIONS,
}
