"""Interface for the progress messages of a calibration."""

from typing import Protocol


class ProgressOutput(Protocol):
    """Receiver of progress messages: a terminal, or a list in a test."""

    def note(self, text: str) -> None:
        """Show one permanent line."""

    def progress(self, done_s: float, total_s: float, text: str) -> None:
        """Show the progress in seconds of the plan and the present step; called often."""
