"""Cases that `make test` has no time for: `make test-long` and CI play them."""

from typing import Any

import pytest


def long(value: object) -> Any:
    """Return a parameter whose cases are left to the long run."""
    return pytest.param(value, marks=pytest.mark.long)
