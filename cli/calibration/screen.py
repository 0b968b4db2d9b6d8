"""Shows a calibration on the terminal: a bar, the time left, what is waited for."""

import select
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

REFRESH_S = 0.1


class Screen:
    """Tells it by a progress bar; lines that stay go above it."""

    def __init__(self, bar: Progress) -> None:
        """Add one task."""
        self._bar = bar
        self._task = bar.add_task("", total=None)
        self._last_s = 0.0

    def note(self, text: str) -> None:
        """Say one line that stays."""
        self._bar.console.print(text, markup=False, highlight=False, soft_wrap=True)

    def progress(self, done_s: float, total_s: float, text: str) -> None:
        """Move the bar, some times a second."""
        now_s = time.monotonic()
        if now_s - self._last_s >= REFRESH_S:
            self._last_s = now_s
            self._bar.update(self._task, completed=done_s, total=total_s, description=text)


@contextmanager
def screen(*, with_time: bool = True) -> Iterator[Screen]:
    """Show a bar while something runs; the last state of it goes away with it."""
    columns = [TextColumn("{task.description}", markup=False), BarColumn(bar_width=24)]
    if with_time:
        columns.append(TimeRemainingColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True) as bar:
        yield Screen(bar)


class Keyboard:
    """Lines that a person types, without waiting for them; the end of input counts as `q`."""

    def poll(self) -> str | None:
        """Return a line that was typed, None when there is none."""
        if not select.select([sys.stdin], [], [], 0.0)[0]:
            return None
        line = sys.stdin.readline()
        return line.strip().lower() if line else "q"
