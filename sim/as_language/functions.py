"""Functions of AS: types of the arguments, and the computation.

The parameters of the Python function are the arguments of the AS function; their defaults apply to
omitted ones. Types are letters, one per argument: r number, s string, t transformation, j joint
values, p either of the two, w word, x number or string; r* any number of numbers. A leading m: the
machine is passed first.
"""

import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from sim.as_language.errors import AsError
from sim.as_language.machine_api import EvaluationContext
from sim.as_language.values import Joints, Transformation, Value
from sim.as_language.variables import Read

Argument = Value | None
ReadArgument = Callable[[EvaluationContext], Argument]

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


@dataclass(frozen=True, slots=True)
class FunctionSignature:
    """One function: argument types, defaults of the optional ones, computation."""

    compute: Callable[..., Value]
    types: str
    of_machine: bool
    required: int
    most: int
    defaults: tuple[Any, ...]

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

    def call(self, name: str, readers: Sequence[ReadArgument]) -> Read:
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


def function(types: str, compute: Callable[..., Value], most: int = MOST) -> FunctionSignature:
    """Return a function; `most` limits the arguments of one that takes any number of them."""
    of_machine = types.startswith("m")
    parameters = list(inspect.signature(compute).parameters.values())[of_machine:]
    defaults = tuple(p.default for p in parameters if p.kind is not p.VAR_POSITIONAL)
    required = sum(default is inspect.Parameter.empty for default in defaults)
    letters = types.removeprefix("m").removesuffix("*")
    count = most if types.endswith("*") else len(letters)
    return FunctionSignature(compute, letters, of_machine, required, count, defaults)
