"""Variables of AS: sparse arrays, types, globals and locals, parameters by reference."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.as_language.errors import AsError
from sim.as_language.memory import following
from sim.as_language.values import Joints
from tests.fakes.as_language import AsLanguage


@given(st.dictionaries(st.integers(0, 9999), st.integers(-99, 99), max_size=8))
def test_arrays_are_sparse(values: dict[int, int]) -> None:
    """Every index from 0 to 9999 can be used without a declaration; the others stay undefined."""
    bench = AsLanguage(*(f"a[{index}] = {value}" for index, value in values.items()))
    for index in {0, 1, 9999, *values}:
        expected = float(values[index]) if index in values else "E0102"
        assert bench.outcome(f"a[{index}]") == expected


@pytest.mark.parametrize("index", ["-1", "10000", "1E9"])
def test_an_index_outside_of_0_to_9999_is_refused(index: str) -> None:
    """P0119, for reading and for writing."""
    assert AsLanguage("a[1] = 1").code(f"a[{index}]") == "P0119"
    with pytest.raises(AsError, match="P0119"):
        AsLanguage(f"a[{index}] = 1")


@pytest.mark.parametrize(
    ("first", "second", "code"),
    [
        ("x = 1", "x[1] = 1", "P0132"),
        ("x[1] = 1", "x = 1", "P0133"),
        ("x = 1", "y = x[1]", "P0132"),
        ("x[1] = 1", "y = x", "P0133"),
        ("x = 1", 'x = "a"', "P0150"),
        ("x = 1", "x = NULL", "P0150"),
        ("POINT x = NULL", "x = 1", "P0150"),
        ("$s = 1", "x = 1", "P0150"),
        ("x = 1", "POINT #j = NULL", "P0150"),
        ("x = 1", "@n = 3E9", "E0106"),
        ("x = 1", '@n = "1"', "P0150"),
    ],
)
def test_a_name_keeps_its_type(first: str, second: str, code: str) -> None:
    """A scalar never becomes an array, a real never a pose."""
    with pytest.raises(AsError) as caught:
        AsLanguage(first, second)
    assert caught.value.code == code


def test_prefixes_make_different_variables() -> None:
    """x, $x, #x, @x and .x are five."""
    bench = AsLanguage("x = 1", '$x = "a"', "POINT #x = #PPOINT(2)", "@x = 3.9", ".x = 4")
    assert [bench(name) for name in ("x", "$x", "@x", ".x")] == [1.0, "a", 3, 4.0]
    assert bench("#x") == Joints((2.0, 0.0, 0.0, 0.0, 0.0, 0.0))


@given(st.integers(0, 9990), st.integers(0, 9))
def test_elements_that_follow_count_in_the_last_dimension(index: int, count: int) -> None:
    """DECOMPOSE and TCP_RECV fill a[k], a[k+1], ..."""
    assert following(index, count) == index + count
    assert following((3, index), count) == (3, index + count)
