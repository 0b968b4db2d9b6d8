"""Terminal of a verb that moves the arm: progress bar, typed lines, interruption."""

import select
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from types import FrameType
from typing import Never, Protocol

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

SCREEN_REFRESH_S = 0.1


class ProgressOutput(Protocol):
    """Receiver of progress messages: a terminal, or a list in a test."""

    def note(self, text: str) -> None:
        """Show one permanent line."""

    def progress(self, done_s: float, total_s: float, text: str) -> None:
        """Show the progress in seconds of the plan and the present step; called often."""


class Screen:
    """Progress bar; permanent lines are printed above it."""

    def __init__(self, bar: Progress) -> None:
        """Add one task."""
        self._bar = bar
        self._task = bar.add_task("", total=None)
        self._last_s = 0.0

    def note(self, text: str) -> None:
        """Print one permanent line."""
        self._bar.console.print(text, markup=False, highlight=False, soft_wrap=True)

    def progress(self, done_s: float, total_s: float, text: str) -> None:
        """Update the bar, at most every SCREEN_REFRESH_S."""
        now_s = time.monotonic()
        if now_s - self._last_s >= SCREEN_REFRESH_S:
            self._last_s = now_s
            self._bar.update(self._task, completed=done_s, total=total_s, description=text)


@contextmanager
def screen(*, with_time: bool = True) -> Iterator[Screen]:
    """Show a progress bar during the block; it is removed at the end."""
    columns = [TextColumn("{task.description}", markup=False), BarColumn(bar_width=24)]
    if with_time:
        columns.append(TimeRemainingColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True) as bar:
        yield Screen(bar)


def typed_line() -> str | None:
    """Return a typed line without waiting, None when there is none; `q` at the end of input."""
    if not select.select([sys.stdin], [], [], 0.0)[0]:
        return None
    line = sys.stdin.readline()
    return line.strip().lower() if line else "q"


def interrupt_on_signals() -> AbstractContextManager[None]:
    """Handle SIGHUP (closed terminal) and SIGTERM like Ctrl-C: they stop the arm."""
    return _signals(signal.default_int_handler, signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def ignore_sigint() -> AbstractContextManager[None]:
    """Ignore further Ctrl-C while the hold that the first one requested is sent."""
    return _signals(signal.SIG_IGN, signal.SIGINT)


@contextmanager
def _signals(
    handler: Callable[[int, FrameType | None], Never] | signal.Handlers, *numbers: signal.Signals
) -> Iterator[None]:
    before = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, former in before.items():
            signal.signal(number, former)
