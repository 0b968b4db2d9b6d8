"""Numbers typed on the command line."""

from hypothesis import given
from hypothesis import strategies as st

from cli.numbers import POSE, parse_gain, parse_vector

numbers = st.floats(allow_nan=False, allow_infinity=False)


@given(st.lists(numbers, min_size=6, max_size=6), st.sampled_from([",", ", ", " ,"]))
def test_six_numbers_are_read_exactly(values: list[float], comma: str) -> None:
    """No number is lost or reordered, for all signs and spaces."""
    assert parse_vector(comma.join(map(repr, values)), POSE) == tuple(values)


@given(st.floats(min_value=0.0, allow_infinity=False))
def test_one_gain_applies_to_all_axes(gain: float) -> None:
    """One number stands for three equal ones."""
    assert parse_gain(repr(gain), "m/N") == (gain, gain, gain)
