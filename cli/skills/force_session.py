"""Session of a force skill: connection, progress bar, and a hold when it is interrupted."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Option

from cli.context import INTERRUPTED, cell_of, exit_with_error, print_note
from forcemesh.errors import ForcemeshError

if TYPE_CHECKING:
    from cli.skills.contact_monitor import ReportProgress
    from common.bus.configured_cell import ConfiguredCell

ALREADY_RUNNING = (
    "force feedback is already running: this verb takes it over and stops it at its end"
)

AWAITED = "waiting until {} is on"
LOADED = "the tool is already loaded with {:.1f} N: `forcemesh retract` leaves a contact"


WhenOption = Annotated[
    str | None,
    Option(metavar="SIGNAL", help="Start once this digital signal is on, within a minute."),
]


@contextmanager
def force_session(
    named: Path | None, when: str | None = None
) -> "Iterator[tuple[ConfiguredCell, ReportProgress]]":
    """Connect and show a progress bar; Ctrl-C, a closed terminal and SIGTERM hold the arm.

    Args:
        named: Cell file.
        when: Digital signal that must be on before the skill begins.
    """
    from cli.terminal import ignore_sigint, interrupt_on_signals

    with cell_of(named) as cell:
        if cell.status().commander == "regulator":
            print_note(ALREADY_RUNNING)
        elif (load_N := cell.load_N()) is not None:
            print_note(LOADED.format(load_N))
        try:
            with progress_bar() as progress, interrupt_on_signals():
                if when is not None:
                    print_note(AWAITED.format(when))
                    cell.signals.wait(when)
                yield cell, progress
        except KeyboardInterrupt:
            text = "the arm holds"
            with ignore_sigint():
                try:
                    cell.hold("a verb was interrupted")
                except ForcemeshError as error:
                    text = f"no reply to the hold request: {error}"
            exit_with_error(f"interrupted: {text}", INTERRUPTED)


@contextmanager
def progress_bar() -> "Iterator[ReportProgress]":
    """Show the progress on a terminal; nothing otherwise."""
    from cli.skills.contact_monitor import no_progress
    from cli.terminal import screen

    shown = screen(with_time=False) if sys.stderr.isatty() else nullcontext()
    with shown as on_screen:
        yield no_progress if on_screen is None else on_screen.progress
