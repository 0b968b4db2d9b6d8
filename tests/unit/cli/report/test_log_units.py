"""Units of a log: factors, names of columns, and refusals."""

import pytest

from cli.report.log_units import (
    DEFAULTS,
    FORCE,
    TIME,
    TORQUE,
    UNITS,
    named_units,
    unit_in_name,
    unit_of_columns,
)
from forcemesh.errors import DataError


@pytest.mark.parametrize(
    ("symbol", "quantity", "factor"),
    [
        ("lbf", FORCE, 4.44822),
        ("lbf-in", TORQUE, 0.112985),
        ("Nmm", TORQUE, 0.001),
        ("us", TIME, 1e-6),
    ],
)
def test_factors_are_those_of_the_tables(symbol: str, quantity: str, factor: float) -> None:
    """NIST SP 811, appendix B.8."""
    assert UNITS[symbol].quantity == quantity
    assert UNITS[symbol].factor == pytest.approx(factor, rel=1e-5)


def test_units_are_named_in_any_order_and_spelling() -> None:
    """Also with a micro sign, a dot or a space; each unit is found by its own symbol."""
    found = named_units("µs, N·m ,kN")
    assert {quantity: unit.symbol for quantity, unit in found.items()} == {
        TIME: "us",
        TORQUE: "Nm",
        FORCE: "kN",
    }
    assert named_units("") == {}
    for text, sentence in (
        ("s,ms", "--units: s and ms are both units of time"),
        ("newton", "unknown unit 'newton': choose from N, mN, kN"),
    ):
        with pytest.raises(DataError, match=sentence):
            named_units(text)
    assert all(named_units(symbol) == {unit.quantity: unit} for symbol, unit in UNITS.items())


@pytest.mark.parametrize(
    ("name", "quantity", "symbol"),
    [
        ("Fz [N]", FORCE, "N"),
        ("time_ms", TIME, "ms"),
        ("force_N.x", FORCE, "N"),
        ("torque_Nm.z", TORQUE, "Nm"),
        ("fz", FORCE, None),
        ("t_s", FORCE, None),
    ],
)
def test_a_unit_is_found_at_the_end_of_a_name(name: str, quantity: str, symbol: str | None) -> None:
    """In brackets or after an underscore, if it is one of the quantity."""
    found = unit_in_name(name, quantity)
    assert (None if found is None else found.symbol) == symbol


def test_named_units_precede_those_of_the_columns_and_these_the_defaults() -> None:
    """Different units of one quantity are refused."""
    assert unit_of_columns(["fx [kN]"], FORCE, named_units("lbf")).symbol == "lbf"
    assert unit_of_columns(["fx [kN]", "fy"], FORCE, {}).symbol == "kN"
    assert unit_of_columns(["fx"], FORCE, {}) == DEFAULTS[FORCE]
    with pytest.raises(DataError, match=r"columns of force have the units N and kN: name one in"):
        unit_of_columns(["fx [kN]", "fy [N]"], FORCE, {})
