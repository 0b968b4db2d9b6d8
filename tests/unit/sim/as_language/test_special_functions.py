"""Functions that take the name of a variable in a string."""

import pytest

from tests.fakes.as_language import AsLanguage


def memory() -> AsLanguage:
    """One variable of each type, and arrays of them."""
    return AsLanguage("x = 5", "x2[1] = 6", ".y = 7", "POINT p = TRANS(1,2,3)",
                      "POINT #j = #PPOINT(1,2)", '$s = "main"', "@n = 8")  # fmt: skip


@pytest.mark.parametrize(
    ("text", "code"),
    [('STRTOVAL("q")', "E0102"), ('STRTOPOS("q")', "E0103"), ('STRTOVAL("p")', "P0118"),
     ('STRTOPOS("x")', "P0118"), ('STRTOVAL("x2[i]")', "P0119"), ("STRTOVAL(x)", "P0118"),
     ('STRTOVAL("x",1)', "P0116"), ("STRTOPOS()", "P0116"), ('EXISTDATA("x")', "P0116"),
     ('EXISTDATA("x",Q)', "P0116"), ('EXISTDATA("x",1)', "P0116")],
)  # fmt: skip
def test_a_name_that_leads_nowhere_is_an_error_of_as(text: str, code: str) -> None:
    """Undefined, of another type, not a name, or not a type."""
    assert memory().code(text) == code


@pytest.mark.parametrize(
    ("name", "letter"),
    [("x", "R"), ("p", "T"), ("#j", "P"), ("$s", "S"), ("@n", "I"), ("main", "G")],
)
def test_existdata_is_true_for_the_type_of_a_name_and_no_other(name: str, letter: str) -> None:
    """Six letters; a program is no variable."""
    bench = memory()
    for other in "PTRSIG":
        expected = -1 if other == letter else 0
        assert bench(f'EXISTDATA("{name}",{other})') == expected, other
