"""How a function of AS is described: how many arguments, of which types, and what it computes.

Types are letters, one per argument: r number, s string, t transformation, j joint values, p either
of the two, w word, x number or string; in parentheses: may be left out.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from sim.controller.errors import AsError
from sim.controller.machine_api import Machine
from sim.controller.values import NUMBER, Joints, Transformation, Value

Argument = Value | None
Compute = Callable[[Machine, Sequence[Argument]], Value]

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
class Function:
    """One function: `types` per argument, the number that must be there, what it computes."""

    name: str
    types: str
    required: int
    most: int
    compute: Compute

    def check(self, arguments: Sequence[Argument]) -> None:
        """Refuse arguments of the wrong number (P0101, P0116) or type (P0116)."""
        self.check_count(len(arguments))
        for number, argument in enumerate(arguments):
            kinds, plain = TYPES[self.types[min(number, len(self.types) - 1)]]
            if argument is None:
                if number < self.required:
                    raise AsError("P0116", f"{self.name} needs argument {number + 1}, {plain}")
            elif not isinstance(argument, kinds):
                raise AsError("P0116", f"argument {number + 1} of {self.name} must be {plain}")

    def check_count(self, count: int) -> None:
        """Refuse a number of arguments that the function does not take."""
        if count > self.most:
            raise AsError("P0101", f"{self.name} takes {self.most} at most, not {count}")
        if count < self.required:
            raise AsError("P0116", f"{self.name} takes {self.required} at least, not {count}")


def function(name: str, types: str, compute: Compute, *, most: int | None = None) -> Function:
    """Describe a function by its types: "sr(r)" is a string, a number, and one more at will.

    `most` allows more arguments of the last type.
    """
    letters = types.replace("(", "").replace(")", "")
    required = types.index("(") if "(" in types else len(types)
    return Function(name, letters, required, len(letters) if most is None else most, compute)


def table(*functions: Function) -> dict[str, Function]:
    """Return functions by name."""
    return {item.name: item for item in functions}


def number(value: Argument, default: float = 0.0) -> float:
    """Return a number that `check` has let through, or what it is when left out."""
    return float(value) if isinstance(value, NUMBER) else default


def whole(value: Argument, default: int = 0) -> int:
    """Return a number cut to a whole one."""
    return int(value) if isinstance(value, NUMBER) else default


def string(value: Argument) -> str:
    """Return a string that `check` has let through; "" when left out."""
    return value if isinstance(value, str) else ""
