"""A cell in which the tests publish for all roles but the arbiter."""

import pytest

from tests.fakes.cellmates import Cellmates


@pytest.fixture
def cell() -> Cellmates:
    """Return a cell in which all roles publish."""
    return Cellmates()
