"""Form field that shows a setting of the cell until the user edits it."""

from dataclasses import dataclass
from typing import Any

from services.panel.viewer import put


@dataclass(slots=True)
class SyncedField:
    """One field: it follows the cell, but does not overwrite an edited value.

    A value that differs from the one shown last is edited, until it is sent or restored.
    """

    handle: Any
    shown: Any = None

    def __post_init__(self) -> None:
        """Start with the value that the form shows."""
        self.shown = self.handle.value

    @property
    def is_own(self) -> bool:
        """Whether the user has edited it."""
        return bool(self.handle.value != self.shown)

    def follow(self, setting: object) -> None:
        """Show the cell's setting unless the field is edited; None is unknown."""
        if setting is None:
            return
        if not self.is_own and self.handle.value != setting:
            put(self.handle, setting)
        if self.handle.value == setting:
            self.shown = self.handle.value
