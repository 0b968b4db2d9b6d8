"""The forecast map: its file is whole, and its fits give intervals at most twice as high as low."""

import json
from math import exp, log
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from forcemesh.errors import DataError
from tuning.force_map import FILE, QuantityFit, check_value, force_map

FEATURE = st.floats(-3.0, 3.0)


def fit_of(coefficients: tuple[float, ...], width: float = 0.2) -> QuantityFit:
    """Return a fit with two features."""
    return QuantityFit(("a", "b"), (1.0, -1.0), (2.0, 0.5), coefficients, width)


def test_the_stored_map_is_whole_and_has_both_laws() -> None:
    """Its check value fits; every law has a fit of each quantity."""
    tree = json.loads(FILE.read_text(encoding="utf-8"))
    assert tree["check"] == check_value(tree)
    assert "forecast" in tree["command"]
    maps = force_map()
    assert sorted(maps) == ["adaptive", "plain"]
    for law_map in maps.values():
        assert sorted(law_map.fits) == ["follow_error_N", "peak_N", "settling_s"]
        assert all(0.0 < 2.0 * fit.width <= log(2.0) + 1e-5 for fit in law_map.fits.values())
        assert all(interval.low < interval.high for interval in law_map.ranges.values())


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "cannot be read"),
        ("[]", "was changed by hand"),
        (FILE.read_text(encoding="utf-8").replace("7", "8", 1), "was changed by hand"),
    ],
)
def test_a_damaged_map_is_refused_with_the_remedy(text: str, sentence: str, tmp_path: Path) -> None:
    """It names the file and the command."""
    path = tmp_path / "map.json"
    path.write_text(text)
    with pytest.raises(DataError, match=f"map.json: {sentence}.*python -m bench.forecast.fit"):
        force_map(path)


@given(a=FEATURE, b=FEATURE, model=st.floats(0.01, 100.0), width=st.floats(0.01, 0.34))
def test_the_interval_is_the_model_times_the_polynomial(a, b, model, width) -> None:
    """Written out by hand for two features; its ends are a factor exp(2 w) apart."""
    c = (0.1, 0.2, -0.3, 0.01, 0.02, -0.03)
    x, y = (a - 1.0) / 2.0, (b + 1.0) / 0.5
    power = c[0] + c[1] * x + c[2] * y + c[3] * x * x + c[4] * x * y + c[5] * y * y
    found = fit_of(c, width).interval(model, {"a": a, "b": b, "other": 9.0})
    middle = (found.low * found.high) ** 0.5
    assert middle == pytest.approx(model * exp(power), rel=1e-9)
    assert found.high / found.low == pytest.approx(exp(2.0 * width), rel=1e-9)
