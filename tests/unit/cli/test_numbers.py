"""Numbers typed on the command line."""

import pytest
import typer
from hypothesis import given
from hypothesis import strategies as st

from cli.numbers import JOINTS, POSE, parse_gain, parse_vector

numbers = st.floats(allow_nan=False, allow_infinity=False)


@given(st.lists(numbers, min_size=6, max_size=6), st.sampled_from([",", ", ", " ,"]))
def test_six_numbers_are_read_exactly(values: list[float], comma: str) -> None:
    """No number is lost or reordered, for all signs and spaces."""
    assert parse_vector(comma.join(map(repr, values)), POSE) == tuple(values)


@given(st.lists(numbers, max_size=9).filter(lambda values: len(values) != 6))
def test_another_count_of_numbers_is_refused_with_their_names(values: list[float]) -> None:
    """The error gives the correct form."""
    with pytest.raises(typer.BadParameter, match=r"6 numbers are needed, J1,J2,J3,J4,J5,J6"):
        parse_vector(",".join(map(repr, values)), JOINTS)


@pytest.mark.parametrize("text", ["x", "", "nan", "inf", "-inf", "1e999", "0x1", "1 2"])
def test_a_value_that_is_no_finite_number_is_refused_by_name(text: str) -> None:
    """The error names the wrong one of the six."""
    with pytest.raises(typer.BadParameter, match=r"^Z (is not a number|must be finite)"):
        parse_vector(f"1,2,{text},4,5,6", POSE)


@given(st.floats(min_value=0.0, allow_infinity=False))
def test_one_gain_applies_to_all_axes(gain: float) -> None:
    """One number stands for three equal ones."""
    assert parse_gain(repr(gain), "m/N") == (gain, gain, gain)


@given(st.floats(max_value=-1e-9, allow_infinity=False))
def test_a_negative_gain_is_refused(gain: float) -> None:
    """It would reverse the direction of the response."""
    with pytest.raises(typer.BadParameter, match="zero or positive"):
        parse_gain(f"0,{gain!r},0", "m/N")


def test_a_gain_that_is_left_out_is_none() -> None:
    """A gain that is left out keeps its value."""
    assert parse_gain(None, "m/N") is None
