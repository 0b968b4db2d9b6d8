"""Operators of AS: priorities, rounding, errors. The examples of the manual: tests/corpus/as."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.as_language.operators import BINARY
from sim.as_language.syntax import Binary, Unary
from sim.as_language.values import Transformation, se3_of
from tests.unit.sim.as_language.conftest import AsLanguage, expression

# Reference manual 3-21, 3-22; a larger number binds tighter.
PRIORITY = {
    "XOR": 1, "OR": 2, "AND": 3, "BXOR": 4, "BOR": 5, "BAND": 6, "<": 7, "<=": 7, "==": 7,
    "<>": 7, ">=": 7, ">": 7, "+": 8, "-": 8, "MOD": 9, "*": 10, "/": 10, "^": 12,
}  # fmt: skip
UNARY_PRIORITY = 11


@pytest.mark.parametrize("left", PRIORITY)
def test_of_two_operators_the_one_of_higher_priority_binds_tighter(left: str) -> None:
    """Equal ones from left to right; a sign binds tighter than all but the power."""
    assert PRIORITY.keys() == BINARY.keys()
    for right, priority in PRIORITY.items():
        first = PRIORITY[left] >= priority
        assert expression(f"a {left} b {right} c") == expression(
            f"(a {left} b) {right} c" if first else f"a {left} (b {right} c)"
        )
    for sign in ("-", "NOT", "COM"):
        found = expression(f"{sign} a {left} b")
        assert isinstance(found, Binary if PRIORITY[left] < UNARY_PRIORITY else Unary)


singles = st.floats(width=32, allow_nan=False, allow_infinity=False)
ARITHMETIC = {"+": np.add, "-": np.subtract, "*": np.multiply, "/": np.divide, "MOD": np.fmod}


@given(st.sampled_from(sorted(ARITHMETIC)), singles, singles)
def test_every_single_operation_is_rounded_to_the_last_bit(
    operator: str, left: float, right: float
) -> None:
    """The result is numpy's float32 result exactly, or E0106, or E0108."""
    emulator = AsLanguage()
    emulator.memory.write("l", left)
    emulator.memory.write("r", right)
    expected: object = "E0108"
    if right != 0.0 or operator not in {"/", "MOD"}:
        with np.errstate(all="ignore"):
            value = ARITHMETIC[operator](np.float32(left), np.float32(right))
        expected = float(value) if np.isfinite(value) else "E0106"
    assert emulator.outcome(f"l {operator} r") == expected


@given(st.text(st.characters(max_codepoint=255), max_size=6),
       st.text(st.characters(max_codepoint=255), max_size=6))  # fmt: skip
def test_strings_are_compared_by_character_code_and_shorter_is_smaller(a: str, b: str) -> None:
    """As bytes are, one character being one byte; tighter than everything but functions."""
    evaluate = AsLanguage()
    evaluate.memory.write("$a", a)
    evaluate.memory.write("$b", b)
    x, y = a.encode("latin-1"), b.encode("latin-1")
    assert evaluate("$a < $b") == (-1.0 if x < y else 0.0)
    assert evaluate("$a >= $b") == (-1.0 if x >= y else 0.0)
    assert evaluate("NOT $a == $b") == (0.0 if x == y else -1.0)
    assert evaluate("($a + $b) == $a") == (0.0 if y else -1.0)
    assert evaluate.code("$a + $b == $a") == "P0114"


lengths = st.floats(-900.0, 900.0, width=32)
degrees = st.floats(-180.0, 180.0, width=32)
tilts = st.floats(1.0, 179.0, width=32)  # away from the poles, where O and T are not unique
places = st.builds(Transformation, lengths, lengths, lengths, degrees, tilts, degrees)


@given(places, places)
def test_composition_is_that_of_matrices(a: Transformation, b: Transformation) -> None:
    """R = Rz(O) Ry(A) Rz(T), b in the frame a, lengths in mm; minus takes the inverse."""
    bench = AsLanguage()
    bench.memory.write("a", a)
    bench.memory.write("b", b)
    T_a, T_b = se3_of(a), se3_of(b)
    for text, expected in (("a+b", T_a * T_b), ("a-b", T_a * T_b.inverse()), ("-a", T_a.inverse())):
        found = bench(text)
        assert isinstance(found, Transformation)
        assert np.abs(se3_of(found).homogeneous - expected.homogeneous).max() < 3e-5


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("0^-1", "E0108"), ("(-2)^0.5", "E0106"), ("3E38*10", "E0106"), ("1E30 BAND 1", "E0106"),
        ('1+"a"', "P0114"), ('"a"*2', "P0114"), ('-"a"', "P0114"), ("NULL+1", "P0114"),
        ("#PPOINT(1)+NULL", "P0114"), ("#nothing", "E0103"), ("$nothing", "E0104"),
        (".nothing", "E0102"), ("nothing[3]", "E0102"), ("DX(nothing)", "E0103"),
        ("@big + @big", "E0106"), ("a[-1]", "P0119"), ("a[10000]", "P0119"), ("a", "P0133"),
        ("@big[1]", "P0132"),
    ],
)  # fmt: skip
def test_every_error_has_its_code(text: str, code: str) -> None:
    """The code of the manual's appendix 4, not a Python exception."""
    assert AsLanguage("@big = 2000000000", "a[9999] = 1").code(text) == code


@pytest.mark.parametrize(
    ("text", "expected"),
    [("^B101000 BOR ^B100001", 41.0), ("-2^2", -4.0), ("1 BAND 3 == 3", 1.0), ("COM 0", -1.0),
     ("^HFFFFFFFF BAND ^H1FFFFFFFF", "E0106"), ("5 XOR 0", -1.0),
     ("2^0.5*2^0.5", 1.9999998807907104)],
)  # fmt: skip
def test_operators_of_bits_logic_and_power_give_the_values_of_the_manual(
    text: str, expected: object
) -> None:
    """TRUE is -1; whole words of 32 bits."""
    assert AsLanguage().outcome(text) == expected
