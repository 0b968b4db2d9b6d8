"""Retention of the recordings that stops triggered: the newest of each code are kept.

Cell, code and order are read from the recordings: a file name does not separate neighbouring cells,
and the wall clock may have been set back.
"""

import sys
from pathlib import Path
from typing import NamedTuple

from forcemesh.errors import DataError
from services.recorder.folder import SUFFIX, stop_label
from services.recorder.reading import RecordedFile


class StopRecording(NamedTuple):
    """One recording with all of its files. `number` counts those of a code; 0 in older files."""

    number: int
    name: str  # of its files without their own numbers
    paths: tuple[Path, ...]


class Retention:
    """Recordings of one cell's stops in a folder."""

    def __init__(self, folder: Path, cell: str) -> None:
        """Read nothing yet."""
        self.unreadable: set[Path] = set()  # kept
        self._folder, self._cell = folder, cell
        self._about: dict[Path, dict[str, str]] = {}

    def of_code(self, code: str) -> list[StopRecording]:
        """Return the recordings of a stop's code, the oldest first."""
        found: dict[tuple[int, str], list[Path]] = {}
        for path in sorted(self._folder.glob(f"{self._cell}-*-{stop_label(code)}-*{SUFFIX}")):
            about = self._read(path)
            if about.get("cell") == self._cell and about.get("cause") == code:
                number = about.get("number", "")
                key = int(number) if number.isdecimal() else 0, path.stem.rpartition("-")[0]
                found.setdefault(key, []).append(path)
        return [StopRecording(*key, tuple(paths)) for key, paths in sorted(found.items())]

    def remove_oldest(self, past: list[StopRecording], keep: int) -> None:
        """Remove whole recordings, listed before the open one began, down to `keep` with that one.

        A file that cannot be removed stays, and is reported.
        """
        for recording in past[: max(len(past) + 1 - keep, 0)]:
            for path in recording.paths:
                try:
                    path.unlink(missing_ok=True)
                except OSError as error:
                    sys.stderr.write(f"{path}: cannot be removed: {error.strerror}\n")
                self._about.pop(path, None)

    def _read(self, path: Path) -> dict[str, str]:
        if path not in self._about and path not in self.unreadable:
            try:
                self._about[path] = RecordedFile(path).about
            except DataError as error:
                self.unreadable.add(path)
                sys.stderr.write(f"{error}; it is kept\n")
        return self._about.get(path, {})
