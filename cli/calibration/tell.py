"""What a calibration tells the person while it runs."""

from typing import Protocol


class Teller(Protocol):
    """Where it says so: a terminal, or a list of a test."""

    def note(self, text: str) -> None:
        """Say one line that stays."""

    def progress(self, done_s: float, total_s: float, text: str) -> None:
        """Say how far it is, in seconds of the plan, and what is going on; called often."""
