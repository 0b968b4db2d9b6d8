"""Numeric functions (facts 1.7)."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.fakes.as_language import AsLanguage

RULES = [
    ("ABS(-3)", 3.0), ("SQRT(2)", float(np.float32(math.sqrt(2.0)))),
    ("SIN(30)", 0.5), ("SIN(180)", 0.0), ("COS(90)", 0.0), ("COS(0)", 1.0), ("COS(-180)", -1.0),
    ("ATAN2(1,-1)", 135.0), ("PI", float(np.float32(math.pi))),
    ("MAXVAL(1,5,3)", 5.0), ("MINVAL(1,-5,3)", -5.0),
    ("INT(5.9)", 5.0), ("INT(-5.9)", -5.0), ("ROUND(2.5)", 3.0), ("ROUND(-2.5)", -3.0),
    ("ROUND(-0.2)", 0.0),
]  # fmt: skip


@pytest.mark.parametrize(("text", "expected"), RULES)
def test_each_function_gives_the_documented_value(text: str, expected: float) -> None:
    """Angles in degrees. Those that ask the machine are in the corpus."""
    assert AsLanguage()(text) == expected


@pytest.mark.parametrize("text", ["SQRT(-1)", "SIG(0)", "BITS(1,17)", "BITS32(1,33)"])
def test_arguments_out_of_range_are_e0106(text: str) -> None:
    """A program that asks the impossible stops."""
    assert AsLanguage().code(text) == "E0106"


@given(st.floats(-1e6, 1e6, width=32))
def test_round_and_int_agree_with_arithmetic(value: float) -> None:
    """ROUND is half away from zero, INT cuts off, both exact."""
    bench = AsLanguage()
    bench.memory.write("v", value)
    assert bench("INT(v)") == math.trunc(value)
    assert bench("ROUND(v)") == math.copysign(math.floor(abs(value) + 0.5), value)


@given(st.floats(-720, 720, width=32))
def test_sine_and_cosine_are_on_the_circle(degrees: float) -> None:
    """To single precision."""
    bench = AsLanguage()
    bench.memory.write("d", degrees)
    assert bench("SIN(d)^2+COS(d)^2") == pytest.approx(1.0, abs=3e-7)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("EXISTREAL(x)", -1.0), ("EXISTREAL(p)", 0.0), ("EXISTTRANS(x)", 0.0),
        ("EXISTREAL(a[1])", -1.0), ("EXISTREAL(a[2])", 0.0), ('EXISTREAL("a[1]")', -1.0),
        ("EXISTREAL($name)", -1.0), ("EXISTREAL(.l)", -1.0), ("EXISTREAL(l)", 0.0),
        ("MAXINDEX(m,1)", 4.0), ("MAXINDEX(m,2)", 7.0), ("MININDEX(m,2)", 5.0),
    ],
)  # fmt: skip
def test_existence_is_returned_without_an_error(text: str, expected: float) -> None:
    """By variable, by a string with its name, for elements, globals and locals."""
    bench = AsLanguage("x = 1", "POINT p = NULL", "a[1] = 0", '$name = "x"', ".l = 1",
                       "m[1,7] = 1", "m[4,5] = 1")  # fmt: skip
    assert bench(text) == expected
