"""Expressions: the examples of the AS manual, and an independent evaluation in float32."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.as_language.values import Transformation
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
        ("0^-1", "E0108"),
        ("(-2)^0.5", "E0106"),
        ("3E38*10", "E0106"),
        ("1E30 BAND 1", "E0106"),
        ('1+"a"', "P0114"),
        ('"a"*2', "P0114"),
        ('-"a"', "P0114"),
        ("NULL+1", "P0114"),
        ("#PPOINT(1)+NULL", "P0114"),
        ("#nothing", "E0103"),
        ("$nothing", "E0104"),
        (".nothing", "E0102"),
        ("nothing[3]", "E0102"),
        ("DX(nothing)", "E0103"),
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


# --- the examples of the manual, facts 1.4 and 1.16 -----------------------------------------------

MANUAL = [
    ("INT(-5.462)", -5.0),
    ("ROUND(-5.662)", -6.0),
    ('VAL("123abc ")', 123.0),
    ('VAL("^HFF")', 255.0),
    ('VAL("12 ab 3")', 12.0),
    ('VAL("-00123")', -123.0),
    ('VAL("00-123")', 0.0),
    ('INSTR("abcdefgh","DE")', 4.0),
    ('INSTR(5,"1-2-3-4","-")', 6.0),
    ('$MID("abcdef",3,2)', "cd"),
    ('$RIGHT("abcdefgh",3)', "fgh"),
    ('$LEFT("*1*2",15)', "*1*2"),
    ("^B101000 BOR ^B100001", float(0b101001)),
    ("^B101000 OR ^B100001", -1.0),
    ("$ENCODE(/F5.2,12.66666)", "12.67"),
    ("$ENCODE(/F5.2,1000)", "*****"),
    ("377", 377.0),
    ("8.5E3", 8500.0),
    ("^B101", 5.0),
    ("^HC1", 193.0),
    ("'A", 65.0),
    ("TRUE", -1.0),
    ("ON", -1.0),
    ("FALSE", 0.0),
    ("OFF", 0.0),
    ("-2^2", -4.0),
    ("2+3 MOD 2", 3.0),
    ("NOT 0 AND 0", 0.0),
    ("1 BAND 3 == 3", 1.0),
    ("(1>2)", 0.0),
    ("(2>1)", -1.0),
]


@pytest.mark.parametrize(("text", "expected"), MANUAL)
def test_the_examples_of_the_manual_come_out(text: str, expected: float | str) -> None:
    """The emulator computes the values that the manual prints."""
    assert AsLanguage()(text) == expected


def test_transformations_compose_as_in_chapter_8() -> None:
    """a1+a2 and a2+a1 differ, with the manual's numbers."""
    bench = AsLanguage("POINT a1 = TRANS(1000,0,0,0,0,0)", "POINT a2 = TRANS(0,1000,0,60,0,0)")
    first, second = bench("a1+a2"), bench("a2+a1")
    assert isinstance(first, Transformation)
    assert isinstance(second, Transformation)
    assert first.numbers()[:3] == (1000.0, 1000.0, 0.0)
    assert second.x == pytest.approx(500.0, abs=1e-3)
    assert second.y == pytest.approx(1866.025, abs=1e-3)
    assert first.o + first.t == pytest.approx(60.0, abs=1e-4)
    assert second.o + second.t == pytest.approx(60.0, abs=1e-4)
