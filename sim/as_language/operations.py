"""Operator closures, with a fast path for single-precision reals."""

import operator
from collections.abc import Callable

from sim.as_language.machine_api import EvaluationContext
from sim.as_language.operators import BINARY, UNARY
from sim.as_language.values import Value, single, text
from sim.as_language.variables import Read

FAST_ARITHMETIC: dict[str, Callable[[float, float], float]] = {
    "+": operator.add, "-": operator.sub, "*": operator.mul,
}  # fmt: skip
FAST_RELATIONS: dict[str, Callable[[float, float], bool]] = {
    "<": operator.lt, "<=": operator.le, "==": operator.eq, "<>": operator.ne,
    ">=": operator.ge, ">": operator.gt,
}  # fmt: skip
FAST_LOGIC: dict[str, Callable[[bool, bool], bool]] = {
    "AND": operator.and_, "OR": operator.or_,
}  # fmt: skip


def compile_unary(sign: str, operand: Read) -> Read:
    """Compile a unary operator."""
    apply = UNARY[sign]
    return lambda context: apply(operand(context))


def compile_binary(sign: str, left: Read, right: Read) -> Read:
    """Compile a binary operator; both operands are always evaluated, left first."""
    apply = BINARY[sign]
    if sign == "+":
        return _plus(apply, left, right)
    if sign in FAST_ARITHMETIC:
        return _arithmetic(FAST_ARITHMETIC[sign], apply, left, right)
    if sign in FAST_RELATIONS:
        return _relation(FAST_RELATIONS[sign], apply, left, right)
    if sign in FAST_LOGIC:
        return _logic(FAST_LOGIC[sign], apply, left, right)
    return lambda context: apply(left(context), right(context))


def compile_with_constant(sign: str, left: Read, constant: float) -> Read:
    """Compile a binary operator with a numeric literal on the right."""
    apply = BINARY[sign]
    if sign in FAST_ARITHMETIC:
        return _constant_arithmetic(FAST_ARITHMETIC[sign], apply, left, constant)
    if sign in FAST_RELATIONS:
        return _constant_relation(FAST_RELATIONS[sign], apply, left, constant)
    return compile_binary(sign, left, lambda _: constant)


def _plus(slow: Callable[[Value, Value], Value], left: Read, right: Read) -> Read:
    def run(context: EvaluationContext) -> Value:
        a, b = left(context), right(context)
        if a.__class__ is float and b.__class__ is float:
            return single(a + b)
        if a.__class__ is str and b.__class__ is str:
            return text(a + b)
        return slow(a, b)

    return run


def _arithmetic(
    fast: Callable[[float, float], float], slow: Callable[[Value, Value], Value],
    left: Read, right: Read,
) -> Read:  # fmt: skip
    def run(context: EvaluationContext) -> Value:
        a, b = left(context), right(context)
        if a.__class__ is float and b.__class__ is float:
            return single(fast(a, b))
        return slow(a, b)

    return run


def _relation(
    fast: Callable[[float, float], bool], slow: Callable[[Value, Value], Value],
    left: Read, right: Read,
) -> Read:  # fmt: skip
    def run(context: EvaluationContext) -> Value:
        a, b = left(context), right(context)
        if a.__class__ is float and b.__class__ is float:
            return -1.0 if fast(a, b) else 0.0
        return slow(a, b)

    return run


def _constant_arithmetic(
    fast: Callable[[float, float], float], slow: Callable[[Value, Value], Value],
    left: Read, constant: float,
) -> Read:  # fmt: skip
    def run(context: EvaluationContext) -> Value:
        value = left(context)
        if value.__class__ is float:
            return single(fast(value, constant))
        return slow(value, constant)

    return run


def _constant_relation(
    fast: Callable[[float, float], bool], slow: Callable[[Value, Value], Value],
    left: Read, constant: float,
) -> Read:  # fmt: skip
    def run(context: EvaluationContext) -> Value:
        value = left(context)
        if value.__class__ is float:
            return -1.0 if fast(value, constant) else 0.0
        return slow(value, constant)

    return run


def _logic(
    fast: Callable[[bool, bool], bool], slow: Callable[[Value, Value], Value],
    left: Read, right: Read,
) -> Read:  # fmt: skip
    def run(context: EvaluationContext) -> Value:
        a, b = left(context), right(context)
        if a.__class__ is float and b.__class__ is float:
            return -1.0 if fast(a != 0.0, b != 0.0) else 0.0
        return slow(a, b)

    return run
