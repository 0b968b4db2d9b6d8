"""Stop event: set by signals, at any moment of the main thread."""

import signal
import subprocess
import sys
from collections.abc import Iterator

import pytest

from common.runtime.stop import stop_on_signals

SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
LONG_S = 60.0
# Wait again and again, with the signal one line later each time.
SET_AT_EACH_LINE = """
import signal, sys, threading
from common.runtime import stop as module

FILES = (module.__file__, threading.__file__)
lines, last = 0, -1

def trace(frame, event, _argument):
    global lines
    if frame.f_code.co_filename not in FILES:
        return None
    if event == "line":
        lines += 1
        if lines == last:
            signal.raise_signal(signal.SIGTERM)
    return trace

while lines >= last:
    stop, lines, last = module.stop_on_signals(), 0, last + 1
    sys.settrace(trace)
    stop.wait(0.001)
    sys.settrace(None)
    assert stop.is_set() or not 0 < last <= lines, last
print("set at", last - 1, "lines")
"""


@pytest.fixture
def handlers() -> Iterator[None]:
    """Signal handlers as they were afterwards."""
    before = {number: signal.getsignal(number) for number in SIGNALS}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.usefixtures("handlers")
@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_only_sets_the_event(number: signal.Signals) -> None:
    """The handler does nothing that a step in the middle of its work could notice."""
    stop = stop_on_signals(signal.SIGHUP)
    assert not stop.wait(-1.0)
    assert not stop.wait(0.02)
    signal.raise_signal(number)
    assert stop.is_set()
    assert stop.wait(LONG_S)


def test_a_signal_within_the_events_own_code_does_not_block() -> None:
    """A handler runs between any two instructions: it would wait for a lock of that code."""
    done = subprocess.run(
        [sys.executable, "-c", SET_AT_EACH_LINE],
        capture_output=True, text=True, timeout=LONG_S, check=False,
    )  # fmt: skip
    assert done.stdout.startswith("set at "), done.stderr
