"""A wrench service on an in-memory bus."""

import pytest

from tests.fakes.wrench_bench import WrenchBench


@pytest.fixture
def bench() -> WrenchBench:
    """Return a service without any input yet."""
    return WrenchBench()
