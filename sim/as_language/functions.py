"""Signatures of AS functions: number and types of arguments, and the computation.

Types are letters, one per argument: r number, s string, t transformation, j joint values, p either
of the two, w word, x number or string; in parentheses: optional.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from sim.as_language.errors import AsError
from sim.as_language.machine_api import MachineInterface
from sim.as_language.values import NUMBER, Joints, Transformation, Value

Argument = Value | None
Compute = Callable[[MachineInterface, Sequence[Argument]], Value]

TYPES: dict[str, tuple[tuple[type, ...], str]] = {
    "r": ((float, int), "a number"),
    "s": ((str,), "a string"),
    "t": ((Transformation,), "a transformation"),
    "j": ((Joints,), "joint values"),
    "p": ((Transformation, Joints), "a pose"),
    "w": ((str,), "a name"),
    "x": ((float, int, str), "a number or a string"),
}


@dataclass(frozen=True, slots=True)
class FunctionSignature:
    """One function: argument types, number of required arguments, computation."""

    name: str
    types: str
    required: int
    most: int
    compute: Compute

    def check(self, arguments: Sequence[Argument]) -> None:
        """Reject arguments of the wrong number (P0101, P0116) or type (P0116)."""
        self.check_count(len(arguments))
        for number, argument in enumerate(arguments):
            kinds, plain = TYPES[self.types[min(number, len(self.types) - 1)]]
            if argument is None:
                if number < self.required:
                    raise AsError("P0116", f"{self.name} needs argument {number + 1}, {plain}")
            elif not isinstance(argument, kinds):
                raise AsError("P0116", f"argument {number + 1} of {self.name} must be {plain}")

    def check_count(self, count: int) -> None:
        """Reject a wrong number of arguments."""
        if count > self.most:
            raise AsError("P0101", f"{self.name} takes at most {self.most}, found {count}")
        if count < self.required:
            raise AsError("P0116", f"{self.name} takes at least {self.required}, found {count}")


def function(
    name: str, types: str, compute: Compute, *, most: int | None = None
) -> FunctionSignature:
    """Return a function with a type signature: "sr(r)" is a string, a number, an optional number.

    `most` allows more arguments of the last type.
    """
    letters = types.replace("(", "").replace(")", "")
    required = types.index("(") if "(" in types else len(types)
    return FunctionSignature(
        name, letters, required, len(letters) if most is None else most, compute
    )


def table(*functions: FunctionSignature) -> dict[str, FunctionSignature]:
    """Return functions by name."""
    return {item.name: item for item in functions}


def number(value: Argument, default: float = 0.0) -> float:
    """Return a checked number, or its default if omitted."""
    return float(value) if isinstance(value, NUMBER) else default


def whole(value: Argument, default: int = 0) -> int:
    """Return a number truncated to an integer."""
    return int(value) if isinstance(value, NUMBER) else default


def string(value: Argument) -> str:
    """Return a checked string; "" if omitted."""
    return value if isinstance(value, str) else ""
