"""Instructions as functions: arguments of AS are read, then passed to a function of the task.

The parameters of the function after its task are the arguments of the instruction; their defaults
apply to omitted ones. `types` has one letter for each:

    r  a number                     R  a reader of a number, for a condition
    n  a number, None if omitted    P  a reader of a transformation, read when it is needed
    p  a location                   v  a writer of a variable
    i  a writer of an integer @n    a  a writer of consecutive elements
    w  a name of a program, label   e  a reader of consecutive elements
    m  the words after an argument  k  kind and writer of a variable
    t  a string                     s  an expression of signals, as in SOUT
    y  any value, None if omitted
                                    *  any number of arguments of the last type
"""

import inspect
from collections.abc import Callable
from typing import Any, Literal, NamedTuple

from sim.as_language import expressions
from sim.as_language.errors import AsError
from sim.as_language.operators import LOGIC, RELATIONS
from sim.as_language.syntax import (
    Binary,
    Expression,
    FunctionCall,
    Instruction,
    Unary,
    Variable,
    Word,
)
from sim.controller.tasks import Op, Task, Wait

Act = Callable[..., Wait | None]
"""Executes an instruction; returns the condition for which the task waits before the next step."""
Read = Callable[[Task], Any]


class Action(NamedTuple):
    """Function of an instruction, the types of its arguments, and the tasks that may execute it."""

    act: Act
    types: str = ""
    only: Literal["robot", "pc", ""] = ""
    with_signals: bool = False  # a signal or TWAIT: PREFETCH.SIGINS decides when it is executed


def compile_instruction(action: Action, statement: Instruction, at: int) -> Op:
    """Return the operation of an instruction.

    Raises AsError P0100, P0118 for its arguments, P0104 for a robot other than the first.
    """
    act, only = action.act, action.only
    _refuse_other_robot(statement)
    readers = _readers(action, statement)

    def run(task: Task) -> int:
        if only:
            refuse_elsewhere(task, only)
        wait = act(task, *[read(task) for read in readers])
        if wait is not None:
            task.wait(wait)
        return at + 1

    return _after_motion(run, at) if action.with_signals else run


def _after_motion(op: Op, at: int) -> Op:
    """Return an operation that PREFETCH.SIGINS OFF delays until the robot program's axes coincide.

    Its step is then executed again. A PC program has no motion to wait for.
    """

    def run(task: Task) -> int:
        hardware = task.hardware
        robot = hardware.robot
        if not task.is_robot or hardware.switches["prefetch.sigins"] or robot.axes_coincide:
            return op(task)
        task.wait(lambda _: robot.axes_coincide)
        return at

    return run


def refuse_elsewhere(task: Task, only: str) -> None:
    """Raise AsError E1095 or P0111 in a task that may not execute an instruction."""
    if only == "pc":
        if task.is_robot:
            raise AsError("P0111", "MC is only allowed in PC programs")
    elif not task.is_robot:
        raise AsError("E1095")
    elif any(frame.handles is not None for frame in task.frames):
        raise AsError("P0111", "no motion in a program that ONE calls")


def _refuse_other_robot(statement: Instruction) -> None:
    robots = [word for word in statement.modifiers if word.endswith(":")]
    if robots and robots != ["1:"]:
        raise AsError("P0104", f"{statement.name} {robots[0]} the emulated controller has robot 1")


def until(wait: Wait, now_ns: int = 0) -> Wait | None:
    """Return a condition to wait for; a condition already true costs no wait."""
    return None if wait(now_ns) else wait


def at_rest(task: Task, action: Callable[[Task], None] = lambda _: None) -> Wait | None:
    """Act as soon as the arm is at rest and no motion is active."""
    robot = task.hardware.robot

    def acts(_: int) -> bool:
        if robot.moving:
            return False
        action(task)
        return True

    return until(acts)


def _readers(action: Action, statement: Instruction) -> list[Read]:
    letters, rest = action.types.removesuffix("*"), len(statement.arguments)
    if letters != action.types:
        fixed = len(letters) - 1  # those before the one of any number
        letters += letters[-1] * (rest - len(letters.replace("m", "")))
        letters = letters[: max(fixed, rest + letters.count("m"))]
    defaults = [p.default for p in inspect.signature(action.act).parameters.values()][1:]
    readers: list[Read] = []
    index = 0
    for number, letter in enumerate(letters):
        if letter == "m":
            readers.append(_always(statement.modifiers))
            continue
        given = statement.arguments[index] if index < len(statement.arguments) else None
        default = defaults[number] if number < len(defaults) else inspect.Parameter.empty
        index += 1
        if given is None and (letter in "ny" or default is not inspect.Parameter.empty):
            readers.append(_always(None if letter in "ny" else default))
        else:
            readers.append(_reader(letter, given, statement.name, index))
    return readers


def _reader(letter: str, given: Expression | None, name: str, number: int) -> Read:
    """Return the reader of an argument of an instruction; `number` counts from 1."""
    if letter == "w":
        if not isinstance(given, Word):
            raise AsError("P0100", f"{name} needs the name of a program")
        return _always(given.name)
    if letter in "viaek":
        if not isinstance(given, Variable) or (letter == "i" and given.kind != "@"):
            what = "an integer variable, such as @t" if letter == "i" else "a variable"
            raise AsError("P0118", f"argument {number} of {name} must be {what}")
        make: dict[str, Callable[[Variable], Any]] = {
            "v": expressions.store, "i": expressions.store, "a": expressions.store_row,
            "e": expressions.read_row,
            "k": lambda variable: (variable.kind, expressions.store(variable)),
        }  # fmt: skip
        return _always(make[letter](given))
    if given is None:
        missing = (
            "a motion needs a location" if letter == "p" else f"{name} needs argument {number}"
        )
        raise AsError("P0100", missing)
    if letter == "p":
        return expressions.pose_of(given)
    if letter == "P":
        return _always(expressions.place_of(given))
    if letter == "y":
        return expressions.value_of(given)
    if letter == "t":
        return expressions.text_of(given)
    read = expressions.number_of(_of_signals(given) if letter == "s" else given)
    return _always(read) if letter == "R" else read


def _of_signals(given: Expression) -> Expression:
    """Return an expression with SIG(n) for each number of a signal: `1001 AND NOT 1002`."""
    match given:
        case Unary("NOT", operand):
            return Unary("NOT", _of_signals(operand))
        case Binary(operator, left, right) if operator in LOGIC:
            return Binary(operator, _of_signals(left), _of_signals(right))
        case Binary(operator) if operator in RELATIONS:
            return given
        case FunctionCall("SIG" | "SWITCH"):
            return given
        case _:
            return FunctionCall("SIG", (given,))


def _always(value: Any) -> Read:
    return lambda _: value
