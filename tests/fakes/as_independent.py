"""An evaluation of AS expressions that is independent of the emulator: numpy and one table."""

import math

import numpy as np

# Reference manual 3-21, 3-22; a larger number binds tighter.
PRIORITY = {
    "XOR": 1, "OR": 2, "AND": 3, "BXOR": 4, "BOR": 5, "BAND": 6,
    "<": 7, "<=": 7, "=<": 7, "==": 7, "<>": 7, "!=": 7, ">=": 7, "=>": 7, ">": 7,
    "+": 8, "-": 8, "MOD": 9, "*": 10, "/": 10, "^": 12,
}  # fmt: skip
UNARY_PRIORITY = 11
BITWISE = {"BXOR": np.bitwise_xor, "BOR": np.bitwise_or, "BAND": np.bitwise_and}
RELATIONS = {
    "<": np.less, "<=": np.less_equal, "=<": np.less_equal, "==": np.equal, "<>": np.not_equal,
    "!=": np.not_equal, ">=": np.greater_equal, "=>": np.greater_equal, ">": np.greater,
}  # fmt: skip

VARIABLES = {"a": 2.0, ".b": -3.5, "c[1]": 0.1, "@n": 7.0, "z": 0.0}


class Beyond(Exception):  # noqa: N818 (a result, not a failure)
    """The value exceeds the range of AS, with the error code."""


class Independent:
    """Precedence climbing over the tokens, independent of the emulator."""

    def __init__(self, words: list[str]) -> None:
        self.words = words
        self.at = 0

    def value(self, least: int = 0) -> np.float32:
        """Evaluate up to an operator that binds less than `least`."""
        left = self.operand()
        while self.at < len(self.words) and PRIORITY.get(self.words[self.at], -1) >= least:
            operator = self.words[self.at]
            self.at += 1
            left = apply(operator, left, self.value(PRIORITY[operator] + 1))
        return left

    def operand(self) -> np.float32:
        """Evaluate an operand with its signs."""
        word = self.words[self.at]
        self.at += 1
        if word == "(":
            inside = self.value()
            self.at += 1
            return inside
        if word in {"-", "NOT", "COM"}:
            operand = self.value(UNARY_PRIORITY)
            if word == "-":
                return np.float32(-operand)
            return truth(operand == 0) if word == "NOT" else np.float32(~bits(operand))
        return literal(word)


def literal(word: str) -> np.float32:
    """Return the value of a number or variable."""
    if word in VARIABLES:
        return np.float32(VARIABLES[word])
    if word[:2] in {"^B", "^H"}:
        return np.float32(int(word[2:], 2 if word[1] == "B" else 16))
    return np.float32(ord(word[1])) if word[0] == "'" else np.float32(float(word))


def truth(condition: bool) -> np.float32:
    """Return -1 for true, 0 for false."""
    return np.float32(-1.0 if condition else 0.0)


def bits(value: np.float32) -> np.int32:
    """Return the 32 bits of a value that has no more."""
    whole = math.trunc(float(value))
    if not -(2**31) <= whole <= 2**32:
        raise Beyond("E0106")
    return np.uint32(whole & 0xFFFFFFFF).astype(np.int32)


def apply(operator: str, left: np.float32, right: np.float32) -> np.float32:
    """Apply one operator in single precision."""
    if operator in RELATIONS:
        return truth(RELATIONS[operator](left, right))
    if operator in BITWISE:
        return np.float32(BITWISE[operator](bits(left), bits(right)))
    if operator in {"AND", "OR", "XOR"}:
        on = (left != 0, right != 0)
        return truth({"AND": all(on), "OR": any(on), "XOR": on[0] != on[1]}[operator])
    return finite(arithmetic(operator, left, right))


def arithmetic(operator: str, left: np.float32, right: np.float32) -> np.float32:
    """Compute + - * / MOD ^, or raise what AS refuses."""
    with np.errstate(all="ignore"):
        if operator in {"/", "MOD"} and right == 0:
            raise Beyond("E0108")
        if operator == "^":
            return powered(float(left), float(right))
        return {
            "+": np.add, "-": np.subtract, "*": np.multiply, "/": np.divide, "MOD": np.fmod,
        }[operator](left, right)  # fmt: skip


def powered(base: float, exponent: float) -> np.float32:
    """Return base to the exponent through double precision."""
    if base == 0 and exponent < 0:
        raise Beyond("E0108")
    if base < 0 and exponent != int(exponent):
        raise Beyond("E0106")
    try:
        return np.float32(math.pow(base, exponent))
    except OverflowError:
        raise Beyond("E0106") from None


def finite(value: np.float32) -> np.float32:
    """Refuse values outside single precision."""
    if not np.isfinite(value):
        raise Beyond("E0106")
    return value


def outcome(words: list[str]) -> float | str:
    """Return the value of the tokens, or the code of the error."""
    try:
        return float(Independent(words).value())
    except Beyond as error:
        return str(error)


def outcome_of(operator: str, left: float, right: float) -> float | str:
    """Return the result of one operator on two numbers, or the code of the error."""
    try:
        return float(apply(operator, np.float32(left), np.float32(right)))
    except Beyond as error:
        return str(error)
