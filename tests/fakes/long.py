"""Cases that are too long for `make test`: `make nightly ARGS=long` runs them."""

from typing import Any

import pytest


def long(value: object) -> Any:
    """Return a parameter whose cases run in the long run only."""
    return pytest.param(value, marks=pytest.mark.long)
