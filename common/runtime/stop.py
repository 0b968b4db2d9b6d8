"""Stop event of a process, set by signals."""

import os
import select
import signal

ENDING_SIGNALS = (signal.SIGTERM, signal.SIGINT)


class StopSignal:
    """Event that a signal handler may set.

    `threading.Event` may not be set by one: a handler runs in the main thread, which may itself
    hold the lock of the event, within `wait`; then `set` never returns.
    """

    def __init__(self) -> None:
        """Open a pipe: one byte in it ends every wait."""
        self._is_set = False
        self._reader, self._writer = os.pipe()

    def __del__(self) -> None:
        """Close the pipe."""
        os.close(self._reader)
        os.close(self._writer)

    def set(self) -> None:
        """Set the event, and end every wait."""
        if not self._is_set:
            self._is_set = True
            os.write(self._writer, b"\0")

    def is_set(self) -> bool:
        """Return whether it is set."""
        return self._is_set

    def wait(self, timeout_s: float | None = None) -> bool:
        """Wait until it is set, or for a time; return whether it is set."""
        if not self._is_set:
            poll = select.poll()
            poll.register(self._reader, select.POLLIN)
            poll.poll(None if timeout_s is None else 1e3 * max(timeout_s, 0.0))
        return self._is_set


def stop_on_signals(*more: signal.Signals) -> StopSignal:
    """Return the event that SIGTERM, SIGINT and further signals set."""
    stop = StopSignal()
    for number in (*ENDING_SIGNALS, *more):
        signal.signal(number, lambda *_: stop.set())
    return stop
