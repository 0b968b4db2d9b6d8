"""The examples of the AS Language Reference Manual (facts 1.16), and every one in the facts."""

import pytest

from sim.as_language.values import Transformation
from tests.fakes.as_language import AsLanguage

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


def test_val_reads_scientific_notation_in_single_precision() -> None:
    """VAL("1.2E-5") is the real nearest to it."""
    assert AsLanguage()('VAL("1.2E-5")') == pytest.approx(1.2e-5, rel=1e-7)


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


def test_decode_takes_a_line_of_numbers_apart_as_in_the_manual() -> None:
    """The sample of 9-69: one call for the field, one for the separators, until none is left."""
    bench = AsLanguage('$v = "1234,93465.2,.4358,3458103"')
    numbers = []
    while bench("LEN($v)"):
        bench.run('$field = $DECODE($v,",",0)', "n = VAL($field)", '$gone = $DECODE($v,",",1)')
        numbers.append(bench("n"))
    assert numbers == pytest.approx([1234.0, 93465.2, 0.4358, 3458103.0], rel=1e-7)


def test_maxindex_is_minus_1_for_a_single_variable_and_minus_2_for_no_variable() -> None:
    """And the largest index for an array, here with holes."""
    bench = AsLanguage("a[3] = 1", "a[12] = 1", "s = 1")
    assert bench('MAXINDEX("a")') == 12.0
    assert bench('MININDEX("a")') == 3.0
    assert bench('MAXINDEX("s")') == -1.0
    assert bench('MAXINDEX("missing")') == -2.0


def test_a_condition_is_stored_as_minus_1_so_it_never_equals_1() -> None:
    """TRUE is -1.0: a flag that is compared with 1 is never on."""
    bench = AsLanguage("a = 3", "b = 2", "flag = (a>b)")
    assert bench("flag == 1") == 0.0
    assert bench("flag == TRUE") == -1.0


def test_not_binds_tighter_than_a_comparison() -> None:
    """NOT a == b is (NOT a) == b, which public programs get wrong."""
    bench = AsLanguage("a = 5", "b = 3")
    assert bench("NOT a == b") == 0.0
    assert bench("NOT (a == b)") == -1.0


def test_a_field_can_be_padded_by_hand_without_any_option() -> None:
    """The shipped program's method: the last five characters of 100000 + n."""
    assert AsLanguage()("$RIGHT($ENCODE(/I6,100000+123),5)") == "00123"
