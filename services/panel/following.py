"""A field of a form that shows a setting of the cell, until the person changes it."""

from dataclasses import dataclass
from typing import Any

from services.panel.viewer import put


@dataclass(slots=True)
class Followed:
    """One field: it follows the cell, but never overwrites what a person has put there.

    What differs from the value that was shown last is the person's own, until they have sent it or
    put it back.
    """

    handle: Any
    shown: Any = None

    def __post_init__(self) -> None:
        """Begin with what the form shows."""
        self.shown = self.handle.value

    @property
    def is_own(self) -> bool:
        """Whether a person has changed it."""
        return bool(self.handle.value != self.shown)

    def follow(self, setting: object) -> None:
        """Show the cell's setting where the person has not put another one; None is not known."""
        if setting is None:
            return
        if not self.is_own and self.handle.value != setting:
            put(self.handle, setting)
        if self.handle.value == setting:
            self.shown = self.handle.value
