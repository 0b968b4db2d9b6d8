"""A reader of sensor/wrench, without messages."""

import pytest

from tests.fakes.line import Line


@pytest.fixture
def line() -> Line:
    """A reader that has received nothing."""
    return Line()
