"""Expressions against an independent evaluation: numpy's float32 and the manual's table."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.fakes.as_independent import PRIORITY, VARIABLES, outcome, outcome_of
from tests.fakes.as_language import AsLanguage

numbers = st.one_of(
    st.integers(0, 99).map(str),
    st.sampled_from(["0.1", "1.5", "3.3E3", "7E-3", "^B1011", "^HFF", "'A", "16777215", "1E20"]),
    st.sampled_from(sorted(VARIABLES)),
)


def tokens(depth: int) -> st.SearchStrategy[list[str]]:
    """An expression as a list of words: operands, operators, signs, parentheses."""
    operand = numbers.map(lambda word: [word])
    if depth > 0:
        inside = tokens(depth - 1).map(lambda words: ["(", *words, ")"])
        operand = st.one_of(operand, inside)
    signs = st.lists(st.sampled_from(["-", "NOT", "COM"]), max_size=2)
    signed = st.tuples(signs, operand).map(lambda pair: [*pair[0], *pair[1]])
    rest = st.lists(st.tuples(st.sampled_from(sorted(PRIORITY)), st.tuples(signs, operand)),
                    max_size=4)  # fmt: skip
    return st.tuples(signed, rest).map(_joined)


def _joined(parts: tuple[list[str], list[tuple[str, tuple[list[str], list[str]]]]]) -> list[str]:
    words = list(parts[0])
    for operator, (signs, operand) in parts[1]:
        # Behind ^ a sign has no place in the table; parentheses give the meaning.
        if operator == "^" and signs:
            words += ["^", "(", *signs, *operand, ")"]
        else:
            words += [operator, *signs, *operand]
    return words


def bench() -> AsLanguage:
    """A memory with the variables."""
    return AsLanguage(*(f"{name} = {value}" for name, value in VARIABLES.items() if name != "@n"),
                      "@n = 7")  # fmt: skip


@settings(max_examples=300)
@given(tokens(2))
def test_random_expressions_agree_with_an_independent_evaluation(words: list[str]) -> None:
    """Same value to the last bit, or the same error."""
    text = " ".join(words)
    expected, found = outcome(words), bench().outcome(text)
    if isinstance(expected, str):
        assert found == expected, text
    else:  # integers of @n stay exact where a real is rounded
        assert found == pytest.approx(expected, rel=2e-7, abs=0.0), text


singles = st.floats(width=32, allow_nan=False, allow_infinity=False)


@given(st.sampled_from(["+", "-", "*", "/"]), singles, singles)
def test_every_single_operation_is_rounded_to_the_last_bit(
    operator: str, left: float, right: float
) -> None:
    """The result is numpy's float32 result exactly, or E0106, or E0108."""
    emulator = AsLanguage()
    emulator.memory.write("l", left)
    emulator.memory.write("r", right)
    assert emulator.outcome(f"l{operator}r") == outcome_of(operator, left, right)


def test_the_operators_of_one_level_group_from_left_to_right() -> None:
    """Also ^, unlike mathematics."""
    evaluate = AsLanguage()
    assert evaluate("2^3^2") == 64.0
    assert evaluate("100/10/2") == 5.0
    assert evaluate("10-5-2") == 3.0
    assert evaluate("1 < 2 < 0") == -1.0


def test_the_remainder_has_the_sign_of_the_dividend() -> None:
    """-7 MOD 3 is -1: the sign before the number binds tighter."""
    evaluate = AsLanguage()
    assert evaluate("-7 MOD 3") == -1.0
    assert evaluate("7 MOD -3") == 1.0
    assert evaluate("5.5 MOD 2") == 1.5


def test_a_comparison_of_strings_binds_tighter_than_everything_but_functions() -> None:
    """NOT $a == $b needs no parentheses; $a + $b == $c does."""
    evaluate = AsLanguage('$a = "x"', '$b = "y"', '$c = "xy"')
    assert evaluate("NOT $a == $b") == -1.0
    assert evaluate.code("$a + $b == $c") == "P0114"
    assert evaluate("($a + $b) == $c") == -1.0
    assert evaluate("$LEFT($a,1) == ($a)") == -1.0


@given(st.text(st.characters(max_codepoint=255), max_size=6),
       st.text(st.characters(max_codepoint=255), max_size=6))  # fmt: skip
def test_strings_are_compared_by_character_code_and_shorter_is_smaller(a: str, b: str) -> None:
    """As bytes are, one character being one byte."""
    evaluate = AsLanguage()
    evaluate.memory.write("$a", a)
    evaluate.memory.write("$b", b)
    x, y = a.encode("latin-1"), b.encode("latin-1")
    assert evaluate("$a < $b") == (-1.0 if x < y else 0.0)
    assert evaluate("$a == $b") == (-1.0 if x == y else 0.0)
    assert evaluate("$a >= $b") == (-1.0 if x >= y else 0.0)
    assert evaluate("$a + $b") == a + b


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("1/0", "E0108"),
        ("1 MOD 0", "E0108"),
        ("0^-1", "E0108"),
        ("(-2)^0.5", "E0106"),
        ("3E38*10", "E0106"),
        ("1E30 BAND 1", "E0106"),
        ("$SPACE(200)+$SPACE(100)", "E0110"),
        ('1+"a"', "P0114"),
        ('"a"*2', "P0114"),
        ('-"a"', "P0114"),
        ("NULL+1", "P0114"),
        ("#PPOINT(1)+NULL", "P0114"),
        ("nothing", "E0102"),
        ("#nothing", "E0103"),
        ("$nothing", "E0104"),
        (".nothing", "E0102"),
        ("nothing[3]", "E0102"),
        ("DX(nothing)", "E0103"),
        ("nofunction(1)", "P0115"),
        ("ABS(1,2)", "P0101"),
        ("ABS()", "P0116"),
        ('ABS("a")', "P0116"),
        ("LEN(1)", "P0116"),
        ("@big + @big", "E0106"),
    ],
)
def test_every_error_has_its_code(text: str, code: str) -> None:
    """The code of the manual's appendix 4, not a Python exception."""
    assert AsLanguage("@big = 2000000000").code(text) == code


def test_an_error_has_its_code_and_the_mistake() -> None:
    """One sentence for the person who reads it, one number for the ERROR function."""
    with pytest.raises(Exception, match=r"\(E0102\) Variable is not defined: speed_x") as caught:
        AsLanguage()("speed_x")
    assert caught.value.number == -30102  # type: ignore[attr-defined]
