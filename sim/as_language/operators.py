"""Operators of AS on values (reference manual 3-21, 3-22, 3.9, chapter 8)."""

import math
import operator
from collections.abc import Callable
from typing import Any

from sim.as_language.errors import AsError
from sim.as_language.memory import plain
from sim.as_language.values import (
    FALSE,
    NUMBER,
    TRUE,
    Transformation,
    Value,
    compose,
    inverse,
    single,
    text,
    truth,
)

WORD = 0xFFFFFFFF
SIGN = 0x80000000
COMPARABLE = frozenset({float, int, str})
LEAST_INTEGER, LARGEST_INTEGER = -(2**31), 2**31 - 1

BinaryOperation = Callable[[Value, Value], Value]


def add(left: Value, right: Value) -> Value:
    """Add numbers, concatenate strings, compose transformations."""
    if left.__class__ is float and right.__class__ is float:
        return single(left + right)
    if isinstance(left, NUMBER) and isinstance(right, NUMBER):
        return _result(left + right)
    if isinstance(left, str) and isinstance(right, str):
        return text(left + right)
    if isinstance(left, Transformation) and isinstance(right, Transformation):
        return compose(left, right)
    raise _clash("+", left, right)


def subtract(left: Value, right: Value) -> Value:
    """Subtract numbers; compose a transformation with the inverse of another."""
    if left.__class__ is float and right.__class__ is float:
        return single(left - right)
    if isinstance(left, NUMBER) and isinstance(right, NUMBER):
        return _result(left - right)
    if isinstance(left, Transformation) and isinstance(right, Transformation):
        return compose(left, inverse(right))
    raise _clash("-", left, right)


def multiply(left: Value, right: Value) -> Value:
    """Multiply numbers."""
    if left.__class__ is float and right.__class__ is float:
        return single(left * right)
    a, b = _numbers("*", left, right)
    return _result(a * b)


def divide(left: Value, right: Value) -> Value:
    """Divide numbers (E0108)."""
    a, b = _numbers("/", left, right)
    if b == 0:
        raise AsError("E0108", f"{a:g} / 0")
    return single(a / b)


def modulo(left: Value, right: Value) -> Value:
    """Return the remainder, with the sign of the dividend (E0108)."""
    a, b = _numbers("MOD", left, right)
    if b == 0:
        raise AsError("E0108", f"{a:g} MOD 0")
    if isinstance(a, int) and isinstance(b, int):
        return int(math.fmod(a, b))
    return single(math.fmod(a, b)) + 0.0


def power(left: Value, right: Value) -> Value:
    """Raise to a power; a negative base takes integer exponents only (E0106)."""
    a, b = _numbers("^", left, right)
    if a == 0 and b < 0:
        raise AsError("E0108", f"0 ^ {b:g}")
    if a < 0 and b != int(b):
        raise AsError("E0106", f"{a:g} ^ {b:g}: a negative base needs an integer exponent")
    try:
        return single(math.pow(a, b))
    except OverflowError:
        raise AsError("E0106", f"{a:g} ^ {b:g} is beyond the largest real, 3.4E38") from None


def negate(value: Value) -> Value:
    """Return -value; of a transformation, the inverse."""
    if isinstance(value, float):
        return 0.0 - value
    if isinstance(value, int):
        return _result(-value)
    if isinstance(value, Transformation):
        return inverse(value)
    raise AsError("P0114", f"- cannot be applied to {plain(value)}")


def _relation(sign: str, compare: Callable[[Any, Any], bool]) -> BinaryOperation:
    def relate(left: Value, right: Value) -> Value:
        kind = left.__class__
        if (kind is right.__class__ and kind in COMPARABLE) or (
            isinstance(left, NUMBER) and isinstance(right, NUMBER)
        ):
            return TRUE if compare(left, right) else FALSE
        raise _clash(sign, left, right)

    return relate


def _logical(sign: str, join: Callable[[bool, bool], bool]) -> BinaryOperation:
    def operate(left: Value, right: Value) -> Value:
        return truth(join(_number(sign, left) != 0, _number(sign, right) != 0))

    return operate


def _bitwise(sign: str, join: Callable[[int, int], int]) -> BinaryOperation:
    def operate(left: Value, right: Value) -> Value:
        return _word(join(_bits(sign, left), _bits(sign, right)), left, right)

    return operate


_RELATIONS = {
    "<": operator.lt, "<=": operator.le, "==": operator.eq, "<>": operator.ne,
    ">=": operator.ge, ">": operator.gt,
}  # fmt: skip
RELATIONS: dict[str, BinaryOperation] = {
    sign: _relation(sign, compare) for sign, compare in _RELATIONS.items()
}
LOGIC: dict[str, BinaryOperation] = {
    "AND": _logical("AND", operator.and_), "OR": _logical("OR", operator.or_),
    "XOR": _logical("XOR", operator.xor),
}  # fmt: skip
BINARY: dict[str, BinaryOperation] = {
    "^": power, "*": multiply, "/": divide, "MOD": modulo, "+": add, "-": subtract,
    "BAND": _bitwise("BAND", operator.and_), "BOR": _bitwise("BOR", operator.or_),
    "BXOR": _bitwise("BXOR", operator.xor), **RELATIONS, **LOGIC,
}  # fmt: skip
UNARY: dict[str, Callable[[Value], Value]] = {
    "-": negate,
    "NOT": lambda value: truth(_number("NOT", value) == 0),
    "COM": lambda value: _word(~_bits("COM", value), value),
}


def _result(number: float) -> float:
    """Round to single precision; integer results must be within 32 bits (E0106)."""
    if not isinstance(number, int):
        return single(number)
    if not LEAST_INTEGER <= number <= LARGEST_INTEGER:
        raise AsError("E0106", f"{number} is not a 32-bit integer")
    return number


def _number(sign: str, value: Value) -> float:
    if isinstance(value, NUMBER):
        return value
    raise AsError("P0114", f"{sign} takes numbers, not {plain(value)}")


def _numbers(sign: str, left: Value, right: Value) -> tuple[float, float]:
    return _number(sign, left), _number(sign, right)


def _bits(sign: str, value: Value) -> int:
    whole = int(_number(sign, value))
    if not LEAST_INTEGER <= whole <= WORD + 1:
        raise AsError("E0106", f"{sign}: {whole} has more than 32 bits")
    return whole & WORD


def _word(bits: int, *operands: Value) -> float:
    signed = ((bits & WORD) ^ SIGN) - SIGN
    return signed if any(isinstance(item, int) for item in operands) else single(float(signed))


def _clash(sign: str, left: Value, right: Value) -> AsError:
    hint = ""
    if isinstance(left, str) != isinstance(right, str):
        hint = "; a comparison of strings binds tighter than +, use parentheses"
    return AsError("P0114", f"{plain(left)} {sign} {plain(right)}{hint}")
