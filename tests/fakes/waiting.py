"""Wait in real time for a condition."""

import time
from collections.abc import Callable

POLL_S = 0.01


def wait_until(condition: Callable[[], object], timeout_s: float, name: str = "condition") -> None:
    """Wait until a condition is true; fail after the time-out."""
    give_up_s = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < give_up_s, f"not within {timeout_s:g} s: {name}"
        time.sleep(POLL_S)
