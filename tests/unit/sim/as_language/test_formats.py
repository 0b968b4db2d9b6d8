"""$ENCODE, which shares its formats with PRINT and TYPE (facts 1.6)."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.fakes.as_language import AsLanguage

RULES = [
    ("$ENCODE(5)", " 5"),
    ("$ENCODE(-5)", " -5"),
    ("$ENCODE(1,2.5)", " 1 2.5"),
    ("$ENCODE(0.1)", " 0.1"),
    ("$ENCODE(1/3)", " 0.33333334"),
    ("$ENCODE(1E20)", " 1E+20"),
    ('$ENCODE("a",1,"b")', "a 1b"),
    ("$ENCODE(/D,7)", " 7"),
    ("$ENCODE(/F8.3,1.5)", "   1.500"),
    ("$ENCODE(/F8.3,-1.5,2)", "  -1.500   2.000"),
    ("$ENCODE(/F8.3,1,/D,2)", "   1.000 2"),
    ("$ENCODE(/E10.2,1234)", "  1.23E+03"),
    ("$ENCODE(/G10.4,12.5)", "     12.50"),
    ("$ENCODE(/I6,42)", "    42"),
    ("$ENCODE(/I6,-42)", "   -42"),
    ("$ENCODE(/I3,1234)", "***"),
    ("$ENCODE(/I3,-999)", "***"),
    ("$ENCODE(/I2,1.5,-1.5)", " 2-2"),
    ("$ENCODE(/H4,255)", "  FF"),
    ("$ENCODE(/H8,-1)", "FFFFFFFF"),
    ("$ENCODE(1,/X3,2)", " 1    2"),
    ('$ENCODE("a",/C2,"b")', "a\n\nb"),
    ('$ENCODE(/S,"a")', "a"),
    ("$ENCODE()", ""),
]


@pytest.mark.parametrize(("text", "expected"), RULES)
def test_each_format_writes_as_documented(text: str, expected: str) -> None:
    """A format holds for the items behind it; too wide a value is asterisks."""
    assert AsLanguage()(text) == expected


@pytest.mark.parametrize(
    ("text", "code"),
    [("$ENCODE(/K6,1)", "P0108"), ("$ENCODE(/L,1)", "P0108"), ("$ENCODE(/J4,1)", "P0108"),
     ("$ENCODE(/Q3,1)", "P0108"), ("$ENCODE(NULL)", "P0118")],
)  # fmt: skip
def test_what_cannot_be_written_is_refused(text: str, code: str) -> None:
    """The formats of an option of the controller, an unknown one, and a pose."""
    assert AsLanguage().code(text) == code


@given(st.integers(-99_999, 999_999))
def test_a_six_character_field_reads_back_as_the_number_that_was_written(number: int) -> None:
    """The packet's range (design section 3), written with /I6 and read with VAL."""
    bench = AsLanguage()
    bench.memory.write("n", float(number))
    field = str(bench("$ENCODE(/I6,n)"))
    assert len(field) == 6
    bench.memory.write("$f", field)
    assert bench("VAL($f)") == number


@given(st.floats(width=32, allow_nan=False, allow_infinity=False))
def test_the_default_format_keeps_eight_digits(number: float) -> None:
    """VAL reads the text of $ENCODE back to the last bit but one."""
    bench = AsLanguage()
    bench.memory.write("n", number)
    bench.memory.write("$t", str(bench("$ENCODE(n)")))
    outcome = bench.outcome("VAL($t)")
    assert outcome == pytest.approx(number, rel=1e-7, abs=1e-45) or outcome == "E0106"
