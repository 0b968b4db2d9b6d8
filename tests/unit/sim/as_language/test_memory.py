"""Variables of AS: indices and types. Arrays, locals and parameters: tests/corpus/as."""

import pytest

from sim.as_language.errors import AsError
from tests.unit.sim.as_language.conftest import AsLanguage


@pytest.mark.parametrize("index", ["-1", "10000", "1E9"])
def test_an_index_outside_of_0_to_9999_is_refused(index: str) -> None:
    """P0119, for reading and for writing."""
    assert AsLanguage("a[0] = 1", "a[9999] = 1").code(f"a[{index}]") == "P0119"
    with pytest.raises(AsError, match="P0119"):
        AsLanguage(f"a[{index}] = 1")


@pytest.mark.parametrize(
    ("first", "second", "code"),
    [
        ("x = 1", "y = x[1]", "P0132"),
        ("x[1] = 1", "y = x", "P0133"),
        ("x = 1", 'x = "a"', "P0150"),
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
