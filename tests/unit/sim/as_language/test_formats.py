"""$ENCODE, which shares its formats with PRINT and TYPE (facts 1.6)."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.unit.sim.as_language.conftest import AsLanguage


@pytest.mark.parametrize(
    ("text", "code"),
    [("$ENCODE(/K6,1)", "P0108"), ("$ENCODE(/Q3,1)", "P0108"), ("$ENCODE(NULL)", "P0118"),
     ("$ENCODE($SPACE(200),$SPACE(56))", "E0110")],
)  # fmt: skip
def test_what_cannot_be_written_is_refused(text: str, code: str) -> None:
    """The formats of an option of the controller, an unknown one, a pose, 256 characters."""
    assert AsLanguage().code(text) == code


@given(st.integers(-99_999, 999_999))
def test_a_six_character_field_reads_back_as_the_number_that_was_written(number: int) -> None:
    """The packet's range (design section 3), written with /I6 and read with VAL."""
    bench = AsLanguage()
    bench.memory.write("n", float(number))
    bench.memory.write("$f", str(bench("$ENCODE(/I6,n)")))
    assert bench("LEN($f)") == 6
    assert bench("VAL($f)") == number


@given(st.floats(width=32, allow_nan=False, allow_infinity=False))
def test_the_default_format_keeps_eight_digits(number: float) -> None:
    """VAL reads the text of $ENCODE back to the last bit but one."""
    bench = AsLanguage()
    bench.memory.write("n", number)
    bench.memory.write("$t", str(bench("$ENCODE(n)")))
    outcome = bench.outcome("VAL($t)")
    assert outcome == pytest.approx(number, rel=1e-7, abs=1e-45) or outcome == "E0106"
