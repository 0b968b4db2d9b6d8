"""Error codes: each has a text and a remedy, and an unknown one is admitted."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller.error_codes import ERROR_TEXTS, REMEDIES, code_of, error_shown, number_of


@pytest.mark.parametrize("code", ERROR_TEXTS)
def test_each_code_is_shown_with_its_text_and_a_remedy(code: str) -> None:
    """By the number that ERROR returns; it fits into the text of a trip."""
    shown = error_shown(number_of(code))
    assert code_of(number_of(code)) == code
    assert shown.startswith(f"{code} {ERROR_TEXTS[code]}: ")
    assert any(remedy in shown for remedy in REMEDIES.values())
    assert len(shown) < 350


def test_each_remedy_is_of_a_code() -> None:
    """None is left over."""
    longest = {max((k for k in REMEDIES if code.startswith(k)), key=len) for code in ERROR_TEXTS}
    assert longest == set(REMEDIES)


@given(st.integers(-99_999, -1))
def test_any_other_number_is_admitted_as_unknown(number: int) -> None:
    """Its code, and where its text stands; or that it is no error of AS."""
    code, shown = code_of(number), error_shown(number)
    if code is None:
        assert shown.startswith(f"{number}, which is no number")
    elif code not in ERROR_TEXTS:
        assert shown.startswith(f"{code}: its text is on the pendant")
