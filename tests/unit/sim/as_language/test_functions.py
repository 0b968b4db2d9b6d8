"""Functions of AS: the value or the error code of each rule that the corpus does not show."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.as_language.values import Joints, Transformation, se3_of
from tests.unit.sim.as_language.conftest import AsLanguage

TEXT = st.text(st.characters(min_codepoint=32, max_codepoint=126, exclude_characters='"'),
               max_size=12)  # fmt: skip
DEFINED = ("x = 5", "x2[1] = 6", ".y = 7", "POINT p = TRANS(1,2,3)", "POINT #j = #PPOINT(1,2)",
           '$s = "main"', "@n = 8", "m[1,7] = 1", "m[4,5] = 1")  # fmt: skip
VALUES = [
    # numbers
    ("INT(5.9)", 5.0), ("INT(-5.9)", -5.0), ("ROUND(2.5)", 3.0), ("ROUND(-2.5)", -3.0),
    ("ROUND(-0.2)", 0.0), ("SIN(180)", 0.0), ("COS(90)", 0.0), ("COS(-180)", -1.0),
    ("ATAN2(1,-1)", 135.0), ("PI", float(np.float32(math.pi))), ("MINVAL(1,-5,3)", -5.0),
    # strings: at, beyond and before their ends
    ('$LEFT("abc",0)', ""), ('$LEFT("abc",-1)', ""), ('$MID("abc",,2)', "ab"),
    ('ASC("")', -1.0), ('ASC("abc",0)', 97.0), ('ASC("abc",3)', 99.0), ('ASC("abc",4)', -1.0),
    ("LEN($CHR(0)+$CHR(255))", 2.0), ('INSTR(0,"abc","c")', 3.0), ('INSTR(2,"abc","")', 2.0),
    ('VAL("")', 0.0), ('VAL("  42")', 42.0), ('VAL("x1")', 0.0), ('VAL("+7.5e2x")', 750.0),
    ('VAL("ff",2)', 255.0), ('VAL("^b102")', 2.0), ('VAL("^hxyz")', 0.0), ('VAL("1e")', 1.0),
    ('VAL("12 ab 3")', 12.0), ('VAL("-00123")', -123.0), ('VAL("00-123")', 0.0),
    ("$ERROR(0)", ""),
    # poses: omitted values are zero
    ("TRANS(1,,3)", Transformation(1.0, 0.0, 3.0)), ("TRANS()", Transformation()),
    ("#PPOINT(,2)", Joints((0.0, 2.0, 0, 0, 0, 0))), ("DZ(#HERE)", 3.0), ("DEXT(HERE,6)", 30.0),
    ("DEXT(#HERE,6)", 6.0), ("SHIFT(p BY ,,5)", Transformation(1.0, 2.0, 8.0)),
    # variables by name
    ("EXISTREAL(x)", -1.0), ("EXISTREAL(p)", 0.0), ("EXISTREAL(x2[2])", 0.0),
    ('EXISTREAL("x2[1]")', -1.0), ("EXISTREAL($s)", 0.0), ("EXISTREAL(.y)", -1.0),
    ("EXISTREAL(y)", 0.0), ("MAXINDEX(m,2)", 7.0), ("MININDEX(m,2)", 5.0),
]  # fmt: skip
CODES = [
    ("SQRT(-1)", "E0106"), ("SIG(0)", "E0106"), ("BITS(1,17)", "E0106"), ("BITS32(1,33)", "E0106"),
    ("ABS(1,2)", "P0101"), ("ABS()", "P0116"), ('ABS("a")', "P0116"), ("$CHR(256)", "E0106"),
    ("$CHR(-1)", "E0106"), ("$SPACE(256)", "E0110"), ('VAL("1",3)', "P0116"),
    ('VAL("1E39")', "E0106"), ('INSTR("a")', "P0116"), ('INSTR(1,"a")', "P0116"),
    ('INSTR("a","b","c")', "P0116"), ("$LEFT(,1)", "P0116"), ('$DECODE("a","b")', "P0116"),
    ("$DECODE(x,1)", "P0116"), ("DEXT(HERE,7)", "E0106"), ("SHIFT(#HERE BY 1)", "P0116"),
    ("TRANS(1,2,3,4,5,6,7)", "P0101"), ("FRAME(HERE,HERE,HERE)", "P0116"),
    ("FRAME(HERE,HERE,HERE,HERE)", "E0106"), ("$ENCODE(/K6,1)", "P0108"),
    ("$ENCODE(NULL)", "P0118"), ("$ENCODE($SPACE(200),$SPACE(56))", "E0110"),
    ('STRTOVAL("q")', "E0102"),
    ('STRTOPOS("q")', "E0103"), ('STRTOVAL("p")', "P0118"), ('STRTOVAL("x2[i]")', "P0119"),
    ("STRTOVAL(x)", "P0118"), ("STRTOPOS()", "P0116"), ('EXISTDATA("x",Q)', "P0116"),
    ('EXISTDATA("x",1)', "P0116"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "expected"), VALUES)
def test_each_function_gives_the_documented_value(text: str, expected: object) -> None:
    """Angles in degrees, lengths in millimetres."""
    assert AsLanguage(*DEFINED)(text) == expected


@pytest.mark.parametrize(("text", "code"), CODES)
def test_each_wrong_argument_has_its_code(text: str, code: str) -> None:
    """The code of the manual's appendix 4, not a Python exception."""
    assert AsLanguage(*DEFINED).code(text) == code


@given(TEXT, st.integers(-2, 14), st.integers(-2, 14))
def test_left_middle_and_right_put_a_string_together_again(s: str, i: int, j: int) -> None:
    """Cut anywhere, the parts are the string; MID is a slice."""
    bench = AsLanguage()
    bench.memory.write("$s", s)
    at = min(max(i, 0), len(s))
    assert bench(f"$LEFT($s,{at})+$MID($s,{at + 1})") == s
    assert bench(f"$RIGHT($s,{i})") == (s[-i:] if i > 0 else "")
    assert bench(f"$MID($s,{i},{j})") == (s[i - 1 : i - 1 + max(j, 0)] if i > 0 else "")


@pytest.mark.parametrize(("axis", "column"), [("RX", 0), ("RY", 1), ("RZ", 2)])
def test_rx_ry_and_rz_turn_about_their_axis(axis: str, column: int) -> None:
    """The axis stays where it is, 90 degrees move the next one onto the one after."""
    found = AsLanguage()(f"{axis}(90)")
    assert isinstance(found, Transformation)
    R = se3_of(found).rotation
    assert R[:, column] == pytest.approx(np.eye(3)[column], abs=1e-6)
    following = (column + 1) % 3
    assert R[:, following] == pytest.approx(np.eye(3)[(column + 2) % 3], abs=1e-6)


@given(st.integers(-99_999, 999_999))
def test_a_six_character_field_reads_back_as_the_number_that_was_written(number: int) -> None:
    """The packet's range (design section 3), written with /I6 and read with VAL."""
    bench = AsLanguage()
    bench.memory.write("n", float(number))
    bench.memory.write("$f", str(bench("$ENCODE(/I6,n)")))
    assert bench("LEN($f)") == 6
    assert bench("VAL($f)") == number
