"""String functions of AS, one snippet per rule of the facts (1.6)."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.fakes.as_language import AsLanguage

TEXT = st.text(st.characters(min_codepoint=32, max_codepoint=126, exclude_characters='"'),
               max_size=12)  # fmt: skip

RULES = [
    ('$LEFT("abc",0)', ""),
    ('$LEFT("abc",-1)', ""),
    ('$LEFT("abc",2)', "ab"),
    ('$MID("abc",,2)', "ab"),
    ('ASC("")', -1.0),
    ('ASC("abc",0)', 97.0),
    ('ASC("abc",3)', 99.0),
    ('ASC("abc",4)', -1.0),
    ("ASC($CHR(0))", 0.0),
    ("LEN($CHR(0)+$CHR(255))", 2.0),
    ("$SPACE(3)", "   "),
    ('VAL("")', 0.0),
    ('VAL("  42")', 42.0),
    ('VAL("x1")', 0.0),
    ('VAL("+7.5e2x")', 750.0),
    ('VAL("ff",2)', 255.0),
    ('VAL("^b102")', 2.0),
    ('VAL("^hxyz")', 0.0),
    ('VAL("1e")', 1.0),
    ('INSTR(0,"abc","c")', 3.0),
    ('INSTR(-3,"abc","a")', 1.0),
    ('INSTR(2,"abc","")', 2.0),
    ("$ERROR(0)", ""),
    ('$ERRORS("E0102")', "Variable is not defined"),
]


@pytest.mark.parametrize(("text", "expected"), RULES)
def test_each_string_function_keeps_its_rule(text: str, expected: float | str) -> None:
    """At, beyond and before the ends of the string."""
    assert AsLanguage()(text) == expected


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("$CHR(256)", "E0106"),
        ("$CHR(-1)", "E0106"),
        ("$SPACE(256)", "E0110"),
        ('VAL("1",3)', "P0116"),
        ('INSTR("a")', "P0116"),
        ('INSTR(1,"a")', "P0116"),
        ('INSTR("a","b","c")', "P0116"),
        ('$LEFT("a")', "P0116"),
        ("$LEFT(,1)", "P0116"),
        ('$DECODE("a","b")', "P0116"),
        ("$DECODE(x,1)", "P0116"),
        ('VAL("1E39")', "E0106"),
    ],
)
def test_string_functions_refuse_invalid_arguments(text: str, code: str) -> None:
    """With the code of the manual."""
    assert AsLanguage().code(text) == code


@given(TEXT, st.integers(-2, 14), st.integers(-2, 14))
def test_left_middle_and_right_put_a_string_together_again(s: str, i: int, j: int) -> None:
    """Cut anywhere, the parts are the string; MID is a slice."""
    bench = AsLanguage()
    bench.memory.write("$s", s)
    at = min(max(i, 0), len(s))
    assert bench(f"$LEFT($s,{at})+$MID($s,{at + 1})") == s
    assert bench(f"$RIGHT($s,{i})") == (s[-i:] if i > 0 else "")
    assert bench(f"$MID($s,{i},{j})") == (s[i - 1 : i - 1 + max(j, 0)] if i > 0 else "")


@given(TEXT, TEXT.filter(bool), st.integers(1, 14))
def test_instr_finds_the_place_that_python_finds_without_regard_to_case(
    s: str, w: str, start: int
) -> None:
    """The place counts from 1, 0 is nowhere."""
    bench = AsLanguage()
    bench.memory.write("$s", s.upper())
    bench.memory.write("$w", w.lower())
    found = 0 if start > len(s) else s.lower().find(w.lower(), start - 1) + 1
    assert bench(f"INSTR({start},$s,$w)") == found


@given(st.lists(TEXT.map(lambda s: s.replace(",", "")), min_size=1, max_size=6))
def test_decode_loses_no_character(fields: list[str]) -> None:
    """The taken and the left part are the string; empty fields vanish with the separators."""
    bench = AsLanguage()
    line = ",".join(fields)
    bench.memory.write("$v", line)
    taken = []
    while bench("LEN($v)"):
        before = bench("$v")
        field = bench('$DECODE($v,",",0)')
        separator = bench('$DECODE($v,",",1)')
        assert f"{field}{separator}{bench('$v')}" == before
        taken.append(field)
    assert [field for field in taken if field] == [field for field in fields if field]


def test_decode_takes_only_separators_at_the_front_in_mode_1() -> None:
    """Without a match nothing changes. The separator ignores case."""
    bench = AsLanguage('$v = "ab;;c"', '$w = "XxxA"')
    assert bench('$DECODE($v,";",1)') == ""
    assert bench('$DECODE($v,";")') == "ab"
    assert bench('$DECODE($v,";",1)') == ";;"
    assert bench('$DECODE($w,"x",1)') == "Xxx"


def test_a_string_of_256_characters_stops_the_program() -> None:
    """E0110 at 256, none at 255."""
    bench = AsLanguage("$a = $SPACE(200)")
    assert len(str(bench("$a+$SPACE(55)"))) == 255
    assert bench.code("$a+$SPACE(56)") == "E0110"
    assert bench.code("$ENCODE($a,$a)") == "E0110"
